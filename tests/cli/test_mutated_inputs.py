"""Damaged logs of all formats: exit codes of the contract, one sentence, no message of a library.

`python -m benchmarks.safety.mutated` does the same with 500 inputs in processes of their own, and
with pairs, scenarios and sweeps.
"""

import warnings
from random import Random

import numpy as np
import pytest

from tests.cli.drive import write_drive, write_pair
from tests.logs.binary_logs import WRITERS
from tests.logs.mutations import damaged_arrays, damaged_bytes, damaged_text

NEEDS = {".tdms": "nptdms", ".mf4": "asammdf"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_pair(tmp_path / "pair.toml")
    (tmp_path / "plain.toml").write_text('[drive]\nratio = "1/2"\n')
    write_drive(tmp_path / "log.csv")
    return tmp_path


def check(ended: tuple[int, str, str]) -> None:
    """Hold an end against the contract."""
    code, out, err = ended
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    assert code in (0, 2, 3, 4) and len(errors) == (code != 0), err
    assert "Traceback" not in err and "site-packages" not in err, err
    assert all(line.startswith(("error: ", "warning: ")) for line in err.splitlines()), err
    assert code != 3 or out == ""


SLOW = {".mf4"}


@pytest.mark.parametrize(
    "suffix", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in WRITERS]
)
def test_binary_logs(folder, vttig, suffix):
    if suffix in NEEDS:
        pytest.importorskip(NEEDS[suffix])
    rows = np.loadtxt("log.csv", delimiter=",", skiprows=1)[:200]
    arrays = {"time_s": rows[:, 0], "driving_deg": rows[:, 1], "driven_deg": rows[:, 2]}
    whole = WRITERS[suffix](arrays)
    (folder / f"log{suffix}").write_bytes(whole)
    assert vttig("inspect", f"log{suffix}", "--pair", "plain.toml", "-q")[0] == 0
    draw = Random(f"0 {suffix}")
    for number in range(6):
        data = damaged_bytes(whole, draw)
        if number % 2:
            with warnings.catch_warnings(action="ignore"):
                data = WRITERS[suffix](damaged_arrays(arrays, draw))
        (folder / f"log{suffix}").write_bytes(data)
        check(vttig("inspect", f"log{suffix}", "--pair", "plain.toml", "-q"))


def test_texts(folder, vttig):
    lines = (folder / "log.csv").read_text().splitlines()[:300]
    draw = Random(0)
    for _ in range(25):
        (folder / "log.csv").write_bytes(damaged_text("\n".join(lines), draw))
        check(vttig("inspect", "log.csv", "--pair", "pair.toml", "-q"))


def test_pairs(folder, vttig):
    text = (folder / "pair.toml").read_text()
    draw = Random(0)
    for _ in range(25):
        (folder / "pair.toml").write_bytes(damaged_text(text, draw))
        check(vttig("inspect", "log.csv", "--pair", "pair.toml", "-q"))


def test_the_check_sees_a_fault():
    for bad in (
        (1, "", "error: this is a defect."),
        (3, "", "RuntimeWarning: overflow\nerror: x."),
        (0, "", "/lib/site-packages/x.py:1"),
        (3, "half", "error: x."),
    ):
        with pytest.raises(AssertionError):
            check(bad)
    check((3, "", "error: x."))
