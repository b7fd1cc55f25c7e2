import pytest

from vttig_jax.base.files.text_tables import key_values, text_table


def test_columns_stand_two_spaces_apart_under_headers_with_units():
    table = text_table([("driving", "0.0226", 1), ("driven", None, 12)], ["gear", ("e", "mm"), "n"])
    assert table.splitlines() == [
        "gear     e [mm]   n",
        "driving  0.0226   1",
        "driven        –  12",
    ]


def test_align_changes_the_layout():
    rows = [("a", "b", "c")]
    headers = ["first", "second", "third"]
    assert text_table(rows, headers).splitlines()[1] == "a           b      c"
    assert text_table(rows, headers, align="rcl").splitlines()[1] == "    a    b     c"


@pytest.mark.parametrize("align", ["l", "lrx", "llll"])
def test_wrong_alignments_are_refused(align):
    with pytest.raises(ValueError, match="Argument `align` must have one letter"):
        text_table([], ["a", "b", "c"], align=align)


def test_digits_stay_as_they_were_written_and_no_line_ends_in_a_space():
    assert "1.500e-05" in text_table([("1.500e-05",)], ["x"])
    assert "007" in key_values([("number", "007")])
    assert text_table([], ["gear", ("e", "mm")]) == "gear  e [mm]"
    table = text_table([("a", ""), ("b", "text")], ["x", "y"], align="ll")
    assert all(line == line.rstrip() for line in table.splitlines())


def test_key_values_indent_below_a_title():
    pairs = [("teeth", "45 / 80"), ("contact ratio", None)]
    assert key_values(pairs) == "teeth          45 / 80\ncontact ratio  –"
    assert key_values(pairs, title="pair") == "pair\n  teeth          45 / 80\n  contact ratio  –"
    assert key_values([], title="pair") == "pair"
