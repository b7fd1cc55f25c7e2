import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers import delimited
from vttig_jax.logs.readers.delimited import find_table, split

pytestmark = pytest.mark.smoke


def read(text, indices=(0, 1), **options):
    table = find_table(text, "log.csv", **options)
    return [column.tolist() for column in table.columns(indices)]


def cut(text, indices=(0, 1), **options):
    """Values, and the notes on what is left out at the end."""
    table = find_table(text, "log.csv", **options)
    values = [column.tolist() for column in table.columns(indices)]
    return values, (*table.notes, *table.left_out(indices))


def test_large_counts_stay_integers():
    table = find_table(f"t,a\n0.5,{2**60 + 1}\n0.6,{2**60 + 3}\n", "log.csv")
    time, counts = table.columns([0, 1])
    assert time.dtype == np.float64 and counts.dtype == np.int64
    assert counts.tolist() == [2**60 + 1, 2**60 + 3]


def test_columns_in_the_order_asked():
    assert read("a,b,c\n1,2,3\n", (2, 0)) == [[3.0], [1.0]]


def test_split():
    assert split("a, b ,,", ",") == ["a", "b"]
    assert split('"x, y",2', ",") == ["x, y", "2"]
    assert split("  1   2 ", None) == ["1", "2"]
    assert split("a, b ,,", ",", trim=False) == ["a", "b", "", ""]


NOTE = ("the last line (4) is cut off and left out",)
START = "t,a,b\n0,1,5\n1,2,6\n"


@pytest.mark.parametrize("end", ["2,", "2", "2,3e", "2,-", "2,x,7", "2,,7", "2,,", ",3,7"])
@pytest.mark.parametrize("newline", ["", "\n", "\n\n# stopped\n"])
def test_a_cut_last_line_is_left_out(end, newline):
    assert cut(START + end + newline) == ([[0.0, 1.0], [1.0, 2.0]], NOTE)


@pytest.mark.parametrize("end", ["2,3,7", "2,3,7\n", "2,3,", "2,3,x", "2,3\n", "2,3,7 # us", "\n"])
def test_a_complete_last_line_is_kept(end):
    values, notes = cut(START + end)
    assert notes == () and values == read(START + end)


def test_a_column_nobody_asked_for_is_missed_only_without_a_line_end():
    assert cut(START + "2,3") == ([[0.0, 1.0], [1.0, 2.0]], NOTE)
    assert cut(START + "2,3\n") == ([[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]], ())


ROWS = "t,a\n0,19401\n1,19425\n2,19448\n3,"


@pytest.mark.parametrize(
    ("end", "kept"),
    [("19", False), ("1944", False), ("19471", True), ("18", True), ("19\n", True)],
)
def test_a_last_number_that_is_cut_off_is_left_out_without_a_line_end(end, kept):
    """It begins like the number above and is far from it; the file ends inside it."""
    values, notes = cut(ROWS + end)
    assert len(values[0]) == 3 + kept and bool(notes) is not kept


def test_cut_lines_with_other_delimiters():
    assert cut("t a\n0 1\n1 2\n2")[0] == [[0.0, 1.0], [1.0, 2.0]]
    assert cut("t;a\n0,5;1\n1,5;2\n2,")[0] == [[0.5, 1.5], [1.0, 2.0]]
    assert cut('t,a\n"0,5","1"\n"1,5","2"\n"2,')[0] == [[0.5, 1.5], [1.0, 2.0]]
    assert cut("0,1\n1,2\n2", highest=2)[1] == ("the last line (3) is cut off and left out",)


def test_the_only_row_is_never_left_out():
    with pytest.raises(LogError, match="line 2, column `a`: `x` is no number"):
        cut("t,a\n0,x")


def test_what_is_broken_above_stays_an_error():
    with pytest.raises(LogError, match="line 3, column `a`: the field is empty"):
        cut("t,a\n0,1\n1,\n2,3\n3")
    with pytest.raises(LogError, match="line 3, column `a`: the field is empty"):
        cut("t,a\n0,1\n1,\n2,\n")
    with pytest.raises(LogError, match=r'decimal is "\."'):
        cut("t;a\n0.5;1\n1.5;2\n2,5;3\n", decimal=".")


@pytest.mark.parametrize(
    ("below", "lines"),
    [
        ("End of file", 1),
        ("---------", 1),
        ("Mean,1,5.5", 1),
        ("(2 rows affected)", 1),
        ("Statistics\n\nMean,1,5.5\nMax,1,6", 3),
        ('"Mittelwert",1,5.5\n"Maximum",1,6', 2),
    ],
)
@pytest.mark.parametrize("newline", ["", "\n", "\n\n# stopped\n"])
def test_text_below_a_table_is_left_out(below, lines, newline):
    values, notes = cut(START + below + newline)
    assert values == [[0.0, 1.0], [1.0, 2.0]]
    count = "1 line is" if lines == 1 else f"{lines} lines are"
    text = below.splitlines()[0]
    assert notes == (f"{count} text below the table and left out, from line 4: {text}",)


def test_text_below_a_table_whose_rows_start_with_a_word():
    rows = "state,t,a\nRUN,0,1\nRUN,1,2\n"
    values, notes = cut(rows + "STOP,2,3\n", (1, 2))
    assert values == [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]] and notes == ()
    values, notes = cut(rows + "End of measurement\n", (1, 2))
    assert values == [[0.0, 1.0], [1.0, 2.0]] and "from line 4" in notes[0]


