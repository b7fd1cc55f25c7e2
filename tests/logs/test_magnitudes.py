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


@pytest.mark.parametrize("column", COLUMNS[1:3])
def test_a_shaft_that_moves_by_less_than_any_encoder_tells(written, column):
    path, pair = written(column, 1e-300)
    with pytest.raises(LogError, match="is constant at"):
        read_log(path, pair)
    assert preview_log(path).ratio is None


@pytest.mark.parametrize(("column", "factor"), [("time_s", 1e-3), ("torque_nm", 1e20)])
def test_unusual_but_possible(written, column, factor):
    path, pair = written(column, factor)
    assert len(read_log(path, pair)) > 900


@pytest.mark.parametrize(
    "stamp", ["9" * 400, "9" * 5000, "1e9", "99999999999²", "1" + "." + "9" * 400]
)
def test_stamps_of_no_clock(written, stamp):
    """Very long numbers, and digits that are no numbers, are refused at their line."""
    path, pair = written("time_s", 1.0)
    lines = path.read_text().splitlines()
    lines[1:] = [
        f"{number}{line[line.index('.') :]}" for number, line in enumerate(lines[1:], 10**10)
    ]
    lines[3] = stamp + lines[3][lines[3].index(",") :]
    path.write_text("\n".join(lines))
    with pytest.raises(LogError) as caught:
        read_log(path, pair)
    assert "line 4" in caught.value.where or "line 5" in caught.value.where, caught.value


def test_turns(written):
    """Angles whose decimal mark is lost are refused, because memory grows with the turns."""
    path, pair = written("driving_deg", 1e8)
    with pytest.raises(LogError, match="more than any shaft does"):
        read_log(path, pair)
    for factor in (1.0, 100.0):
        assert len(read_log(written("driving_deg", factor)[0], pair)) > 900
