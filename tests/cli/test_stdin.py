"""A log from standard input: read as a file is, and kept so that `--run` can repeat the fit."""

import hashlib
import io
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


PAIR = ("--pair", "pair.toml")


def test_a_fit_is_that_of_the_file_and_is_repeated(folder, vttig, found, refused, piped):
    data = (folder / "log.csv").read_bytes()
    piped(data)
    code, text, err = vttig("fit", "-", *PAIR, "--out", "run", "--no-figures")
    assert code == 0 and "<stdin>.csv" in text, err
    kept = folder / "run" / "stdin.csv"
    assert kept.read_bytes() == data
    table = tomllib.loads((folder / "run" / "run.toml").read_text())["data"]
    assert table["logs"] == ["stdin.csv"]
    assert table["sha256"] == [hashlib.sha256(data).hexdigest()]
    piped(b"")
    again, plain = found("fit", "--run", "run"), found("fit", "log.csv", *PAIR)
    for name in ("parameters", "orders", "checks", "samples"):
        assert again[name] == plain[name]
    kept.write_bytes(data + b"\n")
    refused(3, "has changed since the run", "fit", "--run", "run")


def test_a_kept_log_goes_with_the_run_that_uses_it(folder, told, piped):
    out = ("--out", "run", "--no-figures", "--overwrite")
    piped((folder / "log.csv").read_bytes())
    told("fit", "-", *PAIR, *out)
    told("fit", "--run", "run", *out)
    assert (folder / "run" / "stdin.csv").exists()
    (folder / "run" / "stdin.txt").write_text("a note of the user")
    told("fit", "log.csv", *PAIR, *out)
    assert not (folder / "run" / "stdin.csv").exists()
    assert (folder / "run" / "stdin.txt").exists()


def test_the_format_follows_from_the_first_bytes(folder, found, piped):
    rows = np.loadtxt("log.csv", delimiter=",", skiprows=1)
    file, seen = io.BytesIO(), []
    np.savez(file, time_s=rows[:, 0], driving_deg=rows[:, 1], driven_deg=rows[:, 2])
    for name, data in (("npz", file.getvalue()), ("csv", (folder / "log.csv").read_bytes())):
        piped(data)
        report = found("inspect", "-", "--ratio", "2:1")
        assert report["source"] == f"<stdin>.{name}"
        assert report["fit_command"].startswith("vttig fit - --ratio 2:1")
        seen.append([report[key] for key in ("samples", "ratio", "sampling")])
    assert seen[0] == seen[1]


def test_one_of_many_logs(folder, found, vttig, refused, piped):
    data, table = (folder / "log.csv").read_bytes(), folder / "many" / "fits.parquet"
    write_drive(folder / "other.csv", seed=1)
    many = ("fit-many", "-", "other.csv", *PAIR, "--out", "many")
    piped(data)
    vttig(*many)
    written = table.read_bytes()
    piped(data)
    assert found(*many, "--resume")["fitted"] == 2
    assert pq.read_table(table)["log"].to_pylist() == ["<stdin>.csv", "other.csv"]
    assert table.read_bytes() == written
    piped(data + b"\n")
    refused(3, "", *many, "--resume")  # the table is of another log
    for other in (("--dask", "tcp://127.0.0.1:1"), ("--jobs", "2")):
        refused(2, "stdin (-) is not read by other processes", *many, "--overwrite", *other)


def test_refused(folder, refused, piped):
    for arguments, data, code, words in (
        ("- - --ratio 2:1", b"1", 2, "given twice"),
        ("- --pair -", b"1", 2, "only a LOG"),
        ("- --ratio 2:1", b"", 3, "the file is empty"),
        ("- --ratio 2:1 --most-memory 1e-6", b"1" * 5000, 3, "--most-memory"),
        ("- --ratio 2:1 --most-memory 1e-12", b"1" * 5000, 3, "--most-memory"),
        ("- --ratio 2:1 --most-memory 1e308", b"1" * 5000, 2, "--most-memory"),
        ("- --ratio 2:1", b"\x89MCAP0\r\n", 3, "ROS"),
        ("- --ratio 2:1", b"\x89HDF\r\n\x1a\n damaged", 3, "damaged"),
    ):
        piped(data)
        refused(code, words, "fit", *arguments.split())
    piped((folder / "log.csv").read_bytes(), terminal=True)
    refused(2, "terminal", "inspect", "-")
