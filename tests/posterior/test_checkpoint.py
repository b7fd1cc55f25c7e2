import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.posterior.densities import plain
from tests.posterior.runs import REPOSITORY, only, same, sample, sentence
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.posterior import checkpoint
from vttig_jax.posterior.chains import read_chains
from vttig_jax.posterior.until import Until


def test_what_is_written_is_read_back(path):
    target = plain(identity={"file": "é", "nested": {"list": [1, 2.5, None]}}, units=("mm", "°"))
    chains = sample(path, target, seed=2**70)
    found = read_chains(path)
    assert same(chains, found) and only(path)
    assert found.header.names == ("x0", "x1") and found.header.units == ("mm", "°")
    assert str(found.diagnosis) == str(chains.diagnosis)


def test_the_stop_rule_is_kept_with_the_draws(path):
    rule = Until(effective=300.0, r_hat=1.2, most_steps=2000)
    chains = sample(path, steps=None, until=rule)
    assert chains.diagnosis.converged and chains.diagnosis.steps < 2000
    assert read_chains(path).diagnosis.until == rule
    assert str(read_chains(path).diagnosis) == str(chains.diagnosis)


def test_the_file_holds_arrays_and_text_only(path):
    sample(path)
    kinds = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: kinds.update({name: item.dtype.kind}))
    assert set(kinds.values()) == {"f", "i", "u"}


def test_an_existing_file_is_refused_and_untouched(path):
    sample(path)
    before = path.read_bytes()
    target = plain()
    with pytest.raises(UsageError, match="--resume, replace it with --overwrite") as caught:
        sample(path, target)
    assert caught.value.exit_code == 2 and not target.sizes
    assert str(path) in sentence(caught.value)
    assert path.read_bytes() == before and only(path)
    assert not same(sample(path, seed=1, overwrite=True), sample(None))
    assert same(read_chains(path), sample(None, seed=1))


def damaged(path: Path, kind: str) -> bytes:
    """Contents of a checkpoint that is none, or not whole."""
    whole = path.read_bytes()
    middle = whole.index(read_chains(path).record.draws.tobytes()[800:840])
    if kind == "no checkpoint":
        with h5py.File(path, "w") as file:
            file["draws"] = np.zeros(3)
        return path.read_bytes()
    return {
        "text": b"time,angle\n0,1\n",
        "empty": b"",
        "half": whole[:middle],
        "one byte short": whole[:-1],
        "one bit of a draw": whole[:middle] + bytes([whole[middle] ^ 4]) + whole[middle + 1 :],
        "one bit of the start": whole[:40] + bytes([whole[40] ^ 1]) + whole[41:],
    }[kind]


@pytest.mark.parametrize(
    "kind",
    [
        "text",
        "empty",
        "half",
        "one byte short",
        "one bit of a draw",
        "one bit of the start",
        "no checkpoint",
    ],
)
def test_a_damaged_file_is_one_sentence_and_untouched(path, kind):
    sample(path)
    path.write_bytes(damaged(path, kind))
    before = path.read_bytes()
    for attempt in (lambda: sample(path, resume=True), lambda: read_chains(path)):
        with pytest.raises(InputError, match="no complete checkpoint of vttig") as caught:
            attempt()
        sentence(caught.value)
        assert path.read_bytes() == before and only(path)


def test_a_missing_file_and_a_folder_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="this checkpoint does not exist"):
        read_chains(tmp_path / "posterior.h5")
    with pytest.raises(InputError) as caught:
        read_chains(tmp_path)
    sentence(caught.value)


def test_a_temporary_file_left_over_is_no_hindrance(path):
    path.parent.mkdir()
    path.with_name(".posterior.h5.tmp").write_bytes(b"half of an older one")
    sample(path)
    assert same(read_chains(path), sample(None)) and only(path)


def test_a_second_writer_is_refused(path):
    code = (
        "import sys, pathlib\n"
        "from tests.posterior.runs import sample\n"
        "from vttig_jax.base.errors import UsageError\n"
        "try:\n    sample(pathlib.Path(sys.argv[1]), overwrite=True)\n"
        "except UsageError as error:\n    print(error.message)\n"
    )
    said = []

    def progress(_: object) -> None:
        if said:
            return
        done = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=REPOSITORY
        )
        said.append(done.stdout + done.stderr)
        with pytest.raises(UsageError, match="another vttig is writing to this checkpoint"):
            sample(path, overwrite=True)

    chains = sample(path, progress=progress)
    assert said[0].startswith("another vttig is writing")
    assert same(chains, read_chains(path)) and only(path)


def test_generations_come_by_the_clock(path, monkeypatch):
    written, now = [], [0.0]
    real = checkpoint.replace_file

    def write(target: Path, data: bytes) -> None:
        now[0] += 1.0  # slow to write: 20 s until the next
        real(target, data)
        written.append(read_chains(target).diagnosis.steps)

    def progress(_: object) -> None:
        now[0] += 4.0

    monkeypatch.setattr(checkpoint, "replace_file", write)
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: now[0])
    sample(path, steps=500, progress=progress)
    assert written == [150, 400, 500]
