import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.posterior.runs import REPOSITORY, only, same, sample, sentence
from vttig_jax.base.errors import InputError
from vttig_jax.posterior.sampling import checkpoint
from vttig_jax.posterior.sampling.ensembles import read_chains


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "posterior.h5"


@pytest.fixture
def often(monkeypatch):
    """A generation every block."""
    monkeypatch.setattr(checkpoint, "SAVE_S", 0.0)
    monkeypatch.setattr(checkpoint, "_WAIT_PER_WRITE", 0.0)


def fill_disk(monkeypatch: pytest.MonkeyPatch, after: int) -> list[str]:
    """Let so many bytes through, then refuse more; the refusals so far."""
    refused: list[str] = []
    real = checkpoint._ErrorRecordingFile._write_fully
    left = [after]

    def write(self: checkpoint._ErrorRecordingFile, data: memoryview) -> int:
        left[0] -= len(data)
        if left[0] < 0:
            real(self, data[: len(data) // 2])
            refused.append(self.__class__.__name__)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(self, data)

    monkeypatch.setattr(checkpoint._ErrorRecordingFile, "_write_fully", write)
    return refused


@pytest.mark.parametrize("after", [0, 1000, 30_000])
def test_a_full_disk_before_the_first_generation(path, often, monkeypatch, after):
    refused = fill_disk(monkeypatch, after)
    with pytest.raises(InputError, match=r"no space left .*; no checkpoint was written") as caught:
        sample(path)
    sentence(caught.value)
    assert caught.value.exit_code == 3 and list(path.parent.iterdir()) == []
    assert len(refused) == 1  # not tried again on the way out


def test_a_full_disk_leaves_the_generation_before(path, often, monkeypatch):
    sample(path, steps=400)
    before = path.read_bytes()
    fill_disk(monkeypatch, len(before) + 20_000)
    with pytest.raises(InputError, match="the checkpoint of step 400 is complete, continue with"):
        sample(path, steps=1000, resume=True)
    assert path.read_bytes() == before and only(path)
    monkeypatch.undo()
    assert same(sample(path, steps=1000, resume=True), sample(None, steps=1000))


def test_a_full_disk_leaves_the_file_that_was_to_be_replaced(path, often, monkeypatch):
    sample(path)
    before = path.read_bytes()
    fill_disk(monkeypatch, 1000)
    with pytest.raises(InputError, match="the older file is unchanged"):
        sample(path, seed=1, overwrite=True)
    assert path.read_bytes() == before and only(path)


def test_the_system_refuses_the_rest_of_a_file(path):
    # No stand-in: the kernel refuses to write beyond a limit on the size of files.
    code = (
        "import resource, sys, pathlib\n"
        "from tests.posterior.runs import sample\n"
        "from vttig_jax.base.errors import InputError\n"
        "path = pathlib.Path(sys.argv[1])\n"
        "sample(path)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))\n"
        "try:\n    sample(path, steps=1000, resume=True)\n"
        "except InputError as error:\n    print(error.message)\n"
    )
    pytest.importorskip("resource", reason="a limit on the size of files is a matter of POSIX")
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=REPOSITORY
    )
    assert "File too large; the checkpoint of step 200 is complete" in done.stdout, done.stderr
    assert done.returncode == 0 and done.stderr == ""  # HDF5 closes in peace
    assert read_chains(path).steps == 200 and only(path)


def test_no_permission(path, monkeypatch):
    def replace(source: Path, target: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(InputError, match="no permission to write here"):
        sample(path)
    assert list(path.parent.iterdir()) == []
