import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.number_format import choose_decimal, looks_like_number, to_number


@pytest.mark.parametrize(
    ("field", "decimal", "value"),
    [
        ("12", ".", 12.0),
        (" -1.5e-3 ", ".", -1.5e-3),
        (".5", ".", 0.5),
        ("5.", ".", 5.0),
        ("1,5", ",", 1.5),
        ("1,5E3", ",", 1500.0),
        ("1,234", ".", 1234.0),
        ("1,234,567.5", ".", 1234567.5),
        ("1.234,5", ",", 1234.5),
        ("1,5", ".", None),
        ("1.5", ",", None),
        ("0x10", ".", None),
        ("1_000", ".", None),
        ("", ".", None),
        ("1 000", ".", None),
        ("12,34,567", ".", None),
        ("1'234'567.5", ".", 1234567.5),
        ("-1’234,5", ",", -1234.5),
        ("1\u00a0234,5", ",", 1234.5),
        ("12\u202f345\u202f678", ".", 12345678.0),
        ("1\u20091234", ".", None),
        ("1'23", ".", None),
        ("'123", ".", None),
    ],
)
def test_to_number(field, decimal, value):
    assert to_number(field, decimal) == value


def test_values_that_are_not_finite_are_numbers():
    assert looks_like_number("1\u00a0234,5") and not looks_like_number("1\u00a02345")
    assert looks_like_number("NaN") and looks_like_number("-inf")
    assert not looks_like_number("name") and not looks_like_number("")
    assert to_number("-Inf", ",") == -float("inf")


@given(st.floats(-1e9, 1e9), st.sampled_from([".", ","]))
def test_every_float_comes_back(value, decimal):
    assert to_number(repr(value).replace(".", decimal), decimal) == value


@pytest.mark.parametrize(
    ("fields", "delimiter", "decimal"),
    [
        (["1", "2"], ";", "."),
        (["1", "2.5"], ",", "."),
        (["1,234", "2,345"], ";", ","),
        (["1,234", "2,345"], "\t", ","),
        (["1,234", "0,5"], None, ","),
        (["0,5"], ",", ","),
        (["1'234,5"], ";", ","),
    ],
)
def test_decimal_mark(fields, delimiter, decimal):
    assert choose_decimal(fields, delimiter, "log.csv") == decimal


@pytest.mark.parametrize(
    ("fields", "delimiter", "words"),
    [
        (["1,234", "2,345"], None, "`1,234` means 1.234 or 1234"),
        (["12,345"], ",", "`12,345` means 12.345 or 12345"),
        (["1.234,5"], ";", "numbers with points"),
        (["1,5", "2.5"], "\t", "numbers with points"),
    ],
)
def test_ambiguous(fields, delimiter, words):
    with pytest.raises(LogError, match="--decimal") as caught:
        choose_decimal(fields, delimiter, "log.csv")
    assert words in str(caught.value) and caught.value.where == "log.csv"
