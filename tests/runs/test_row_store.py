"""A sweep on disk: whole or to be continued, whatever happens in between."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import vttig_jax
from tests.control import sweep_files
from tests.control.scenarios import PAIR
from tests.control.sweep_files import sweep_spec
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files.atomic_write import temporary_path
from vttig_jax.runs.row_store import (
    HEADER,
    PARTS,
    TABLE,
    FolderNames,
    SweepFolder,
    read_table,
)

AXES = {"motion.reversal_deg": {"from": 200, "to": 350, "num": 24}}
OTHER = {"motion.reversal_deg": {"from": 201, "to": 350, "num": 24}}


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    sweep_files.small_blocks(4, monkeypatch)


def swept(out: Path, axes=AXES, **options):
    return vttig_jax.sweep(sweep_spec(axes, controller="none"), PAIR, out=out, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "swept"
    with pytest.MonkeyPatch.context() as patch:  # the blocks, and so the program, of the tests
        sweep_files.small_blocks(4, patch)
        swept(out)
    return out


def rows_of(out: Path) -> dict[str, np.ndarray]:
    return read_table(out / TABLE)


def assert_same_rows(one: Path, other: Path) -> None:
    mine, theirs = rows_of(one), rows_of(other)
    assert list(mine) == list(theirs)
    for name, values in mine.items():
        np.testing.assert_array_equal(values, theirs[name])


class Stop(Exception):
    """Ends a sweep in its middle."""


def interrupted(out: Path, share: float) -> Path:
    def stop(done: float, all_: float) -> None:
        if done > share * all_:
            raise Stop

    with pytest.raises(Stop):
        swept(out, progress=stop)
    return out


def parts(out: Path) -> list[Path]:
    return sorted((out / PARTS).glob("[0-9]*.parquet"))


def test_the_file_holds_the_columns_and_nothing_else_is_left(whole):
    stored, spec = rows_of(whole), sweep_spec(AXES, controller="none")
    for table in (swept(whole.parent / "again"), vttig_jax.sweep(spec, PAIR)):
        assert list(stored) == list(table.columns)
        for name, values in table.columns.items():
            np.testing.assert_array_equal(stored[name], values)
    np.testing.assert_array_equal(stored["case"], np.arange(24))
    turns = np.linspace(200.0, 350.0, 24)
    np.testing.assert_allclose(stored["motion.reversal_deg"], turns, rtol=1e-12)
    assert {path.name for path in whole.iterdir()} == {TABLE, HEADER}
    schema = pq.read_schema(whole / TABLE)
    assert [str(schema.field(name).type) for name in ("case", "outcome")] == ["int64", "string"]
    column = pq.read_table(whole / TABLE).column("detection_deg")
    assert column.null_count == len(column)  # nobody closes: what did not happen is null


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_resumed_it_ends_with_the_same_rows(share, whole, tmp_path):
    out = interrupted(tmp_path / "swept", share)
    assert 0 < len(parts(out)) < 6 and not (out / TABLE).exists()
    table = swept(out, resume=True)
    assert_same_rows(out, whole)
    assert table.lane_steps < 0.99 * swept(tmp_path / "other").lane_steps
    swept(tmp_path / "third", axes=OTHER)
    with pytest.raises(AssertionError):  # the comparison can fail
        assert_same_rows(tmp_path / "third", whole)


def test_a_sweep_is_neither_lost_nor_taken_for_another(whole, tmp_path):
    out = interrupted(tmp_path / "swept", 0.5)
    with pytest.raises(UsageError, match="holds an unfinished sweep; continue it with --resume"):
        swept(out)
    with pytest.raises(InputError, match="holds another sweep: scenario differ"):
        swept(out, axes=OTHER, resume=True)
    (out / HEADER).write_text("{")
    with pytest.raises(InputError, match="header of this sweep is damaged"):
        swept(out, resume=True)
    swept(out, overwrite=True)
    with pytest.raises(UsageError, match="holds a sweep"):
        swept(out)
    assert_same_rows(out, whole)


def test_resume_starts_goes_on_or_returns_what_is_complete(whole, tmp_path):
    """The same call may be queued again, as with the command line."""
    out = tmp_path / "none"
    first = swept(out, resume=True)
    assert_same_rows(out, whole)
    written = (out / TABLE).stat().st_mtime_ns
    again = swept(out, resume=True)
    assert again.run_s == 0.0 < first.run_s and (out / TABLE).stat().st_mtime_ns == written
    assert again.columns["case"].tolist() == first.columns["case"].tolist()
    with pytest.raises(InputError, match="holds another sweep: scenario differ"):
        swept(out, axes=OTHER, resume=True)
    (out / TABLE).unlink()  # as a kill leaves it: the header, and no block
    assert swept(out, resume=True).lane_steps == first.lane_steps
    assert_same_rows(out, whole)


def test_a_damaged_part_is_made_again(whole, tmp_path, caplog):
    """Files of other programs beside the parts do not count."""
    out = interrupted(tmp_path / "swept", 0.6)
    part = out / PARTS / "00000001.parquet"
    (out / PARTS / "00000001 (1).parquet").write_bytes(part.read_bytes())
    part.write_bytes(part.read_bytes()[:-20])
    temporary_path(part).write_bytes(b"half")  # of a writer that was killed
    swept(out, resume=True)
    assert "1 damaged part is computed again" in caplog.text
    assert_same_rows(out, whole)
    assert {path.name for path in out.iterdir()} == {TABLE, HEADER}


def test_one_writer_at_a_time_which_removes_what_a_killed_one_left(tmp_path):
    """Temporary files of any names of the table and its header, but not those of the user."""
    names = FolderNames("table", "fits.parquet", "fits.json")
    mine = tmp_path / ".mine.tmp"
    for target in (names.table, names.header):
        temporary_path(tmp_path / target).write_text("half")
    mine.write_text("of the user")
    refused = pytest.raises(UsageError, match="another vttig is writing")
    with SweepFolder(tmp_path, {}, names=names), refused:
        swept(tmp_path)
    assert sorted(tmp_path.glob(".*")) == [mine]


def test_a_full_disk_is_one_sentence_and_keeps_what_is_there(whole, tmp_path, monkeypatch):
    out = tmp_path / "swept"
    written = []

    def full(path, data):
        if "parts" in str(path):
            written.append(path)
            if len(written) == 3:
                raise OSError(28, "No space left on device")
        path.write_bytes(data)

    with monkeypatch.context() as patched:
        patched.setattr("vttig_jax.base.files.atomic_write.write_synced", full)
        with pytest.raises(InputError, match="no space left to write it"):
            swept(out)
    assert len(parts(out)) == 2
    swept(out, resume=True)
    assert_same_rows(out, whole)
