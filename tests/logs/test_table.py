import numpy as np
import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.logs.table import find_table, split


def read(text, indices=(0, 1), **options):
    table = find_table(text, "log.csv", **options)
    return [column.tolist() for column in table.columns(indices)]


@pytest.mark.parametrize(
    ("text", "delimiter"),
    [
        ("t,a\n0.5,1\n1.5,2\n", ","),
        ("t;a\n0.5;1\n1.5;2\n", ";"),
        ("t;a\n0,5;1\n1,5;2\n", ";"),
        ("t\ta\n0,5\t1\n1,5\t2\n", "\t"),
        ("t|a\n0.5|1\n1.5|2\n", "|"),
        ("t   a\n 0.5  1\n 1.5  2\n", None),
        ("t [s] a [deg]\n0.5 1\n1.5 2", None),
        ("t a\n0,5 1\n1,5 2\n", None),
        ("# t,a\n0.5,1\n1.5,2\n", ","),
        ("Rig 7, run 3\nrecorded by us\n\nt,a\n0.5,1\n1.5,2\n\n", ","),
        ("% rig\n// more\nt,a\n# units below\n0.5,1\n# pause\n1.5,2 # last\n", ","),
        ("t,a,\n0.5,1,\n1.5,2,\n", ","),
        ('"t","a"\n"0,5","1"\n"1,5","2"\n', ","),
        ("t,a,state\n0.5,1,ok\n1.5,2,ok\n", ","),
    ],
)
def test_layouts(text, delimiter):
    assert find_table(text, "log.csv").delimiter == delimiter
    assert read(text) == [[0.5, 1.5], [1.0, 2.0]]


def test_names_and_places():
    table = find_table("Rig\n\ntime [s];a\n0;1\n\n# pause\n1;2\n", "log.csv")
    assert table.names == ("time [s]", "a")
    assert [table.line_of(row) for row in (0, 1)] == [4, 7]
    assert find_table("t [s] a (deg)\n0 1\n", "x").names == ("t[s]", "a(deg)")


def test_delimiter_given():
    text = "a,b;c\n1,5;2\n"
    assert find_table(text, "log.csv").names == ("a,b", "c")
    assert find_table("a;x b;c\n1;2;3\n", "log.csv", delimiter=";").names == ("a", "x b", "c")
    assert read("a b\n1 2\n", delimiter="space") == [[1.0], [2.0]]
    assert read("a\tb\n1\t2\n", delimiter="tab") == [[1.0], [2.0]]
    with pytest.raises(LogError, match="no delimiter"):
        find_table(text, "log.csv", delimiter="::")


def test_decimal_given():
    assert read('t,a\n0,"1,234"\n', decimal=".") == [[0.0], [1234.0]]
    assert read('t,a\n0,"1,234"\n', decimal=",") == [[0.0], [1.234]]
    assert read("t a\n0 1,234\n", decimal=".") == [[0.0], [1234.0]]
    assert read("t;a\n0;1,234\n", decimal=".") == [[0.0], [1234.0]]
    assert read("t;a\n0;1.234\n", decimal=",") == [[0.0], [1234.0]]


def test_large_counts_stay_integers():
    table = find_table(f"t,a\n0.5,{2**60 + 1}\n0.6,{2**60 + 3}\n", "log.csv")
    time, counts = table.columns([0, 1])
    assert time.dtype == np.float64 and counts.dtype == np.int64
    assert counts.tolist() == [2**60 + 1, 2**60 + 3]


def test_columns_in_the_order_asked():
    assert read("a,b,c\n1,2,3\n", (2, 0)) == [[3.0], [1.0]]


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("t,a\n0,1\n1,oops\n", "line 3, column `a`", "`oops` is no number"),
        ("t,a\n0,1\n1,\n2,3\n", "line 3, column `a`", "empty"),
        ("t,a\n0,1\n1\n2,3\n", "line 3, column `a`", "empty"),
        ("t,a\n0,1\nend of log\n", "line 3, column `t`", "no number"),
        ("t;a\n0;1,5\n1;1,5,5\n", "line 3, column `a`", "`1,5,5`"),
        ("t,a\n0,004,1,5\n", "line 2", "semicolons"),
        ("t;a\n0;1;2\n", "line 2", "correct the header"),
        ("1,2\n3,4\n", "line 1", "without a header"),
        ("t,a\n", "line 1", "without a single line"),
        ("hello\nworld\n", "log.csv", "no table"),
        ("1.5\n2.5\n", "log.csv", "at least two columns"),
        ('t,a\n0,"1,234"\n', "log.csv", "--decimal"),
        ("t a\n0 1,234\n", "log.csv", "--decimal"),
    ],
)
def test_refused(text, where, words):
    with pytest.raises(LogError) as caught:
        read(text)
    assert where in caught.value.where and words in caught.value.message, caught.value


def test_decimal_that_contradicts_the_numbers():
    with pytest.raises(LogError, match=r'`0\.5` is no number; decimal is ","'):
        read("t;a\n0.5;1\n", decimal=",")


def test_split():
    assert split("a, b ,,", ",") == ["a", "b"]
    assert split('"x, y",2', ",") == ["x, y", "2"]
    assert split("  1   2 ", None) == ["1", "2"]
