"""Packed texts and workbooks: the same log, damaged files in one sentence, bombs refused."""

import bz2
import gzip
import lzma

import numpy as np
import pyarrow as pa
import pytest

from tests.logs.rig_log import angles_deg, csv
from tests.logs.workbooks import ods, ods_cell, xlsx
from vttig_jax.base.errors import InputError, LogError
from vttig_jax.logs import read_log
from vttig_jax.logs.readers.packed import unpacked
from vttig_jax.logs.readers.text import read_text

T, X, Y = (one[:500].round(6) for one in angles_deg())
TEXT = csv("time_s,motor_deg,load_deg", T, X, Y)
PACKERS = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": lambda data: pa.compress(data, codec="zstd", asbytes=True),
}

HEAD = ["time_s", "motor_deg", "load_deg"]
TABLE = [HEAD, *([float(v) for v in row] for row in zip(T, X, Y, strict=True))]


def book_of(kind: str) -> bytes:
    pytest.importorskip("python_calamine")
    if kind == "ods":
        rows = (f"<table:table-row>{''.join(map(ods_cell, r))}</table:table-row>" for r in TABLE)
        return ods("".join(rows))
    units = [["time", "motor", "load"], ["s", "°", "°"], *TABLE[1:]]
    sheets: dict[str, list] = {
        "plain": {"Data": TABLE},
        "a title": {"Data": [["Bench 7"], [], *TABLE]},
        "units": {"Data": units},
        "other sheets": {"About": [["Bench", "7"], ["by", "Ann"]], "Data": TABLE, "Empty": []},
    }[kind]
    return xlsx(sheets)


def the_same(path, **options) -> None:
    log = read_log(path, ratio="16:9", **options)
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    np.testing.assert_allclose(log.driving.reading, X, atol=1e-9)
    np.testing.assert_allclose(log.driven.reading, Y, atol=1e-9)


@pytest.mark.parametrize("ending", PACKERS)
@pytest.mark.parametrize("name", ["log.csv{}", "log{}", "log.txt"])
def test_packed_texts(tmp_path, ending, name):
    path = tmp_path / name.format(ending)
    path.write_bytes(PACKERS[ending](TEXT.encode("utf-16")))
    the_same(path)
    assert read_text(path, None)[1] != read_text(path, "utf-16")[0]


@pytest.mark.parametrize("kind", ["plain", "a title", "units", "other sheets", "ods"])
def test_workbooks(tmp_path, kind):
    path = tmp_path / ("log.ods" if kind == "ods" else "log.xlsx")
    path.write_bytes(book_of(kind))
    the_same(path)


def test_the_line_of_a_cell_is_the_row_of_its_sheet(tmp_path):
    pytest.importorskip("python_calamine")
    rows = [row.copy() for row in TABLE]
    rows[41][2] = "oops"
    path = tmp_path / "log.xlsx"
    path.write_bytes(xlsx({"About": [["Bench", "7"]], "Data": rows}))
    with pytest.raises(LogError, match="line 42, column `load_deg`"):
        read_log(path, ratio="16:9")


@pytest.mark.parametrize("ending", PACKERS)
def test_a_packed_text_that_is_cut_off(ending):
    packed = PACKERS[ending](TEXT.encode())
    assert unpacked(packed, "log") == TEXT.encode() == unpacked(TEXT.encode(), "log")
    for size in (12, len(packed) // 2, len(packed) - 1):
        with pytest.raises(LogError, match="damaged, cut off"):
            unpacked(packed[:size], "log")


def test_damaged_workbooks():
    book = book_of("plain")
    for size in (30, len(book) // 2, len(book) - 1):
        with pytest.raises(LogError, match="damaged, cut off"):
            unpacked(book[:size], "log.xlsx")


@pytest.mark.parametrize(
    "bomb",
    [
        lambda: gzip.compress(bytes(1 << 29)),
        lambda: xlsx({"far": '<row r="1"><c r="XFD1048576"><v>1</v></c></row>'}),
        lambda: ods(
            '<table:table-row table:number-rows-repeated="3000">'
            f"{ods_cell(1.0, 16_000)}</table:table-row>"
        ),
        lambda: xlsx({"long": "<row/>" * (50 << 20)}),
    ],
    ids=["gzip", "a far cell", "repeated cells", "long XML"],
)
def test_bombs(bomb):
    pytest.importorskip("python_calamine")
    with pytest.raises(InputError, match="--most-memory"):
        unpacked(bomb(), "log")


def test_empty_rows_at_the_end_are_no_bomb():
    pytest.importorskip("python_calamine")
    first = f"<table:table-row>{ods_cell(1.0)}{ods_cell(2.0)}</table:table-row>"
    empty = '<table:table-cell table:number-columns-repeated="16384"/>'
    empty = f'<table:table-row table:number-rows-repeated="1048000">{empty}</table:table-row>'
    assert unpacked(ods(first + empty), "log.ods") == b"1\t2\n"
