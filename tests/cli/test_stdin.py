"""A log from standard input: read as a file is, and kept so that `--run` can repeat the fit."""

import hashlib
import io
import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.cli.drive import write_drive, write_pair


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path / "log.csv")
    write_pair(tmp_path / "pair.toml")
    return tmp_path


@pytest.fixture
def piped(monkeypatch):
    """Connect bytes to stdin, as a pipe does: they can be read once."""

    def connect(data: bytes, *, terminal: bool = False) -> None:
        stream = SimpleNamespace(
            buffer=io.BytesIO(data), closed=False, isatty=lambda: terminal, reconfigure=None
        )
        monkeypatch.setattr("sys.stdin", stream)

    return connect


def numbers(found: dict) -> dict:
    """The JSON object without the name of the log."""
    text = json.dumps(found)
    return json.loads(text.replace(json.dumps(found["source"]), '""'))


def test_a_fit_is_that_of_the_file_and_is_repeated(folder, vttig, vttig_json, piped):
    data = (folder / "log.csv").read_bytes()
    piped(data)
    code, text, err = vttig("fit", "-", "--pair", "pair.toml", "--out", "run", "--no-figures")
    assert code == 0 and "<stdin>.csv" in text, err
    assert (folder / "run" / "stdin.csv").read_bytes() == data
    table = tomllib.loads((folder / "run" / "run.toml").read_text())
    assert table["data"]["logs"] == ["stdin.csv"]
    assert table["data"]["sha256"] == [hashlib.sha256(data).hexdigest()]
    piped(b"")
    again = vttig_json("fit", "--run", "run")[1]
    assert numbers(again) == numbers(vttig_json("fit", "log.csv", "--pair", "pair.toml")[1])
    (folder / "run" / "stdin.csv").write_bytes(data + b"\n")
    code, _, err = vttig("fit", "--run", "run")
    assert code == 3 and "has changed since the run" in err


def test_a_kept_log_goes_with_the_run_that_uses_it(folder, vttig, piped):
    out = ("--out", "run", "--no-figures", "--overwrite")
    piped((folder / "log.csv").read_bytes())
    assert vttig("fit", "-", "--pair", "pair.toml", *out)[0] == 0
    assert vttig("fit", "--run", "run", *out)[0] == 0
    assert (folder / "run" / "stdin.csv").exists()
    (folder / "run" / "stdin.txt").write_text("a note of the user")
    assert vttig("fit", "log.csv", "--pair", "pair.toml", *out)[0] == 0
    assert not (folder / "run" / "stdin.csv").exists()
    assert (folder / "run" / "stdin.txt").exists()


def test_the_format_follows_from_the_first_bytes(folder, vttig_json, piped):
    rows = np.loadtxt("log.csv", delimiter=",", skiprows=1)
    file = io.BytesIO()
    np.savez(file, time_s=rows[:, 0], driving_deg=rows[:, 1], driven_deg=rows[:, 2])
    found = {}
    for name, data in (("npz", file.getvalue()), ("csv", (folder / "log.csv").read_bytes())):
        piped(data)
        code, report = vttig_json("inspect", "-", "--ratio", "2:1")
        assert code == 0 and report["source"] == f"<stdin>.{name}"
        assert report["fit_command"].startswith("vttig fit - --ratio 2:1")
        found[name] = report["samples"], report["ratio"], report["sampling"]
    assert found["npz"] == found["csv"]


def test_one_of_many_logs(folder, vttig_json, vttig, piped):
    data = (folder / "log.csv").read_bytes()
    write_drive(folder / "other.csv", seed=1)
    many = ("fit-many", "-", "other.csv", "--pair", "pair.toml", "--out", "many")
    piped(data)
    vttig(*many)
    written = (folder / "many" / "fits.parquet").read_bytes()
    piped(data)
    found = vttig_json(*many, "--resume")[1]
    assert found["fitted"] == 2
    logs = pq.read_table(folder / "many" / "fits.parquet")["log"].to_pylist()
    assert logs == ["<stdin>.csv", "other.csv"]
    assert (folder / "many" / "fits.parquet").read_bytes() == written
    piped(data + b"\n")
    assert vttig(*many, "--resume")[0] == 3  # the table is of another log
    for other in (("--dask", "tcp://127.0.0.1:1"), ("--jobs", "2")):
        code, _, err = vttig(*many, "--overwrite", *other)
        assert code == 2 and "stdin (-) is not read by other processes" in err


def test_refused(folder, vttig, piped):
    for arguments, data, code, words in (
        (("-", "-", "--ratio", "2:1"), b"1", 2, "given twice"),
        (("-", "--pair", "-"), b"1", 2, "only a LOG"),
        (("-", "--ratio", "2:1"), b"", 3, "the file is empty"),
        (("-", "--ratio", "2:1", "--most-memory", "1e-6"), b"1" * 5000, 3, "--most-memory"),
        (("-", "--ratio", "2:1", "--most-memory", "1e-12"), b"1" * 5000, 3, "--most-memory"),
        (("-", "--ratio", "2:1", "--most-memory", "1e308"), b"1" * 5000, 2, "--most-memory"),
        (("-", "--ratio", "2:1"), b"\x89MCAP0\r\n", 3, "ROS"),
        (("-", "--ratio", "2:1"), b"\x89HDF\r\n\x1a\n damaged", 3, "damaged"),
    ):
        piped(data)
        ended, out, err = vttig("fit", *arguments)
        assert (ended, out) == (code, "") and words in err
        assert len(err.splitlines()) == 1


def test_a_terminal_is_refused(folder, vttig, piped):
    piped((folder / "log.csv").read_bytes(), terminal=True)
    code, _, err = vttig("inspect", "-")
    assert code == 2 and "terminal" in err
