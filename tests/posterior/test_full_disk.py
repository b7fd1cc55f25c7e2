import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.posterior.runs import REPOSITORY, only, same, sample, sentence
from vttig_jax.base.errors import InputError
from vttig_jax.posterior import checkpoint
from vttig_jax.posterior.chains import read_chains


@pytest.fixture
def often(monkeypatch):
    """A generation every block."""
    monkeypatch.setattr(checkpoint, "SAVE_S", 0.0)
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: 0.0)


def full_after(monkeypatch: pytest.MonkeyPatch, generations: int) -> list[Path]:
    """Let so many generations through, then refuse more; the refusals so far."""
    refused: list[Path] = []
    real, left = checkpoint.replace_file, [generations]

    def write(target: Path, data: bytes) -> None:
        left[0] -= 1
        if left[0] < 0:
            refused.append(target)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(target, data)

    monkeypatch.setattr(checkpoint, "replace_file", write)
    return refused


@pytest.mark.parametrize("generations", [0, 1])
def test_a_full_disk_leaves_the_generation_before(path, often, monkeypatch, generations):
    refused = full_after(monkeypatch, generations)
    with pytest.raises(InputError, match="no space left") as caught:
        sample(path, steps=200)
    sentence(caught.value)
    assert caught.value.exit_code == 3 and len(refused) == 1  # not tried again on the way out
    assert path.exists() == bool(generations)
    monkeypatch.undo()
    assert same(sample(path, steps=200, resume=True), sample(None, steps=200))


def test_a_full_disk_leaves_the_file_that_was_to_be_replaced(path, often, monkeypatch):
    sample(path)
    before = path.read_bytes()
    full_after(monkeypatch, 0)
    with pytest.raises(InputError):
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
        "size = path.stat().st_size\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2 * size, 2 * size))\n"
        "try:\n    sample(path, steps=1000, resume=True)\n"
        "except InputError as error:\n    print(error.message)\n"
    )
    pytest.importorskip("resource", reason="a limit on the size of files is a matter of POSIX")
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=REPOSITORY
    )
    assert "File too large" in done.stdout, done.stderr
    assert done.returncode == 0 and done.stderr == ""  # HDF5 closes in peace
    assert read_chains(path).diagnosis.steps == 100 and only(path)


def test_no_permission(path, monkeypatch):
    def replace(source: Path, target: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(InputError, match="no permission to write here"):
        sample(path)
    assert not path.parent.exists()  # nor is the folder left that it made
