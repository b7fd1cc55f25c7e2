"""Values that no log can hold are refused at their line, whatever their column."""

import numpy as np
import pytest

from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import LogError
from vttig_jax.logs.preview import preview_log
from vttig_jax.logs.read import read_log
from vttig_jax.pair.load import load_pair

COLUMNS = ("time_s", "driving_deg", "driven_deg", "torque_nm", "speed_rad_per_s")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write the log of the drive with one column multiplied, and read it."""
    folder = tmp_path_factory.mktemp("drive")
    pair = load_pair(write_pair(folder / "pair.toml"))
    lines = write_drive(folder / "log.csv").read_text().splitlines()
    table = np.array([line.split(",") for line in lines[1:]], float)

    def write(column: str, factor: float):
        changed = table.copy()
        changed[:, COLUMNS.index(column)] *= factor
        rows = [",".join(map(repr, row.tolist())) for row in changed]
        (folder / "changed.csv").write_text("\n".join([lines[0], *rows]))
        return folder / "changed.csv", pair

    return write


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e-320, "the log lasts only"),
        (1e-200, "the log lasts only"),
        (1e-9, "the log lasts only"),
        (1e20, "is no time stamp"),
    ],
)
def test_times(written, factor, words):
    path, pair = written("time_s", factor)
    for read in (lambda: read_log(path, pair), lambda: preview_log(path)):
        with pytest.raises(LogError, match=words) as caught:
            read()
        assert "time_s" in caught.value.where and "unit of the time column" in caught.value.message


@pytest.mark.parametrize("column", COLUMNS[1:])
def test_values(written, column):
    path, pair = written(column, 1e300)
    with pytest.raises(LogError, match="too large for a reading") as caught:
        read_log(path, pair)
    assert "line " in caught.value.where and f"`{column}`" in caught.value.where


@pytest.mark.parametrize(("column", "factor"), [("time_s", 1e-3), ("torque_nm", 1e20)])
def test_unusual_but_possible(written, column, factor):
    path, pair = written(column, factor)
    assert len(read_log(path, pair)) > 900


def test_turns(written):
    """Angles whose decimal mark is lost are refused, because memory grows with the turns."""
    path, pair = written("driving_deg", 1e8)
    with pytest.raises(LogError, match="too many for any order to show"):
        read_log(path, pair)
    read_log(written("driving_deg", 1.0)[0], pair)
