import errno
import hashlib
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.base.files.disk_states import contents
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files import atomic_write as commit
from vttig_jax.base.files.run_folder import RunFolder, data_sha256

RUN = {"run.toml": "", "fit.json": "{}"}


def write_run(
    folder: Path, files: dict[str, str], *, then: type[BaseException] | None = None, **options: Any
) -> None:
    """Write a whole run, and raise `then` before its end."""
    with RunFolder(folder, **options) as run:
        for name, text in files.items():
            run.write_text(name, text)
        if then is not None:
            raise then


def assert_not_entered(
    folder: Path, error: type[InputError | UsageError], words: str, **options: Any
) -> Any:
    """The context is refused before its block in one sentence; returns the place of the error."""
    with pytest.raises(error, match=words) as caught, RunFolder(folder, **options):
        pytest.fail("the block must not run")
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    return caught.value.where


def refuse(patch: pytest.MonkeyPatch, owner: Any, operation: str, place: int, name: str) -> None:
    """Deny an operation on paths that end in a name; a superuser has every permission."""
    real = getattr(owner, operation)

    def call(*arguments: Any, **options: Any) -> Any:
        if Path(arguments[place]).name == name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(arguments[place]))
        return real(*arguments, **options)

    patch.setattr(owner, operation, call)


def test_a_run_writes_all_kinds_of_files_and_nothing_else(tmp_path):
    folder, plain = tmp_path / "deep" / "run", tmp_path / "plain"
    with RunFolder(folder) as run:
        run.write_text("fit.json", "{“°”}")
        assert not (folder / "fit.json").exists()
        run.write_bytes("figures/te.png", b"\x89PNG")
    found = contents(folder)
    assert set(found) == {"fit.json", "figures/te.png"}
    assert found["fit.json"].decode("utf-8") == "{“°”}"
    assert found["figures/te.png"] == b"\x89PNG"
    plain.write_text("")
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (plain, folder / "fit.json")]
    assert modes[0] == modes[1]


def test_a_file_is_on_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    steps, real_sync, real_replace = [], os.fsync, os.replace

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


def test_an_existing_file_is_refused_unless_overwritten(tmp_path):
    (tmp_path / "fit.json").write_text("old")
    results = {"results": ("fit.json",)}
    where = assert_not_entered(tmp_path, UsageError, "already exists; add --overwrite", **results)
    assert where == str(tmp_path / "fit.json")
    with pytest.raises(UsageError, match="already exists"):  # no result is named: when written
        write_run(tmp_path, {"other.txt": "new", "fit.json": "new"})
    assert contents(tmp_path) == {"fit.json": b"old"}
    with RunFolder(tmp_path, overwrite=True, **results) as run:
        run.write_text("fit.json", "new")
        assert (tmp_path / "fit.json").read_text() == "old"
    assert contents(tmp_path) == {"fit.json": b"new"}


@pytest.mark.parametrize("failure", [KeyboardInterrupt, RuntimeError, "a full disk", "at once"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_that_ends_early_leaves_the_folder_as_it_was(
    tmp_path, monkeypatch, failure, overwrite
):
    folder, left = tmp_path / "deep" / "run", [0 if failure == "at once" else 1]
    if overwrite:
        folder.mkdir(parents=True)
        (folder / "fit.json").write_text("old")
    before, real, options = contents(tmp_path), commit.write_synced, {"overwrite": overwrite}

    def write_half(path: Path, data: bytes) -> None:
        left[0] -= 1
        if left[0] >= 0:
            return real(path, data)
        path.write_bytes(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    files = {"fit.json": "new", "figures/te.svg": "new"}
    if isinstance(failure, str):
        monkeypatch.setattr(commit, "write_synced", write_half)
        with pytest.raises(InputError, match=r"no space left.*\.$") as caught:
            write_run(folder, files, **options)
        assert caught.value.exit_code == 3 and "\n" not in str(caught.value)
    else:
        with pytest.raises(failure):
            write_run(folder, files, then=failure, **options)
    assert contents(tmp_path) == before
    assert (tmp_path / "deep").exists() == overwrite
    assert not (folder / "figures").exists()


def test_a_move_that_fails_after_the_switch_is_made_by_the_next_reader(tmp_path):
    folder = tmp_path / "run"
    with pytest.MonkeyPatch.context() as patch:
        refuse(patch, os, "replace", 1, "fit.json")
        with pytest.raises(InputError, match="no permission to write here") as caught:
            write_run(folder, RUN, results=("fit.json",))
    assert caught.value.where == str(folder / "fit.json")
    commit.settle_if_free(folder)
    assert contents(folder) == {name: text.encode() for name, text in RUN.items()}


def test_what_is_in_the_way_leaves_all_as_it_was(tmp_path, monkeypatch):
    file, folder, new = (tmp_path / name for name in ("file", "run", "new"))
    (folder / "fit.json").mkdir(parents=True)
    with pytest.raises(InputError, match="a folder is in the way"):
        write_run(folder, RUN, overwrite=True)
    file.write_text("a file")
    for path in (file, file / "sub" / "run"):
        assert_not_entered(path, InputError, "a file is in the way of this folder")
    assert contents(tmp_path) == {"file": b"a file"}
    refuse(monkeypatch, Path, "mkdir", 0, "new")
    assert assert_not_entered(new, InputError, "no permission") == str(new)


def test_a_second_writer_is_refused_until_the_first_is_done(tmp_path):
    code = (
        "import sys\nfrom vttig_jax.base.files.run_folder import RunFolder\n"
        "from vttig_jax.base.errors import UsageError\n"
        "try:\n    RunFolder(sys.argv[1]).__enter__()\n"
        "except UsageError as error:\n    print(error.message)\n"
    )
    words = "another vttig is writing"
    with RunFolder(tmp_path) as first:
        command = [sys.executable, "-c", code, str(tmp_path)]
        assert words in subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert_not_entered(tmp_path, UsageError, words)
        first.write_text("a.txt", "1")
    write_run(tmp_path, {"b.txt": "2"})
    assert set(contents(tmp_path)) == {"a.txt", "b.txt"}


def test_discarded_files_go_with_the_old_result_only(tmp_path):
    write_run(tmp_path, dict.fromkeys(("fit.json", "map.csv", "map.json"), "old"))
    with pytest.raises(UsageError, match="already exists"), RunFolder(tmp_path) as run:
        run.write_text("fit.json", run.discard("map.csv") or "new")
    assert contents(tmp_path)["map.csv"] == b"old"
    with RunFolder(tmp_path, overwrite=True) as run:
        for name in ("map.csv", "map.json", "never_there"):
            run.discard(name)
        for name in ("fit.json", "map.json"):
            run.write_text(name, "new")
    assert contents(tmp_path) == {"fit.json": b"new", "map.json": b"new"}


def test_the_hash_of_a_file(tmp_path):
    path = tmp_path / "1.csv"
    path.write_bytes(b"one")
    assert data_sha256(path) == hashlib.sha256(b"one").hexdigest()
    with pytest.raises(InputError, match="cannot be read") as caught:
        data_sha256(tmp_path / "3.csv")
    assert caught.value.where == str(tmp_path / "3.csv")
