"""A commit of several files: at every moment the old result or the new one, never a mixture."""

import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from tests.base.files.disk_states import contents, recorded
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files import atomic_write as commit
from vttig_jax.base.files.run_folder import RunFolder

OLD = {"run.toml": "old", "summary.npz": "old", "fit.json": "old", "figures/a.png": "old"}
NEW = {"run.toml": "new", "summary.npz": "new", "figures/a.png": "new", "fit.json": "new"}
FOLLOWING = {"map.csv": "of the old fit"}


def write(folder: Path, files: dict[str, str], *, overwrite: bool = False) -> None:
    with RunFolder(folder, overwrite=overwrite, results=("fit.json",)) as run:
        for name in FOLLOWING:
            run.discard(name)
        for name, text in files.items():
            run.write_text(name, text)


def visible(folder: Path) -> dict[str, str]:
    """What a reader sees: all files that are neither hidden nor in a stage."""
    return {
        name: data.decode() for name, data in contents(folder).items() if not name.startswith(".")
    }


@pytest.fixture
def old(tmp_path) -> Path:
    folder = tmp_path / "run"
    write(folder, OLD)
    (folder / "map.csv").write_text(FOLLOWING["map.csv"])
    return folder


def test_an_overwrite_is_old_or_new_at_every_moment(old, tmp_path):
    with recorded(old, tmp_path / "states") as states:
        write(old, NEW, overwrite=True)
    seen = set()
    for state in states:
        commit.settle_if_free(state)
        now = visible(state)
        assert now in (OLD | FOLLOWING, NEW), (state.name, now)
        assert [path.name for path in state.iterdir() if path.name.startswith(".new")] == []
        seen.add(now["fit.json"])
    assert seen == {"old", "new"} and len(states) > 2 * len(NEW)
    assert contents(old) == {name: text.encode() for name, text in NEW.items()}


def test_a_new_run_stands_or_is_written_again_without_overwrite(tmp_path):
    folder = tmp_path / "run"
    with recorded(folder, tmp_path / "states") as states:
        write(folder, NEW)
    outcomes = set()
    for state in states:
        commit.settle_if_free(state)
        stood = (state / "fit.json").exists()
        if stood:
            with pytest.raises(UsageError, match="already exists"):
                write(state, NEW)
        else:
            write(state, NEW)
        assert contents(state) == {name: text.encode() for name, text in NEW.items()}
        outcomes.add(stood)
    assert outcomes == {True, False}


def test_a_killed_first_run_leaves_the_files_of_others(tmp_path):
    folder = tmp_path / "run"
    with recorded(folder, tmp_path / "states") as states:
        write(folder, NEW)
    for state in states:
        changed = state / "run.toml"
        if changed.exists() and not (state / "fit.json").exists():
            changed.write_text("somebody wrote this since")
            with pytest.raises(UsageError, match=r"already exists"):
                write(state, NEW)
            assert changed.read_text() == "somebody wrote this since"
            return
    pytest.fail("no state with a moved companion")


@pytest.mark.parametrize("fresh", [True, False])
def test_every_operation_may_be_refused(old, tmp_path, fresh, monkeypatch):
    """A full disk, no inode, no permission: one sentence, and the old or the new result."""
    real = {name: getattr(os, name) for name in ("rename", "replace", "mkdir", "open", "fsync")}
    refusals = 0
    for number in range(1000):
        folder = tmp_path / f"{fresh}{number}"
        if not fresh:
            shutil.copytree(old, folder)
        left = [number]

        def refusing(name, left=left):
            def call(*arguments, **options):
                left[0] -= 1
                if left[0] == 0:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                return real[name](*arguments, **options)

            return call

        with monkeypatch.context() as patched:
            for name in real:
                patched.setattr(os, name, refusing(name))
            try:
                write(folder, NEW, overwrite=not fresh)
            except InputError as error:
                refusals += "no space left" in error.message
        if folder.exists():
            commit.settle_if_free(folder)
            before = {} if fresh else OLD | FOLLOWING
            assert visible(folder) in (before, NEW), number
            if visible(folder) != NEW:
                write(folder, NEW, overwrite=not fresh)
        if left[0] > 0 and number:
            break
    assert refusals > 10


def test_a_stage_from_elsewhere_touches_nothing_outside(tmp_path):
    folder, outside = tmp_path / "run", tmp_path / "precious"
    outside.write_text("mine")
    (tmp_path / "away").mkdir()
    (tmp_path / "away" / "fit.json").write_text("mine")
    write(folder, OLD)
    (folder / "link").symlink_to(tmp_path / "away")
    for bad in ("../precious", str(outside), "link/fit.json", 7):
        for record in ({"files": [bad], "removed": []}, {"files": [], "removed": [bad]}, {}, 7):
            stage = folder / ".commit-planted"
            (stage / "link").mkdir(parents=True)
            (stage / "link" / "fit.json").write_text("planted")
            (stage / commit.RECORD).write_text(json.dumps(record))
            commit.settle_if_free(folder)
            assert not stage.exists()
    assert outside.read_text() == "mine" and (tmp_path / "away/fit.json").read_text() == "mine"
    assert visible(folder) == OLD | {"link/fit.json": "mine"} or visible(folder) == OLD
