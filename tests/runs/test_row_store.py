"""A sweep on disk: whole or to be continued, whatever happens in between."""

import os
import shutil
import signal
import subprocess
import sys
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


def interrupted(out: Path, share: float, **options) -> None:
    def stop(done: float, all_: float) -> None:
        if done > share * all_:
            raise Stop

    with pytest.raises(Stop):
        swept(out, progress=stop, **options)


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
    assert (
        str(schema.field("case").type) == "int64" and str(schema.field("outcome").type) == "string"
    )


def test_what_did_not_happen_is_null(whole):
    column = pq.read_table(whole / TABLE).column("detection_deg")
    assert column.null_count == len(column)  # nobody closes


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_resumed_it_ends_with_the_same_rows(share, whole, tmp_path):
    out = tmp_path / "swept"
    interrupted(out, share)
    parts = sorted((out / PARTS).glob("*.parquet"))
    assert 0 < len(parts) < 6 and not (out / TABLE).exists()
    before = {path: path.stat().st_mtime_ns for path in parts}
    table = swept(out, resume=True)
    assert_same_rows(out, whole)
    assert table.lane_steps < 0.99 * swept(tmp_path / "other").lane_steps
    assert before  # those parts were not simulated again


def test_the_comparison_of_rows_can_fail(whole, tmp_path):
    other = swept(
        tmp_path / "swept", axes={"motion.reversal_deg": {"from": 200, "to": 351, "num": 24}}
    )
    assert other.path is not None
    with pytest.raises(AssertionError):
        assert_same_rows(other.path.parent, whole)


def test_an_unfinished_sweep_is_neither_lost_nor_taken_for_another(whole, tmp_path):
    out = tmp_path / "swept"
    interrupted(out, 0.5)
    with pytest.raises(UsageError, match="holds an unfinished sweep; continue it with --resume"):
        swept(out)
    other = {"motion.reversal_deg": {"from": 201, "to": 350, "num": 24}}
    with pytest.raises(InputError, match="holds another sweep: scenario differ"):
        swept(out, axes=other, resume=True)
    (out / HEADER).write_text("{")
    with pytest.raises(InputError, match="header of this sweep is damaged"):
        swept(out, resume=True)
    swept(out, overwrite=True)
    assert_same_rows(out, whole)


def test_a_whole_sweep_is_refused_or_replaced(whole, tmp_path):
    out = shutil.copytree(whole, tmp_path / "swept")
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
    other = {"motion.reversal_deg": {"from": 201, "to": 350, "num": 24}}
    with pytest.raises(InputError, match="holds another sweep: scenario differ"):
        swept(out, axes=other, resume=True)


def test_a_damaged_part_is_made_again(whole, tmp_path, caplog):
    """Files of other programs beside the parts do not count."""
    out = tmp_path / "swept"
    interrupted(out, 0.6)
    part = out / PARTS / "00000001.parquet"
    (out / PARTS / "00000001 (1).parquet").write_bytes(part.read_bytes())
    part.write_bytes(part.read_bytes()[:-20])
    swept(out, resume=True)
    assert "1 damaged part is computed again" in caplog.text
    assert_same_rows(out, whole)


def test_a_second_writer_is_refused(tmp_path):
    out = tmp_path / "swept"
    with (
        SweepFolder(out, {"block": 4}),
        pytest.raises(UsageError, match="another vttig is writing"),
    ):
        swept(out)


def test_temporary_files_of_a_killed_writer_are_removed_whatever_the_names(tmp_path):
    names = FolderNames("table", "fits.parquet", "fits.json")
    mine = tmp_path / ".mine.tmp"
    for target in (names.table, names.header):
        temporary_path(tmp_path / target).write_text("half")
    mine.write_text("of the user")
    with SweepFolder(tmp_path, {}, names=names):
        pass
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
    assert len(list((out / PARTS).glob("[0-9]*.parquet"))) == 2
    swept(out, resume=True)
    assert_same_rows(out, whole)


KILLED = """
import os, signal, sys
import vttig_jax
vttig_jax.enable_x64()
from tests.control.scenarios import PAIR
from tests.control import sweep_files
from tests.control.sweep_files import sweep_spec
from tests.runs.test_row_store import AXES
from vttig_jax.base.files import atomic_write
sweep_files.small_blocks(4)
original = atomic_write.write_synced

def killing(path, data):
    if "2.parquet." in path.name:
        path.write_bytes(data[: len(data) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
    original(path, data)

atomic_write.write_synced = killing
vttig_jax.sweep(sweep_spec(AXES, controller="none"), PAIR, out=sys.argv[1])
"""


@pytest.mark.slow
def test_killed_in_the_middle_it_ends_with_the_same_rows(whole, tmp_path):
    """Half a part on the disk; a process of its own takes most of the time."""
    out = tmp_path / "swept"
    command = [sys.executable, "-c", KILLED, str(out)]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        command, cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert len(list((out / PARTS).glob("[0-9]*.parquet"))) == 2
    swept(out, resume=True)
    assert_same_rows(out, whole)
    assert {path.name for path in out.iterdir()} == {TABLE, HEADER}
