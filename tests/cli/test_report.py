"""`vttig report`: one page of a run that holds everything it shows."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from tests.cli.commands import fit_into
from tests.cli.drive import write_drive

SECTIONS = {
    *("verdict", "numbers", "error", "accuracy", "orders", "residual", "findings", "open", "made"),
    *("data", "backlash"),
}
PAIR = {"drive": {"ratio": "1/2"}, "fit": {"driving_orders": [1, 2], "driven_orders": [1, 2]}}


def links(page: str) -> list[str]:
    """Everything that a browser would fetch: targets of links, sources, imports of styles."""
    text = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    return re.findall(r'(?:href|src|action|url|@import)\s*[=(]\s*["\']?([^"\')>\s]+)', text)


def copied(folder: Path, place: Path) -> Path:
    return Path(shutil.copytree(folder, place / "run"))


def visible(page: str) -> str:
    return re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


@pytest.fixture
def reported(found, tmp_path):
    """Function that writes a report, and returns its object and its page."""

    def report(*runs):
        out = tmp_path / "r.html"
        return found("report", *runs, "--out", out), out.read_text("utf-8")

    return report


@pytest.mark.portable
def test_a_page_of_a_run(refused, reported, run_folder, tmp_path):
    """It holds the files of the folder, and none that a link in it leads to."""
    run = copied(run_folder, tmp_path)
    (tmp_path / "secret.csv").write_text("the secret\n")
    (run / "link.csv").symlink_to(tmp_path / "secret.csv")
    (run / "own.csv").write_text("the own\n")
    record, page = reported(run)
    out = tmp_path / "r.html"
    assert record["report"] == str(out) and record["comparison"] is None
    assert set(record["sections"]) == SECTIONS
    assert len(page.encode()) == record["bytes"] <= 3_000_000
    assert all(sentence in page for sentence in record["verdict"])
    fit = json.loads((run / "fit.json").read_text())
    assert [name for name in fit["parameters"] if name not in page] == []
    assert "secret" not in page and "own.csv" in page and "link.csv" not in page
    assert links(page) and all(link.startswith("data:") for link in links(page))
    # A link out of the page would be seen.
    assert links('<a href="http://x">') == ["http://x"] and links("a{b:url(//x/y)}") == ["//x/y"]
    policy = re.search('Content-Security-Policy" content="([^"]*)"', page)
    assert policy and "default-src 'none'" in policy[1] and "http" not in policy[1]
    refused(2, "--overwrite", "report", run, "--out", out)


def test_draws_add_their_band_and_their_intervals(reported, sampled_folder):
    record, page = reported(sampled_folder)
    assert "draws" in record["sections"]
    assert "95 % of the draws" in page and "95 % band of the whole map" in page
    assert "have not converged" in page and "map.csv" in page
    gap = json.loads((sampled_folder / "map.json").read_text())["smallest_gap"]["backlash_deg"]
    assert f"{gap['low95']:.5f}" in page


def test_one_direction(told, one_flank_folder, tmp_path):
    """The page stands in the folder unless a place is given; the text begins with its verdict."""
    run = copied(one_flank_folder, tmp_path)
    first, second, *_ = told("report", run).splitlines()
    page = (run / "report.html").read_text("utf-8")
    assert "not the backlash" in first and "from peak to peak" in second
    assert first in page and second in page and "flank B" not in visible(page)
    assert "Record both directions" in page and 'id="backlash"' in page


def test_fit_ends_with_a_report(refused, told, rig_folder, tmp_path):
    fit = ("fit", rig_folder / "log.csv", "--pair", rig_folder / "pair.toml")
    refused(2, "--report without --out", *fit, "--report")
    made = (*fit, "--out", tmp_path / "run", "--no-figures")
    report = tmp_path / "run" / "report.html"
    out = told(*made, "--report")
    assert out.splitlines()[-1] == f"report: {report}" and report.is_file()
    told(*made, "--overwrite")
    assert not report.exists()  # it was that of the fit before


@pytest.mark.parametrize("name", ["</script><script>alert(1)</script>", "n" * 10_000])
def test_text_of_files_is_text(reported, tmp_path, name):
    log, pair, run = write_drive(tmp_path / "log.csv"), tmp_path / "pair.toml", tmp_path / "run"
    pair.write_text(tomli_w.dumps({"name": name} | PAIR))
    fit_into(run, log, pair)
    (run / "<script>b.csv").write_text("a,b\n")
    _, page = reported(run)
    assert "<script>alert" not in page and "<script>b" not in page
    assert "n" * 1000 not in re.sub('href="data:[^"]*"', "", page)  # the files hold it as it is
    assert page.count("<script") == 3 and len(page) < 3_000_000
    shown = "&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt;"
    assert name.startswith("n") or f"<h1>{shown}</h1>" in page


def test_nothing_determined(vttig, reported, tmp_path):
    log, pair = tmp_path / "log.csv", tmp_path / "pair.toml"
    time = np.arange(4000) * 1e-3
    rows, head = np.outer(time, [1.0, 40.0, 20.0]), "time_s,driving_deg,driven_deg"
    np.savetxt(log, rows, delimiter=",", header=head, comments="")
    pair.write_text(tomli_w.dumps(PAIR))
    run = tmp_path / "run"
    assert vttig("fit", log, "--pair", pair, "--out", run, "--no-figures")[0] == 4
    _, page = reported(run)
    assert "The log does not tell" in page and "record" in page.lower()


def test_folders_that_hold_no_fit_of_this_version(refused, run_folder, tmp_path):
    run = copied(run_folder, tmp_path)
    with np.load(run / "summary.npz") as arrays:
        kept = {name: arrays[name] for name in arrays.files if name != "core"}
    np.savez(run / "summary.npz", **kept)
    before = {path.name for path in run.iterdir()}
    refused(3, "older version", "report", run)
    refused(2, "no such folder", "report", tmp_path / "none")
    refused(2, "run.toml", "report", tmp_path)
    assert {path.name for path in run.iterdir()} == before


def test_without_the_extra(refused, run_folder, rig_folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh.plotting", None)
    words = 'pip install "vttig-jax[report]"'
    refused(2, words, "report", run_folder, "--out", tmp_path / "r.html")
    fit = ("fit", rig_folder / "log.csv", "--pair", rig_folder / "pair.toml")
    refused(2, words, *fit, "--out", tmp_path / "run", "--report")
    assert list(tmp_path.iterdir()) == []
