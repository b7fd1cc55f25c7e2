"""Logs and pair files damaged at random: `vttig` ends with one sentence, never with a traceback.

`python -m benchmarks.safety.mutated` does the same with 500 inputs in processes of their own, and
with scenarios and sweeps.
"""

import warnings
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.cli.drive import write_drive, write_pair
from tests.logs import damage
from tests.logs.binary_logs import WRITERS
from tests.logs.mutations import damaged_arrays, damaged_bytes, damaged_text

NEEDS = {".tdms": "nptdms", ".mf4": "asammdf"}
SLOW = {".mf4"}
RELAXED = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the damaged logs are written, beside their pair file."""
    place = tmp_path_factory.mktemp("damaged")
    (place / "pair.toml").write_text(damage.PAIR)
    return place


def check(code: int, out: str, err: str) -> None:
    """Hold an end against the contract."""
    assert code in {0, 2, 3, 4}, (code, err)
    assert not any(word in err for word in ("Traceback", "defect", "site-packages")), err
    lines = err.splitlines()
    assert all(line.startswith(("error: ", "warning: ")) for line in lines), err
    errors = [line for line in lines if line.startswith("error: ")]
    assert len(errors) == (code != 0), err
    assert all(one.endswith((".", "`")) and len(one) < 1000 for one in errors), err
    assert code not in (2, 3) or out == ""  # with 4 the report says what is undetermined


@pytest.fixture
def attempt(folder, vttig):
    """Function that runs a verb on the bytes of a log, holds its end against the contract, and
    returns the exit code and all that is printed, in one line."""

    def run(verb: str, content: bytes) -> tuple[int, str]:
        (folder / "log.csv").write_bytes(content)
        code, out, err = vttig(verb, folder / "log.csv", "--pair", folder / "pair.toml")
        check(code, out, err)
        return code, " ".join((out + err).split())

    return run


@settings(max_examples=10, suppress_health_check=RELAXED)
@given(case=damage.damaged_logs())
def test_damaged_logs(attempt, case):
    for verb in ("inspect", "fit"):
        attempt(verb, case.content)


@pytest.mark.slow
@settings(max_examples=300, suppress_health_check=RELAXED)
@given(case=damage.damaged_logs())
def test_more_damaged_logs(attempt, case):
    attempt("inspect", case.content)


@settings(max_examples=50, suppress_health_check=RELAXED)
@given(content=st.binary(max_size=400))
def test_any_bytes(attempt, content):
    attempt("inspect", content)


@pytest.mark.parametrize(
    "suffix", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in WRITERS]
)
def test_binary_logs(vttig, tmp_path, suffix):
    if suffix in NEEDS:
        pytest.importorskip(NEEDS[suffix])
    pair, log = tmp_path / "plain.toml", tmp_path / f"log{suffix}"
    pair.write_text('[drive]\nratio = "1/2"\n')
    rows = np.loadtxt(write_drive(tmp_path / "log.csv"), delimiter=",", skiprows=1)[:200]
    arrays = {"time_s": rows[:, 0], "driving_deg": rows[:, 1], "driven_deg": rows[:, 2]}
    inspect = ("inspect", log, "--pair", pair, "-q")
    whole, draw = WRITERS[suffix](arrays), Random(f"0 {suffix}")
    log.write_bytes(whole)
    assert vttig(*inspect)[0] == 0
    for number in range(6):
        data = damaged_bytes(whole, draw)
        if number % 2:
            with warnings.catch_warnings(action="ignore"):
                data = WRITERS[suffix](damaged_arrays(arrays, draw))
        log.write_bytes(data)
        check(*vttig(*inspect))


@pytest.mark.parametrize("name", ["log.csv", "pair.toml"])
def test_texts(vttig, tmp_path, name):
    log, pair = write_drive(tmp_path / "log.csv"), write_pair(tmp_path / "pair.toml")
    text, draw = "\n".join((tmp_path / name).read_text().splitlines()[:300]), Random(0)
    for _ in range(25):
        (tmp_path / name).write_bytes(damaged_text(text, draw))
        check(*vttig("inspect", log, "--pair", pair, "-q"))


def _jump(row: int, size: int):
    return lambda values: values + size * (np.arange(len(values)) >= row)


CASES = [
    ("driven", _jump(0, 0), (0, 0), ()),
    (
        "driven",
        _jump(800, -50_000),
        (3, 3),
        ("line 802", "`driven_counts`", "at 3.2 s", "--from 3.2"),
    ),
    ("driving", _jump(800, 9_000), (3, 3), ("line 802", "`driving_counts`", "9360 counts")),
    ("driving", lambda r: np.minimum(r, 150_000), (3, 3), ("`driving_counts`", "stands still")),
    ("driven", lambda r: np.maximum(r, 90_000), (3, 3), ("`driven_counts`", "stands still")),
    ("time", lambda t: t[::-1], (3, 3), ("line 3", "time runs backwards")),
    ("driven", lambda r: np.rint(1.03 * r).astype(int), (0, 3), ("shows a ratio of 0.579",)),
]


@pytest.mark.portable
def test_what_is_damaged_is_named(attempt):
    """Codes of `inspect` and `fit`, and words of both."""
    for role, change, codes, words in CASES:
        text = damage.clean_log()
        content = replace(text, **{role: change(getattr(text, role))}).to_bytes()
        for verb, code in zip(("inspect", "fit"), codes, strict=True):
            found, said = attempt(verb, content)
            assert found == code and all(word in said for word in words), said
            assert words or ("from their neighbours" not in said and "steps by" not in said)


@pytest.mark.portable
def test_less_than_one_turn(attempt):
    text, rows = damage.clean_log(), slice(60, 200)
    roles = ("time", "driving", "driven")
    short = replace(text, **{role: getattr(text, role)[rows] for role in roles}).to_bytes()
    code, said = attempt("inspect", short)
    assert code == 0 and "turns only" in said
    assert attempt("fit", short)[0] == 4


def test_the_checker_sees_a_defect(attempt, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("planted")

    monkeypatch.setattr("vttig_jax.logs.read.read_log", broken)
    with pytest.raises(AssertionError, match="planted"):
        attempt("inspect", damage.clean_log().to_bytes())
    for bad in (
        (3, "", "Traceback (most recent call last):\nerror: x."),
        (3, "", ""),
        (3, "", "error: one.\nerror: two."),
        (0, "", "error: one."),
        (3, "half a report", "error: one."),
        (3, "", "error: no end"),
        (3, "", "RuntimeWarning: overflow\nerror: x."),
        (0, "", "/lib/site-packages/x.py:1"),
        (1, "", "error: this is one."),
    ):
        with pytest.raises(AssertionError):
            check(*bad)
    check(3, "", "warning: some.\nerror: one.")
