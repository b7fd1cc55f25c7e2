"""`run.toml` there and back, the older form, and damaged ones."""

import tomllib

import pytest
import tomli_w

from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files.run_folder import data_sha256
from vttig_jax.identify.fit_settings import FitSettings
from vttig_jax.pair.pair_file import load_pair_spec
from vttig_jax.runs.options import ReadingOptions, RunOptions
from vttig_jax.runs.run_file import RunRecord, read_run, require_same_data

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
        logs, spec, RunOptions(settings=FitSettings(delay=0.004)), tuple(data_sha256(logs))
    )


def write(tmp_path, table):
    folder = tmp_path / "run"
    folder.mkdir(exist_ok=True)
    (folder / "run.toml").write_text(tomli_w.dumps(table))
    return folder


def test_there_and_back(run, tmp_path, monkeypatch):
    folder = write(tmp_path, run.table(tmp_path / "run"))
    assert tomllib.loads((folder / "run.toml").read_text())["data"]["logs"] == [
        "../0.csv",
        "../1.csv",
    ]
    assert read_run(folder) == read_run(folder / "run.toml") == run
    require_same_data(read_run(folder))
    monkeypatch.chdir(tmp_path)
    assert [str(log) for log in read_run(folder).logs] == ["0.csv", "1.csv"]


def test_every_option_comes_back(run, tmp_path):
    full = RunRecord(run.logs, run.spec, OPTIONS, run.sha256)
    folder = tmp_path / "run"
    table = full.table(folder)
    assert read_run(write(tmp_path, table)).options.table() == table["options"]
    names = (*ReadingOptions.__struct_encode_fields__, *FitSettings.__struct_encode_fields__)
    excluded = {"delay_within_ms"}  # by the given delay
    assert set(table["options"]) == set(names) - excluded
    table["options"] |= {"delay": "auto", "delay_within_ms": 5.0}
    assert read_run(write(tmp_path, table)).options.table() == table["options"]


def test_damaged_files(run, tmp_path):
    for damage, words in (
        (lambda t: t.update(schema="vttig.run/9"), "vttig.run/9"),
        (lambda t: t.pop("data"), "'data'"),
        (lambda t: t["data"].pop("sha256"), "'sha256'"),
        (lambda t: t["data"].update(logs=[]), "data.sha256"),
        (lambda t: t["data"].update(logs="0.csv"), "data.logs"),
        (lambda t: t["data"].update(logs=[1, 2]), "data.logs"),
        (lambda t: t["data"].update(sha256=["0"]), "data.sha256"),
        (lambda t: t["data"].update(logs=["0\0.csv", "1.csv"]), "no path of a file"),
        (lambda t: t["data"].update(readings="0\0.csv"), "no path of a file"),
        (lambda t: t.pop("options"), "'options'"),
        (lambda t: t["options"].update(delay=7.5), "delay"),
        (lambda t: t["options"].update(delay=float("nan")), "delay"),
        (lambda t: t["options"].update(delay="late"), "delay"),
        (lambda t: t["options"].update(lines="drop"), "lines"),
        (lambda t: t["options"].update(loss="huber"), "unknown field `loss`"),
        (lambda t: t["options"].update(sample_rate=float("inf")), "sample_rate"),
        (lambda t: t["options"].update(sample_rate=float("nan")), "sample_rate"),
        (lambda t: t["options"].update(ratio_within=7.0), "ratio_within"),
        (lambda t: t["options"].update(delay_within_ms=5.0, delay=0.1), "exclude each other"),
        (lambda t: t["options"].update(columns=["load=x"]), "ROLE=NAME"),
        (lambda t: t["options"].update(columns="time=x"), "columns"),
        (lambda t: t["options"].update(colour="red"), "colour"),
        (lambda t: t.update(options=3), "options"),
        (lambda t: t.pop("pair_file"), "'pair_file'"),
        (lambda t: t["pair_file"].pop("drive"), "pair_file"),
    ):
        table = run.table(tmp_path / "run")
        assert read_run(write(tmp_path, table)) == run
        damage(table)
        with pytest.raises(InputError) as caught:
            read_run(write(tmp_path, table))
        assert words in str(caught.value)
        assert "run.toml" in caught.value.where


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
