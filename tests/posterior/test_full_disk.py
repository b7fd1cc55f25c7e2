import errno
import os
from pathlib import Path

import pytest

from tests.posterior.runs import only, same, sample, sentence
from vttig_jax.base.errors import InputError
from vttig_jax.posterior import checkpoint


def full_after(monkeypatch: pytest.MonkeyPatch, generations: int) -> list[Path]:
    """Write every block, let so many generations through, refuse more; the refusals so far."""
    monkeypatch.setattr(checkpoint, "SAVE_S", 0.0)
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: 0.0)
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
def test_a_full_disk_leaves_the_generation_before(path, monkeypatch, generations):
    refused = full_after(monkeypatch, generations)
    with pytest.raises(InputError, match="no space left") as caught:
        sample(path, steps=200)
    sentence(caught.value)
    assert caught.value.exit_code == 3 and len(refused) == 1  # not tried again on the way out
    assert path.exists() == bool(generations)
    monkeypatch.undo()
    assert same(sample(path, steps=200, resume=True), sample(None, steps=200))


def test_a_full_disk_leaves_the_file_that_was_to_be_replaced(path, monkeypatch):
    sample(path)
    before = path.read_bytes()
    full_after(monkeypatch, 0)
    with pytest.raises(InputError):
        sample(path, seed=1, overwrite=True)
    assert path.read_bytes() == before and only(path)


def test_no_permission(path, monkeypatch):
    def replace(source: Path, target: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(InputError, match="no permission to write here"):
        sample(path)
    assert not path.parent.exists()  # nor is the folder left that it made
