"""Foreign names in text for people: visible, in one line, and not long."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.files.text_tables import key_values, listed, text_table
from vttig_jax.base.shown_text import MOST, lines, one_line, shown_name

pytestmark = pytest.mark.smoke

HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp", "Co", "Cn"}
"""Unicode categories of characters that show nothing themselves."""


def is_visible(text: str) -> bool:
    return not any(unicodedata.category(mark) in HIDDEN for mark in text)


def test_control_characters_are_shown():
    for name, expected in (
        ("plain, äöü, 測定, 30° – 5″", "plain, äöü, 測定, 30° – 5″"),
        ("a\x1b[31mb", r"a\x1b[31mb"),
        ("bell\x07 nul\x00 c1\x9b del\x7f", r"bell\x07 nul\x00 c1\x9b del\x7f"),
        ("two\nlines\r\tand\u2028more", r"two\nlines\r\tand\u2028more"),
        ("gnp.\u202excod\u2066", r"gnp.\u202excod\u2066"),
        ("not UTF-8: \udcff", r"not UTF-8: \udcff"),
        ("narrow\u202fspace", "narrow\u202fspace"),
    ):
        assert shown_name(name) == one_line(name) == expected
        assert is_visible(expected) and is_visible(name) == (name == expected)


@given(st.text())
def test_no_text_hides_anything(text):
    assert is_visible(shown_name(text)) and is_visible(one_line(text))
    assert all(is_visible(line) for line in lines(text).split("\n"))


def test_long_names_are_cut():
    long = "n" * 100_000
    assert len(shown_name(long)) == MOST and shown_name(long).endswith("n…")
    assert len(shown_name("\x00" * MOST)) == MOST
    sentence = f"{long}.csv: line 3, column `{'two words ' * 1000}`: `{long}` is no number."
    assert len(one_line(sentence)) < 3 * MOST + 60
    assert one_line(sentence).endswith("…` is no number.")
    ours = "A long sentence of ours stays whole. " * 30
    assert one_line(ours) == ours


def test_tables_and_lists_keep_their_lines():
    name = "two\nlines\x1b[2J"
    assert len(key_values([("pair", name), (name, "x")], title=name).split("\n")) == 3
    assert len(text_table([(name, 1)], ["name", (name, "mm")]).split("\n")) == 2
    assert len(listed(name, [name, name])[0].split("\n")) == 3 + 1  # the title is ours
    for text in (key_values([(name, name)], title=name), text_table([(name,)], [name])):
        assert all(is_visible(line) for line in text.split("\n"))
