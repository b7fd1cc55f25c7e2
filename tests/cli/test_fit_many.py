"""`vttig fit-many`: rows beside single fits, failures as codes, resuming, and refusals."""

import csv
import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import vttig_jax
from tests.cli.commands import write_paper_pair
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.runs import elsewhere, many_fits


@pytest.fixture(scope="module")
def rigs(tmp_path_factory) -> Path:
    """Logs of three rigs of one design, a broken file, an empty one, and the pair."""
    folder = tmp_path_factory.mktemp("rigs")
    for number, turns in enumerate((10, 10, 6)):
        motion = PassMotion(speed_rpm=240.0, reversal_deg=360.0 * turns)
        rig = paper_rig(number, motion)
        (folder / f"rig{number}.csv").write_text(log_csv(rig.log(number)))
    (folder / "empty.csv").write_text("time_s,driving_counts,driven_counts\n")
    (folder / "broken.csv").write_text("time_s,driving_counts,driven_counts\n0,1,nonsense\n")
    write_paper_pair(folder / "pair.toml")
    return folder


@pytest.fixture
def command(rigs) -> tuple:
    logs = [rigs / name for name in ("rig0.csv", "broken.csv", "rig1.csv", "rig2.csv")]
    return ("fit-many", *logs, "--pair", rigs / "pair.toml", "--jobs", "1")


def test_each_log_has_a_row_and_resuming_changes_nothing(
    found, refused, command, rigs, tmp_path, monkeypatch
):
    monkeypatch.setattr(many_fits, "_BLOCK", 2)
    out, table = tmp_path / "out", tmp_path / "fits.csv"
    record = found(*command, "--out", out, "--resume", "--csv", table)
    assert record["fitted"] == 3 and record["table"] == "fits.parquet"
    (failed,) = record["failed"]
    assert Path(failed["log"]).name == "broken.csv" and failed["code"] == "refused"
    assert "nonsense" in failed["reason"]
    rows = list(csv.DictReader(table.open()))
    assert [Path(row["log"]).name for row in rows] == [log.name for log in command[1:5]]
    pair = vttig_jax.load_pair(rigs / "pair.toml")
    for row in (rows[0], rows[2]):
        single = vttig_jax.fit(vttig_jax.read_log(row["log"], pair), pair)
        for name in set(record["parameters"]) & set(single.parameters):
            known = single.parameters[name]
            if known.std is not None:
                assert float(row[name]) == pytest.approx(known.value, abs=1e-6 * known.std)
    assert rows[1]["driving_eccentricity_mm"] == ""
    assert pq.read_table(out / "fits.parquet").column("code").to_pylist()[0] == "ok"

    # A block is missing, as after a kill; then the table is complete and only read.
    (out / "parts").mkdir()
    kept = pq.read_table(out / "fits.parquet")
    pq.write_table(kept.slice(0, 2), out / "parts" / "00000000.parquet")
    (out / "fits.parquet").unlink()
    fitted = []
    own = many_fits.ManyFits.columns

    def columns(self, block, **rest):
        fitted.append(block)
        return own(self, block, **rest)

    monkeypatch.setattr(many_fits.ManyFits, "columns", columns)
    for _ in range(2):
        assert found(*command, "--out", out, "--resume") == record and fitted == [1]
    assert pq.read_table(out / "fits.parquet").equals(kept)

    # Another task is another table.
    refused(3, "settings differ", *command, "--out", out, "--resume", "--delay", "off")
    refused(2, "holds a table of fits", *command, "--out", out)


def test_no_fitted_log_is_no_answer(vttig, rigs, tmp_path):
    logs, out = (rigs / "broken.csv", rigs / "empty.csv"), tmp_path / "out"
    code, text, err = vttig("fit-many", *logs, "--pair", rigs / "pair.toml", "--out", out)
    assert code == 4 and "no log could be fitted" in err
    assert "broken.csv" in text and "empty.csv" in text
    assert json.loads((out / "fits.json").read_text())["block"] == 16
    assert len(pq.read_table(out / "fits.parquet")) == 2


@pytest.mark.portable
def test_refusals(refused, command, rigs, monkeypatch):
    for options, words in (
        ("--resume", "--resume without --out"),
        ("--out x --resume --overwrite", "exclude each other"),
        ("--delay free", "--delay"),
        ("--dask tcp://127.0.0.1:1", "--jobs and --dask exclude each other"),
        ("--jobs 0", "--jobs"),
    ):
        refused(2, words, *command, *options.split())
    refused(2, "given twice", "fit-many", command[1], command[1], *command[-4:])
    said = refused(3, "none.csv", "fit-many", rigs / "none.csv", *command[-4:])
    assert "cannot be read" in said
    monkeypatch.setattr(elsewhere, "_WAIT_S", 0.2)
    refused(3, "no scheduler answers", *command[:-2], "--dask", "tcp://127.0.0.1:1")


# Two processes import JAX and compile the programs of a batch each.
@pytest.mark.slow
def test_processes_fit_the_same_table(found, command, tmp_path, monkeypatch):
    monkeypatch.setattr(many_fits, "_BLOCK", 2)
    tables = []
    for jobs in ("1", "2"):
        table = tmp_path / f"{jobs}.csv"
        found(*command[:-1], jobs, "--csv", table)
        tables.append(list(csv.DictReader(table.open())))
    for one, other in zip(*tables, strict=True):
        for name, value in one.items():
            if name in ("driving_eccentricity_mm", "driven_phase_deg_std") and value:
                assert float(other[name]) == pytest.approx(float(value), rel=1e-9)
            elif name in ("log", "code", "reason", "flanks", "samples_used"):
                assert other[name] == value


def test_a_path_that_cannot_be_read_has_a_row(found, command, rigs, tmp_path):
    (tmp_path / "folder.csv").mkdir()
    logs = (tmp_path / "folder.csv", rigs / "none.csv", rigs / "rig0.csv")
    record = found("fit-many", *logs, *command[-4:])
    assert record["fitted"] == 1
    assert [one["code"] for one in record["failed"]] == ["refused"] * 2
    assert "this is a folder" in record["failed"][0]["reason"]
