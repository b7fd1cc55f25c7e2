"""`inspect` counts the rows of a column in which there is no number."""

from pathlib import Path

import numpy as np
import pytest

from vttig_jax.logs.preview import preview_log


def notes_of(path: Path, cells: dict[int, str]) -> list[str]:
    """Notes on a log of 300 rows whose driven angle has these cells."""
    angle = np.linspace(0.0, 1080.0, 300)
    driven = [cells.get(row, f"{value / 2:.6f}") for row, value in enumerate(angle)]
    rows = [
        f"{k / 100:.2f},{a:.6f},{d}" for k, (a, d) in enumerate(zip(angle, driven, strict=True))
    ]
    path.write_text("\n".join(["time_s,driving_deg,driven_deg", *rows]) + "\n")
    return list(preview_log(path).notes)


@pytest.mark.parametrize(("cell", "kind"), [("", "empty cells"), ("NaN", "NaN or infinite")])
def test_rows_without_a_number_are_counted(tmp_path: Path, cell: str, kind: str):
    notes = notes_of(tmp_path / "log.csv", {4: cell, 20: cell, 21: cell})
    (note,) = [one for one in notes if "no number" in one]
    assert note.startswith(f"column `driven_deg`: 3 of 300 rows hold no number ({kind}), row 5")
    assert not any("differs in length" in one for one in notes)


def test_a_whole_log_has_no_such_note(tmp_path: Path):
    assert not any("no number" in one for one in notes_of(tmp_path / "log.csv", {}))
