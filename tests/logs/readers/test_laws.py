"""Laws of text logs: the numbers are those that were written, wherever and however they stand."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vttig_jax import read_log

pytestmark = pytest.mark.usefixtures("unchecked_module")

KEYWORDS = {"ratio": "1:1", "columns": {"driving": "a", "driven": "b"}, "unit": "deg"}
NUMBERS = st.one_of(
    st.floats(-1e6, 1e6).map(repr),
    st.integers(-(10**6), 10**6).map(str),
    st.sampled_from(["1.", ".5", "-0", "+3", "007", "1E-3", "4.9e-324"]),
)


@settings(max_examples=15)
@given(
    st.lists(NUMBERS, min_size=1, max_size=20),
    st.sampled_from([(",", "."), (";", ","), ("\t", ","), ("|", "."), (" ", ".")]),
    st.sampled_from([40, 30_000]),
)
def test_the_numbers_are_those_of_python(tmp_path_factory, numbers, marks, size):
    """To the last bit, in short texts and in long ones, which another parser reads."""
    lines = [f"{k / 64},{k * 1.25},{k * 1.5},{numbers[k % len(numbers)]}" for k in range(size)]
    text = "\n".join(["time_s,a,b,c", *lines, ""])
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_text(text.replace(",", marks[0]).replace(".", marks[1]))
    columns = {"driving": "a", "driven": "b", "torque": "c"}
    log = read_log(path, ratio="1:1", unit="deg", columns=columns, decimal=marks[1])
    assert log.torque is not None and log.driving.reading.tolist() == [
        k * 1.25 for k in range(size)
    ]
    assert log.torque.tolist() == [float(numbers[k % len(numbers)]) for k in range(size)]


@given(st.integers(0, 20), st.integers(5, 9))
def test_a_log_that_is_cut_anywhere_in_its_last_line(tmp_path_factory, kept, rows):
    lines = [f"{k / 4:.2f},{1000 + 7 * k}.25,{2000 + 7 * k}.50" for k in range(rows)]
    kept = min(kept, len(lines[-1]))
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_text("\n".join(["time_s,a,b", *lines[:-1], lines[-1][:kept]]))
    log = read_log(path, **KEYWORDS)
    assert log.driven is not None
    whole = len(log) == rows
    assert len(log) == rows - 1 + whole and (whole or kept < len(lines[-1]))
    assert log.driving.reading.tolist() == [1000.25 + 7 * k for k in range(len(log))]
    assert not whole or log.driven.reading[-1] > 2000  # a number that lost a digit is left out
    assert any(f"({rows + 1})" in note for note in log.notes) == (not whole and kept > 0)


@given(
    st.lists(st.sampled_from(["\n", "\r\n", "\r", "\n\n", "\n# note\n"]), min_size=9, max_size=9)
)
def test_ends_and_comments_between_rows_change_nothing(tmp_path_factory, ends):
    lines = ["time_s,a,b", *(f"{k / 8},{k * 3.5},{k * 3.25}" for k in range(8))]
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_bytes("".join(map("".join, zip(lines, ends, strict=True))).encode())
    log = read_log(path, **KEYWORDS)
    assert log.driving.reading.tolist() == [k * 3.5 for k in range(8)]
    assert log.time.tolist() == [k / 8 for k in range(8)]