def test_a_cut_line_above_text_is_left_out_too():
    values, notes = cut(START + "2,\nstopped by the user\n")
    assert values == [[0.0, 1.0], [1.0, 2.0]]
    assert len(notes) == 2 and notes[1] == NOTE[0]


def test_rows_that_are_no_numbers_are_no_text_below():
    assert np.isnan(cut(START + "nan,nan,nan\n")[0][0][-1])
    with pytest.raises(LogError, match="line 3"):
        cut("t,a\n0,1\nbroken,2\n2,3\n")
    with pytest.raises(LogError, match="line 3"):
        cut("t,a\n0,1\nbroken,2\n2,3\nEnd\n")


@pytest.mark.parametrize("field", ["1.#QNAN", "-1.#IND", "#N/A", "2#3"])
def test_a_hash_inside_a_field_is_no_comment(field):
    with pytest.raises(LogError, match=f"line 3, column `a`: `{field}` is no number"):
        read(f"t,a\n0,1\n1,{field}\n2,3\n")
    text = f"t,remark,a\n0,run {field},1\n1,run {field},2\n"
    assert read(text, (0, 2)) == [[0.0, 1.0], [1.0, 2.0]]


@pytest.mark.parametrize("comment", ["# a, b", "#a,b", "  # a, b"])
def test_a_comment_is_a_line_or_its_end(comment):
    assert read(f"t,a\n0,1\n{comment}\n1,2 # stopped\n") == [[0.0, 1.0], [1.0, 2.0]]


@pytest.mark.parametrize("empty", ["", " ", ",,", ", ,", "# remark"])
def test_an_empty_row_holds_no_sample(empty):
    rows = f"t,a,b\n0,1,5\n{empty}\n1,2,6\n"
    assert read(rows) == [[0.0, 1.0], [1.0, 2.0]]
    assert find_table(rows, "log.csv").line_of(1) == 4


def test_optional_last_fields_are_no_cut():
    text = "t,a,remark\n0,1,ok\n1,2\n2,3\n"
    assert cut(text) == (read(text), ())
    assert cut("t,a,remark\n0,1\n1,2\n2,3") == ([[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]], ())


@given(st.integers(0, 12), st.integers(2, 6))
def test_cut_anywhere_in_the_last_line(kept, rows):
    lines = [f"{k / 4:.2f},{1000 + k},{k % 2}.50" for k in range(rows)]
    whole = "t,a,b\n" + "\n".join(lines) + "\n"
    kept = min(kept, len(lines[-1]))
    text = whole[: len(whole) - 1 - len(lines[-1]) + kept]
    values, notes = cut(text, (0, 1, 2))
    expected = read(whole, (0, 1, 2))
    size = rows if kept > len("0.00,1000,") else rows - 1
    np.testing.assert_array_equal(values[:2], np.array(expected[:2])[:, :size])
    assert bool(notes) == (size < rows and kept > 0)


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
BY_FIELD = "# (a bracket is left to the slow way)"


def bits(text: str, decimal: str) -> list[bytes] | str:
    """The bits of two columns, or the sentence of the refusal."""
    try:
        found = find_table(text, "log.csv", decimal=decimal).columns([2, 0])
    except LogError as error:
        return str(error)
    return [a.dtype.str.encode() + a.tobytes() for a in found]


@given(
    st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=1, max_size=30),
    st.sampled_from([(",", "."), (";", ","), ("\t", ","), ("|", "."), ("\t", ".")]),
    st.lists(st.sampled_from(["", "  ", "1;2", "# pause", "stop"]), max_size=1),
    st.sampled_from(["", *ODD, *[""] * 8]),
    st.sampled_from(["", "\n", "\n\n"]),
)
def test_pyarrow_reads_the_same_bits_as_the_slow_way(rows, marks, between, odd, end):
    delimiter, decimal = marks
    rows = [[field.replace(".", decimal) for field in row] for row in rows]
    if odd:
        rows[-1][0] = odd
    lines = [delimiter.join(row) for row in rows]
    lines[1:1] = between
    head = delimiter.join("abc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(delimited, "BLOCK", 64)
        fast = bits("\n".join([head, "#", *lines]) + end, decimal)
        slow = bits("\n".join([head, BY_FIELD, *lines]) + end, decimal)
    assert fast == slow


def test_a_table_on_its_side_is_named():
    wide = "\n".join(",".join([name, *map(str, range(300))]) for name in ("t", "a", "b"))
    with pytest.raises(LogError, match=r"lies on its side \(3 rows of 301 columns\)"):
        find_table(wide, "log.csv", highest=1)
    names = ",".join(f"c{k}" for k in range(300))
    rows = "\n".join(",".join(map(str, range(300))) for _ in range(400))
    assert len(find_table(f"{names}\n{rows}\n", "log.csv").names) == 300


def test_one_long_line_is_refused_at_once():
    """Nothing in a reader costs more than linear time."""
    numbers = ", ".join(f"{k / 100}" for k in range(150_000))
    for text in ('{"t": [' + numbers + "]}", '"' + "x" * 10**6, numbers, "a b " * 250_000):
        with pytest.raises(LogError):
            find_table(text, "log.txt", highest=1).columns([0])
