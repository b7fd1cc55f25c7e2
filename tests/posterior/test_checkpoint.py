from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.posterior.densities import plain
from tests.posterior.runs import only, same, sample, sentence
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.posterior import checkpoint
from vttig_jax.posterior.chains import read_chains
from vttig_jax.posterior.until import Until


def test_what_is_written_is_read_back_with_its_stop_rule(path):
    target = plain(identity={"file": "é", "nested": {"list": [1, 2.5, None]}}, units=("mm", "°"))
    rule = Until(effective=300.0, r_hat=1.2, most_steps=2000)
    chains = sample(path, target, seed=2**70, steps=None, until=rule)
    assert chains.diagnosis.converged and chains.diagnosis.steps < 2000
    found = read_chains(path)
    assert same(chains, found) and only(path)
    assert found.header.names == ("x0", "x1") and found.header.units == ("mm", "°")
    assert found.diagnosis.until == rule and str(found.diagnosis) == str(chains.diagnosis)


def test_an_existing_file_is_refused_and_untouched(path):
    sample(path)
    before = path.read_bytes()
    target = plain()
    with pytest.raises(UsageError, match="--resume, replace it with --overwrite") as caught:
        sample(path, target)
    assert caught.value.exit_code == 2 and not target.sizes
    assert str(path) in sentence(caught.value)
    assert path.read_bytes() == before and only(path)
    sample(path, seed=1, overwrite=True)
    assert same(read_chains(path), sample(None, seed=1))


def damaged(path: Path) -> dict[str, bytes]:
    """Contents of checkpoints that are none, or not whole."""
    whole = path.read_bytes()
    middle = whole.index(read_chains(path).record.draws.tobytes()[800:840])
    with h5py.File(path, "w") as file:
        file["draws"] = np.zeros(3)
    flipped = {place: bytes([whole[place] ^ 4]) for place in (middle, 40)}
    return {
        "no checkpoint": path.read_bytes(),
        "text": b"time,angle\n0,1\n",
        "empty": b"",
        "half": whole[:middle],
        "one byte short": whole[:-1],
    } | {f"bit {k}": whole[:k] + bit + whole[k + 1 :] for k, bit in flipped.items()}


def test_a_damaged_file_is_one_sentence_and_untouched(path):
    sample(path)
    for kind, before in damaged(path).items():
        path.write_bytes(before)
        for attempt in (lambda: sample(path, resume=True), lambda: read_chains(path)):
            with pytest.raises(InputError, match="no complete checkpoint of vttig") as caught:
                attempt()
            sentence(caught.value)
            assert path.read_bytes() == before and only(path), kind


def test_a_missing_file_and_a_folder_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="this checkpoint does not exist"):
        read_chains(tmp_path / "posterior.h5")
    with pytest.raises(InputError) as caught:
        read_chains(tmp_path)
    sentence(caught.value)


def test_a_second_writer_is_refused_and_a_file_left_over_no_hindrance(path):
    said = []

    def progress(_: object) -> None:
        with pytest.raises(UsageError, match="another vttig is writing to this checkpoint"):
            sample(path, overwrite=True)
        said.append(1)

    path.parent.mkdir()
    path.with_name(".posterior.h5.tmp").write_bytes(b"half of an older one")
    chains = sample(path, progress=progress)
    assert said and same(chains, read_chains(path)) and only(path)


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
