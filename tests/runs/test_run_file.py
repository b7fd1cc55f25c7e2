"""`run.toml` there and back, the older form, and damaged ones."""

import tomllib
from pathlib import Path

import pytest
import tomli_w

from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files.run_folder import data_sha256
from vttig_jax.identify.fit_settings import FitSettings
from vttig_jax.logs.recognition.request import ReadingOptions
from vttig_jax.pair.pair_file import load_pair_spec
from vttig_jax.runs.run_file import RunOptions, RunRecord, read_run, require_same_data

pytestmark = pytest.mark.smoke

OPTIONS = RunOptions(
    ReadingOptions(
        columns=("time=time_s",),
        decimal=".",
        sample_rate=50.0,
        start="0.5rev",
        stop=9.5,
        cut=("2:3",),
        missing="skip",
        lead_mm=5.0,
    ),
    FitSettings(
        flank="A",
        perfect_encoders=True,
        delay=-0.002,
        ratio_within=0.001,
        orders_within=2.0,
        widths_within=0.5,
        same_zero=False,
        standstill=False,
    ),
)


@pytest.fixture
def run(tmp_path) -> RunRecord:
    """A run of two logs."""
    logs = tuple(write_drive(tmp_path / f"{k}.csv", seed=k) for k in range(2))
    spec = load_pair_spec(write_pair(tmp_path / "pair.toml"))
    return RunRecord(
        logs, spec, RunOptions(settings=FitSettings(delay=0.004)), tuple(map(data_sha256, logs))
    )


@pytest.fixture
def write(tmp_path):
    """Function that writes a table as the `run.toml` of a folder."""
    folder = tmp_path / "run"
    folder.mkdir()

    def write(table) -> Path:
        (folder / "run.toml").write_text(tomli_w.dumps(table))
        return folder

    return write


def test_there_and_back(run, write, tmp_path, monkeypatch):
    folder = write(run.table(tmp_path / "run"))
    table = tomllib.loads((folder / "run.toml").read_text())
    assert table["data"]["logs"] == ["../0.csv", "../1.csv"]
    assert read_run(folder) == read_run(folder / "run.toml") == run
    require_same_data(read_run(folder))
    monkeypatch.chdir(tmp_path)
    assert [str(log) for log in read_run(folder).logs] == ["0.csv", "1.csv"]


def test_every_option_comes_back(run, write, tmp_path):
    table = RunRecord(run.logs, run.spec, OPTIONS, run.sha256).table(tmp_path / "run")
    names = (*ReadingOptions.__struct_encode_fields__, *FitSettings.__struct_encode_fields__)
    assert set(table["options"]) == set(names) - {"delay_within_ms"}  # a given delay excludes it
    assert read_run(write(table)).options.table() == table["options"]
    table["options"] |= {"delay": "auto", "delay_within_ms": 5.0}
    assert read_run(write(table)).options.table() == table["options"]


DAMAGES = (
    ("", "schema", "vttig.run/9", "vttig.run/9"),
    ("", "data", None, "'data'"),
    ("", "options", None, "'options'"),
    ("", "options", 3, "options"),
    ("", "pair_file", None, "'pair_file'"),
    ("pair_file", "drive", None, "pair_file"),
    ("data", "sha256", None, "'sha256'"),
    ("data", "sha256", ["0"], "data.sha256"),
    ("data", "logs", [], "data.sha256"),
    ("data", "logs", "0.csv", "data.logs"),
    ("data", "logs", [1, 2], "data.logs"),
    ("data", "logs", ["0\0.csv", "1.csv"], "no path of a file"),
    ("data", "readings", "0\0.csv", "no path of a file"),
    ("options", "delay", 7.5, "delay"),
    ("options", "delay", float("nan"), "delay"),
    ("options", "delay", "late", "delay"),
    ("options", "delay_within_ms", 5.0, "exclude each other"),
    ("options", "lines", "drop", "lines"),
    ("options", "loss", "huber", "unknown field `loss`"),
    ("options", "sample_rate", float("inf"), "sample_rate"),
    ("options", "sample_rate", float("nan"), "sample_rate"),
    ("options", "ratio_within", 7.0, "ratio_within"),
    ("options", "columns", ["load=x"], "ROLE=NAME"),
    ("options", "columns", "time=x", "columns"),
    ("options", "colour", "red", "colour"),
)
"""Table, its key, another value or None for no key, and what is said."""


def test_damaged_files(run, write, tmp_path):
    for inside, key, value, words in DAMAGES:
        table = run.table(tmp_path / "run")
        assert read_run(write(table)) == run
        changed = table[inside] if inside else table
        changed[key] = value
        if value is None:
            del changed[key]
        with pytest.raises(InputError) as caught:
            read_run(write(table))
        assert words in str(caught.value) and "run.toml" in caught.value.where


def test_missing_and_unreadable(tmp_path):
    with pytest.raises(UsageError, match="no such run"):
        read_run(tmp_path)
    (tmp_path / "run.toml").write_bytes(b"\xff")
    with pytest.raises(InputError, match="not a run file"):
        read_run(tmp_path)


def test_changed_and_missing_logs(run):
    with run.logs[1].open("a") as log:
        log.write("1,2,3,4,5,6\n")
    with pytest.raises(InputError, match="has changed since the run") as caught:
        require_same_data(run)
    assert caught.value.where == str(run.logs[1])
    run.logs[1].unlink()
    with pytest.raises(InputError, match="no longer there"):
        require_same_data(run)
