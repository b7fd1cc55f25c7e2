"""Columns read by pyarrow block by block: the bits of NumPy's parser, or None."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers import blocks
from vttig_jax.logs.readers.blocks import read_in_blocks
from vttig_jax.logs.readers.delimited import TextTable
from vttig_jax.logs.readers.lines import Lines
from vttig_jax.logs.readers.table import find_table

NUMBERS = st.one_of(
    st.floats(allow_nan=False).map(repr),
    st.integers(-(2**62), 2**62).map(str),
    st.integers(-9, 9).map(str),
    st.sampled_from(
        ["1.", ".5", "-0", "+3", "007", "1E-3", "4.9e-324", "1e400", "nan", "inf", " 7 "]
    ),
    st.integers(10**18, 10**21).map(str),
)
ODD = ["", "0x1F", "nan(1)", "1_0", '"2"', "1e", "3 # note", "1d5"]


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch):
    monkeypatch.setattr(blocks, "LONG", 0)
    monkeypatch.setattr(blocks, "BLOCK", 64)


def columns(table: TextTable, *, by_numpy: bool) -> list[bytes] | str:
    """The bits of all columns, or the sentence of the refusal."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "LONG", 10**9 if by_numpy else 0)
        try:
            return [a.dtype.str.encode() + a.tobytes() for a in table.columns([2, 0])]
        except LogError as error:
            return str(error)


@given(
    st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=1, max_size=30),
    st.sampled_from([(",", "."), (";", ","), ("\t", ","), ("|", "."), ("\t", ".")]),
    st.lists(st.sampled_from(["", "  ", "1;2", "# pause", "stop"]), max_size=1),
    st.sampled_from(["", *ODD, *[""] * 8]),
    st.sampled_from(["", "\n", "\n\n"]),
)
def test_same_bits_as_numpy(rows, marks, between, odd, end):
    delimiter, decimal = marks
    rows = [[field.replace(".", decimal) for field in row] for row in rows]
    if odd:
        rows[-1][0] = odd
    lines = [delimiter.join(row) for row in rows]
    lines[1:1] = between
    text = "\n".join([delimiter.join("abc"), *lines]) + end
    table = TextTable(("a", "b", "c"), Lines.of(text), 0, delimiter, decimal, "log.csv")
    assert columns(table, by_numpy=False) == columns(table, by_numpy=True)


def test_many_blocks_are_read_by_pyarrow():
    rows = np.random.default_rng(1).normal(size=(500, 3))
    text = "a,b,c\n" + "\n".join(",".join(map(repr, row.tolist())) for row in rows) + "\n"
    found = read_in_blocks(Lines.of(text), 1, ",", ".", [1, 2])
    assert found is not None
    np.testing.assert_array_equal(found, rows.T[1:])
    assert all(column.base is None for column in found)


@pytest.mark.parametrize(
    "text", ["1,2,\n3,4\n", "1,2\n3,\n", "1,2 # x\n", '"1",2\n', "1,2\nnan(1),2\n"]
)
def test_what_only_the_other_parsers_read(text):
    assert read_in_blocks(Lines.of("a,b\n" + text), 1, ",", ".", [0, 1]) is None


def test_blanks_and_short_texts_are_left_to_numpy(monkeypatch):
    assert read_in_blocks(Lines.of("1 2\n"), 0, None, ".", [0]) is None
    monkeypatch.setattr(blocks, "LONG", 5)
    assert read_in_blocks(Lines.of("1,2\n"), 0, ",", ".", [0]) is None


def test_large_counts_of_a_long_text_stay_exact():
    numbers = [2**60 + 1, 2**60 + 3, -(2**61) - 1]
    table = find_table("t,a\n" + "".join(f"{k}.5,{n}\n" for k, n in enumerate(numbers)), "log.csv")
    time, counts = table.columns([0, 1])
    assert (
        counts.dtype == np.int64 and counts.tolist() == numbers and time.tolist() == [0.5, 1.5, 2.5]
    )
