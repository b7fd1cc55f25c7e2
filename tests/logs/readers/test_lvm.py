"""LabVIEW measurement files: one column of time, one for each channel, or none."""

import re

import numpy as np
import pytest

from tests.logs.rig_log import angles_deg
from vttig_jax.base.errors import LogError
from vttig_jax.logs import read_log

T, X, Y = angles_deg()
STEP = float(T[1] - T[0])


def lvm(columns: str, rows: str, *, decimal: str = ".", unit: str = "deg", x: str = "Time") -> str:
    names = "X_Value\tmotor\tX_Value\tload" if columns == "Multi" else "X_Value\tmotor\tload"
    head = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Separator\tTab",
        f"Decimal_Separator\t{decimal}",
        f"X_Columns\t{columns}",
        "Time\t14:02:11.1234",
        "***End_of_Header***\t",
        "\t",
        "Channels\t2",
        f"Samples\t{len(T)}\t{len(T)}",
        f"Y_Unit_Label\t{unit}\t{unit}",
        f"X_Dimension\t{x}\t{x}",
        "X0\t0.5\t0.5".replace(".", decimal),
        f"Delta_X\t{STEP}\t{STEP}".replace(".", decimal),
        "***End_of_Header***\t",
        f"{names}\tComment",
    ]
    return "\n".join([*head, rows.replace(".", decimal)])


def rows_of(columns: str, late_s: float = 0.0, stretch: float = 1.0) -> str:
    fields = {
        "No": ["" for _ in T],
        "One": [f"{t:.4f}" for t in T],
        "Multi": [f"{t:.4f}" for t in T],
    }[columns]
    second = [f"\t{stretch * t + late_s:.6f}" if columns == "Multi" else "" for t in T]
    return "".join(
        f"{a}\t{x:.6f}{b}\t{y:.6f}\n" for a, x, b, y in zip(fields, X, second, Y, strict=True)
    )


@pytest.fixture
def read(tmp_path):
    def write_and_read(text: str):
        path = tmp_path / "log.lvm"
        path.write_text(text, encoding="utf-8")
        return read_log(path, ratio="16:9")

    return write_and_read


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("columns", ["No", "One", "Multi"])
def test_all_forms_hold_the_same_log(read, columns, decimal):
    log = read(lvm(columns, rows_of(columns), decimal=decimal))
    np.testing.assert_allclose(np.degrees(log.driving_angle), X - X[0], atol=2e-6)
    np.testing.assert_allclose(np.diff(log.time), STEP, atol=1e-9)
    assert log.time[0] == (0.5 if columns == "No" else 0.0)
    assert any("LabVIEW" in note for note in log.notes)


def test_channels_with_stamps_of_their_own_are_brought_onto_one_clock(read):
    log = read(lvm("Multi", rows_of("Multi", late_s=0.3 * STEP, stretch=1.01)))
    assert any("stamps of their own" in note for note in log.notes)
    assert any("clock of" in note for note in log.notes)


@pytest.mark.parametrize("kept", [-4, -12])
def test_a_last_row_that_was_not_written_to_its_end_is_left_out(read, kept):
    log = read(lvm("One", rows_of("One"))[:kept])
    assert len(log) == len(T) - 1 and any("left out" in note for note in log.notes)


def test_a_unit_that_the_header_lacks_is_asked_for(read):
    with pytest.raises(LogError, match="names no unit"):
        read(lvm("One", rows_of("One"), unit=""))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text[: text.index("X_Value")], "no rows of numbers"),
        (lambda text: text[: text.index("Channels")], "no rows of numbers"),
        (lambda text: text.replace("X_Dimension\tTime", "X_Dimension\tFrequency"), "Frequency"),
        (lambda text: text + "***End_of_Header***\n0\t1\t2\n", "2 segments"),
        (lambda text: text.replace("0.0200\t", "0.0x\t", 1), "`0.0x` is no number"),
        (lambda text: text.replace("Separator\t.", "Separator\t.x"), "`.x`"),
        (lambda text: re.sub(r"\t-?[\d.]+\n(?=0.0300)", "\t\n", text), "line 19: .* empty"),
    ],
)
def test_damaged_files(read, damage, words):
    text = lvm("One", rows_of("One"))
    assert damage(text) != text
    with pytest.raises(LogError, match=words) as caught:
        read(damage(text))
    assert "log.lvm" in caught.value.where
