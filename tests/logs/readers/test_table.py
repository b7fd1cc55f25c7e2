import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.delimited import find_table

pytestmark = pytest.mark.smoke


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


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("t,a\n0,1\n1,oops\n2,3\n", "line 3, column `a`", "`oops` is no number"),
        ("t,a\n0,1\n1,\n2,3\n", "line 3, column `a`", "empty"),
        ("t,a\n0,1\n1\n2,3\n", "line 3, column `a`", "empty"),
        ("t,a\n0,1\nend of log\n1,2\n", "line 3, column `t`", "no number"),
        ("t;a\n0;1,5\n1;1,5,5\n2;2,5\n", "line 3, column `a`", "`1,5,5`"),
        ("t,a\n0,004,1,5\n", "line 2", "semicolons"),
        ("t;a\n0;1;2\n", "line 2", "correct the header"),
        ("1,2\n3,4\n", "log.csv", "no table"),
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


def numbered(text, highest=1, indices=None, **options):
    table = find_table(text, "log.csv", highest=highest, **options)
    found = [column.tolist() for column in table.columns(indices or range(len(table.names)))]
    return table.names, found


@pytest.mark.parametrize(
    "text",
    [
        "0.5,1\n1.5,2\n",
        "0.5;1\n1.5;2",
        "0,5;1\n1,5;2\n",
        "0,5 1,0\n1,5 2,0\n",
        " 0.5  1\n 1.5  2\n",
        "# recorded by us\n\n0.5,1\n# pause\n1.5,2\n",
        "0.5,1,\n1.5,2,\n",
        '"0,5","1"\n"1,5","2"\n',
    ],
)
def test_tables_without_a_header(text):
    assert numbered(text) == (("#1", "#2"), [[0.5, 1.5], [1.0, 2.0]])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("0.5\n1.5\n", "#1"),
        ("\n# angle of the table\n0.5\n\n1.5", "#1"),
        ("0,5\n1,5\n", "#1"),
        ("angle_deg\n0.5\n1.5\n", "angle_deg"),
        ("# angle_deg\n0.5\n1.5\n", "angle_deg"),
        ("0.5;\n1.5;\n", "#1"),
        ("recorded by us\n\n0.5\n1.5\n", "#1"),
    ],
)
def test_single_columns(text, name):
    decimal = "," if "0,5" in text else None
    assert numbered(text, decimal=decimal) == ((name,), [[0.5, 1.5]])


def test_numbers_of_columns_under_a_header_change_nothing():
    text = "t,a\n0.5,1\n1.5,2\n"
    assert find_table(text, "x", highest=2).names == find_table(text, "x").names


@pytest.mark.parametrize("head", ["! columns: t[s] a[deg]", "time motor angle", "of rig 7 by Ann"])
def test_words_between_blanks_are_no_names_of_fewer_columns(head):
    """Names that are shifted against the columns would give a wrong role."""
    rows = "\n0.5 1\n1.5 2\n"
    assert find_table(head + rows, "log.csv", highest=1).names == ("#1", "#2")
    with pytest.raises(LogError, match="no table"):
        find_table(head + rows, "log.csv")
    assert find_table(f"t a\n{head}{rows}", "log.csv").names == ("t", "a")


def test_places_without_a_header():
    table = find_table("# us\n1,2\n\n3,4\n5,oops\n6,7\n", "log.csv", highest=2)
    assert [table.line_of(row) for row in (0, 1)] == [2, 4]
    with pytest.raises(LogError, match="line 5, column `#2`: `oops` is no number"):
        table.columns([1])


def test_a_comma_between_digits_without_a_header_is_refused_where_it_is_doubtful():
    text = "147,31\n147,33\n"
    with pytest.raises(LogError, match="`147,31` means 2 columns, or one number") as caught:
        numbered(text)
    assert "--decimal" in caught.value.message and "line 1" in caught.value.where
    assert numbered(text, highest=2)[1] == [[147.0, 147.0], [31.0, 33.0]]
    assert numbered(text, decimal=".")[1] == [[147.0, 147.0], [31.0, 33.0]]
    assert numbered(text, decimal=",")[1] == [[147.31, 147.33]]
    assert numbered(text, delimiter=",")[1] == [[147.0, 147.0], [31.0, 33.0]]
    assert len(numbered("147, 31\n147, 33\n")[1]) == 2
    assert len(numbered("147,-31\n147,33\n")[1]) == 2
    assert len(numbered("1,2,3\n4,5,6\n")[1]) == 3
    with pytest.raises(LogError, match="means 4 columns, or 2 numbers"):
        numbered("0,5,1,5\n1,5,2,5\n", highest=2)
    assert len(numbered("0,5,1,5\n1,5,2,5\n", highest=3)[1]) == 4


def test_no_numbers_at_all():
    with pytest.raises(LogError, match="no table of numbers"):
        numbered("hello\nworld\n")
    with pytest.raises(LogError, match="driving=#1 and driven=#row"):
        find_table("1.5\n2.5\n", "log.csv")


def test_a_first_row_with_an_empty_field_is_no_header():
    """Channels that are not sampled together leave fields empty, and most rows are shorter."""
    rows = ["0.0;0.5;;25.1", "0.7;;0.2;", "2.0;0.7;;", "2.7;;0.3;", "4.0;0.9;;", "4.7;;0.4;"]
    table = find_table("\n".join(["t [s];a [deg];b [deg];c", *rows]), "log.csv")
    assert table.names == ("t [s]", "a [deg]", "b [deg]", "c")
    with pytest.raises(LogError, match=r"line 2, column `b \[deg\]`: the field is empty"):
        table.columns([0, 1, 2])
