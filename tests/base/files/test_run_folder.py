import errno
import hashlib
import os
import stat
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.base.files.disk_states import contents
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files import atomic_write as commit
from vttig_jax.base.files.run_folder import RunFolder, data_sha256


def one_sentence(error: BaseException) -> bool:
    text = str(error)
    return "\n" not in text and text.endswith(".")


def write_run(
    folder: Path, files: dict[str, str], *, then: type[BaseException] | None = None, **options: Any
) -> None:
    """Write a whole run, and raise `then` before its end."""
    with RunFolder(folder, **options) as run:
        for name, text in files.items():
            run.write_text(name, text)
        if then is not None:
            raise then


def fill_disk(monkeypatch: pytest.MonkeyPatch, after: int = 0) -> None:
    """Let `after` files through, then stop in the middle of the next."""
    real = commit.write_synced
    written = []

    def write(path: Path, data: bytes) -> None:
        if len(written) < after:
            written.append(path)
            real(path, data)
            return
        path.write_bytes(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(commit, "write_synced", write)


def test_a_run_writes_all_kinds_of_files_and_nothing_else(tmp_path):
    with RunFolder(tmp_path / "deep" / "run") as run:
        run.write_text("fit.json", "{“°”}")
        assert not (tmp_path / "deep" / "run" / "fit.json").exists()
        run.write_bytes("figures/te.png", b"\x89PNG")
        run.write_toml("run.toml", {"seed": 0, "data": {"sha256": ["ab"]}})
        run.write_npz("summary.npz", gram=np.eye(2), names=np.array(["a", "b"]))
    folder = tmp_path / "deep" / "run"
    found = contents(folder)
    assert set(found) == {"fit.json", "figures/te.png", "run.toml", "summary.npz"}
    assert found["fit.json"].decode("utf-8") == "{“°”}"
    assert found["figures/te.png"] == b"\x89PNG"
    assert tomllib.loads(found["run.toml"].decode()) == {"seed": 0, "data": {"sha256": ["ab"]}}
    with np.load(folder / "summary.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["gram"], np.eye(2))
        assert arrays["names"].tolist() == ["a", "b"]


def test_files_get_the_permissions_of_any_new_file(tmp_path):
    with RunFolder(tmp_path / "run") as run:
        run.write_text("fit.json", "{}")
    plain = tmp_path / "plain"
    plain.write_text("")
    mode = stat.S_IMODE(plain.stat().st_mode)
    assert stat.S_IMODE((tmp_path / "run" / "fit.json").stat().st_mode) == mode


def test_a_file_is_on_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    steps = []
    real_sync, real_replace = os.fsync, os.replace

    def sync(descriptor: int) -> None:
        steps.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        real_sync(descriptor)

    def replace(source: Path, target: Path) -> None:
        steps.append("move")
        real_replace(source, target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", replace)
    write_run(tmp_path, {"fit.json": "{}"})
    assert steps == ["file", "move", "folder"]


def test_an_existing_result_is_refused_on_entry_unless_overwritten(tmp_path):
    (tmp_path / "fit.json").write_text("old")
    with (
        pytest.raises(UsageError, match=r"already exists; add --overwrite") as caught,
        RunFolder(tmp_path, results=("fit.json",)),
    ):
        pytest.fail("the block must not run")
    assert caught.value.where == str(tmp_path / "fit.json")
    assert contents(tmp_path) == {"fit.json": b"old"}
    with RunFolder(tmp_path, overwrite=True, results=("fit.json",)) as run:
        run.write_text("fit.json", "new")
        assert (tmp_path / "fit.json").read_text() == "old"
    assert contents(tmp_path) == {"fit.json": b"new"}


def test_without_results_an_existing_file_is_refused_when_written(tmp_path):
    (tmp_path / "map.csv").write_text("old")
    with pytest.raises(UsageError, match="already exists"):
        write_run(tmp_path, {"other.txt": "new", "map.csv": "new"})
    assert contents(tmp_path) == {"map.csv": b"old"}


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError])
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_interrupted_run_leaves_the_folder_as_it_was(tmp_path, interruption, overwrite):
    folder = tmp_path / "deep" / "run"
    if overwrite:
        folder.mkdir(parents=True)
        (folder / "fit.json").write_text("old")
    before = contents(tmp_path)
    files = {"fit.json": "new", "figures/te.svg": "new"}
    with pytest.raises(interruption):
        write_run(folder, files, then=interruption, overwrite=overwrite)
    assert contents(tmp_path) == before
    assert (tmp_path / "deep").exists() == overwrite
    assert not (folder / "figures").exists()


@pytest.mark.parametrize("after", [0, 1])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_full_disk_is_one_sentence_and_leaves_no_half_file(
    tmp_path, monkeypatch, after, overwrite
):
    folder = tmp_path / "run"
    if overwrite:
        folder.mkdir()
        (folder / "fit.json").write_text("old")
    before = contents(tmp_path)
    fill_disk(monkeypatch, after)
    with pytest.raises(InputError, match="no space left") as caught:
        write_run(folder, {"run.toml": "seed = 0", "fit.json": "{}"}, overwrite=overwrite)
    assert one_sentence(caught.value)
    assert caught.value.exit_code == 3
    assert contents(tmp_path) == before
    assert folder.exists() == overwrite


def test_a_move_that_fails_after_the_switch_is_made_by_the_next_reader(tmp_path, monkeypatch):
    real, folder = os.replace, tmp_path / "run"

    def replace(source: Path, target: Path) -> None:
        if Path(target).name == "fit.json":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
        real(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", replace)
        with pytest.raises(InputError, match="no permission to write here") as caught:
            write_run(folder, {"run.toml": "", "fit.json": "{}"}, results=("fit.json",))
    assert caught.value.where == str(folder / "fit.json")
    commit.settle_if_free(folder)
    assert contents(folder) == {"run.toml": b"", "fit.json": b"{}"}


def test_a_folder_in_the_way_of_a_file_leaves_all_as_it_was(tmp_path):
    (tmp_path / "run" / "fit.json").mkdir(parents=True)
    with pytest.raises(InputError, match="a folder is in the way"):
        write_run(tmp_path / "run", {"run.toml": "", "fit.json": "{}"}, overwrite=True)
    assert contents(tmp_path) == {}


def test_no_permission_to_make_the_folder(tmp_path, monkeypatch):
    # Faked: the tests may run as root, whom no permission stops.
    def mkdir(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr(Path, "mkdir", mkdir)
    with pytest.raises(InputError, match="no permission") as caught, RunFolder(tmp_path / "run"):
        pytest.fail("the block must not run")
    assert caught.value.where == str(tmp_path / "run")
    assert one_sentence(caught.value)


@pytest.mark.parametrize("below", ["", "sub/run"])
def test_a_file_where_the_folder_should_be(tmp_path, below):
    (tmp_path / "run").write_text("a file")
    with (
        pytest.raises(InputError, match="a file is in the way of this folder"),
        RunFolder(tmp_path / "run" / below),
    ):
        pytest.fail("the block must not run")
    assert contents(tmp_path) == {"run": b"a file"}


def test_a_second_process_is_refused(tmp_path):
    code = (
        "import sys\nfrom vttig_jax.base.files.run_folder import RunFolder\n"
        "from vttig_jax.base.errors import UsageError\n"
        "try:\n    RunFolder(sys.argv[1]).__enter__()\n"
        "except UsageError as error:\n    print(error.message)\n"
    )
    with RunFolder(tmp_path):
        done = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
        )
    assert "another vttig is writing" in done.stdout


def test_names_outside_the_folder_are_refused(tmp_path):
    for name in ("/etc/x", "../x", "a/../../x", ""):
        with (
            pytest.raises(ValueError, match="Argument `name` must be a file name inside"),
            RunFolder(tmp_path) as run,
        ):
            run.write_text(name, "")


def test_writing_outside_the_with_block_is_refused(tmp_path):
    run = RunFolder(tmp_path)
    with pytest.raises(ValueError, match="inside the `with` block"):
        run.write_text("a.txt", "")


def test_python_objects_are_never_pickled(tmp_path):
    with (
        pytest.raises(ValueError, match="Argument `bad` must be an array of numbers"),
        RunFolder(tmp_path) as run,
    ):
        run.write_npz("summary.npz", bad=np.array([object()]))
    assert contents(tmp_path) == {}


def test_equal_arrays_give_equal_bytes(tmp_path):
    for name in ("a", "b"):
        with RunFolder(tmp_path / name) as run:
            run.write_npz("summary.npz", gram=np.eye(3))
    found = contents(tmp_path)
    assert found["a/summary.npz"] == found["b/summary.npz"]


def test_discarded_files_go_with_the_old_result_only(tmp_path):
    with RunFolder(tmp_path) as run:
        for name in ("fit.json", "map.csv", "map.json"):
            run.write_text(name, "old")
    with (
        pytest.raises(ValueError, match="inside the run"),
        RunFolder(tmp_path, overwrite=True) as run,
    ):
        run.write_text("../fit.json", run.discard("map.csv") or "new")
    assert contents(tmp_path)["map.csv"] == b"old"
    with RunFolder(tmp_path, overwrite=True) as run:
        for name in ("map.csv", "map.json", "never_there"):
            run.discard(name)
        for name in ("fit.json", "map.json"):
            run.write_text(name, "new")
    assert contents(tmp_path) == {"fit.json": b"new", "map.json": b"new"}


def test_hashes_come_in_the_order_of_the_files(tmp_path):
    first, second = tmp_path / "1.csv", tmp_path / "2.csv"
    first.write_bytes(b"one")
    second.write_bytes(b"two")
    expected = [hashlib.sha256(data).hexdigest() for data in (b"two", b"one")]
    assert data_sha256([second, first]) == expected
    with pytest.raises(InputError, match="cannot be read") as caught:
        data_sha256([first, tmp_path / "3.csv"])
    assert caught.value.where == str(tmp_path / "3.csv")
