"""Lines of a text that stays one string, beside the list of `str.split`."""

import re
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.logs.readers import text as module
from vttig_jax.logs.readers.text import Lines

TEXTS = st.lists(st.sampled_from(["", "a", " ", "1,2", "overrun", "µ 3"]), max_size=9)


@given(TEXTS, st.integers(1, 8), st.integers(1, 12))
def test_lines_are_those_of_split(parts, head, block):
    text = "\n".join(parts)
    expected = text.split("\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_HEAD", head)
        patch.setattr(module, "_BLOCK", block)
        lines = Lines(text)
        assert list(lines) == expected and len(lines) == len(expected)
        assert list(lines.backwards()) == expected[::-1]
        for k in range(len(expected)):
            assert lines[k] == expected[k] and lines[k - len(expected)] == expected[k]
            assert list(lines.starting_at(k)) == expected[k:]
            assert text[lines.start_of(k) :].split("\n") == expected[k:]
            assert "".join(lines.blocks(k, block)) == "\n".join(expected[k:])
            assert lines.have("overrun", k) == any("overrun" in line for line in expected[k:])
            word = re.compile(r"^\s*[a-z]", re.MULTILINE)
            assert lines.match(word, k) == any(map(word.match, expected[k:]))
            if k:
                assert list(lines.before(k)) == expected[:k]
                assert lines.before(k).have("overrun") == any("overrun" in x for x in expected[:k])
        bounds = [None, *range(-3, len(expected) + 2)]
        for start, stop in product(bounds, bounds):
            assert lines[start:stop] == expected[start:stop]
        with pytest.raises(IndexError):
            lines[len(expected)]


@given(TEXTS, st.integers(1, 12))
def test_blocks_end_with_lines(parts, size):
    lines = Lines("\n".join(parts))
    blocks = list(lines.blocks(0, size))
    assert all(block.endswith("\n") for block in blocks[:-1])
    assert all(len(block) <= size or block.count("\n") <= 1 for block in blocks)
