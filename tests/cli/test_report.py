"""`vttig report`: one page of a run that holds everything it shows."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from tests.cli.drive import write_drive

ALL = (
    "verdict",
    "numbers",
    "error",
    "accuracy",
    "orders",
    "residual",
    "findings",
    "open",
    "made",
    "data",
)
PAIR = {"drive": {"ratio": "1/2"}, "fit": {"driving_orders": [1, 2], "driven_orders": [1, 2]}}


def links(page: str) -> list[str]:
    """Everything that a browser would fetch: targets of links, sources, imports of styles."""
    text = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    return re.findall(r'(?:href|src|action|url|@import)\s*[=(]\s*["\']?([^"\')>\s]+)', text)


def copied(folder: Path, place: Path) -> Path:
    return Path(shutil.copytree(folder, place / "run"))


@pytest.mark.portable
def test_a_page_of_a_run(vttig, vttig_json, run_folder, tmp_path):
    out = tmp_path / "r.html"
    code, record = vttig_json("report", run_folder, "--out", out)
    page = out.read_text("utf-8")
    assert code == 0 and record["report"] == str(out) and record["comparison"] is None
    assert set(record["sections"]) == {*ALL, "backlash"}
    assert len(page.encode()) == record["bytes"] <= 3_000_000
    assert all(sentence in page for sentence in record["verdict"])
    fit = json.loads((run_folder / "fit.json").read_text())
    for name, parameter in fit["parameters"].items():
        assert name in page, parameter
    assert links(page) and all(link.startswith("data:") for link in links(page))
    policy = re.search('Content-Security-Policy" content="([^"]*)"', page)
    assert policy and "default-src 'none'" in policy[1] and "http" not in policy[1]
    code, out_, err = vttig("report", run_folder, "--out", out)
    assert code == 2 and "--overwrite" in err and out_ == ""
    code, text, _ = vttig("report", run_folder, "--out", out, "--overwrite")
    assert code == 0 and text.splitlines()[:3] == record["verdict"]


def test_a_link_out_of_the_page_is_seen():
    assert links('<a href="http://x">') == ["http://x"] and links("a{b:url(//x/y)}") == ["//x/y"]


def test_draws_add_their_band_and_their_intervals(vttig_json, sampled_folder, tmp_path):
    out = tmp_path / "r.html"
    code, record = vttig_json("report", sampled_folder, "--out", out)
    page = out.read_text("utf-8")
    assert code == 0 and "draws" in record["sections"]
    assert "95 % of the draws" in page and "95 % band of the whole map" in page
    assert "have not converged" in page and "map.csv" in page
    gap = json.loads((sampled_folder / "map.json").read_text())["smallest_gap"]["backlash_deg"]
    assert f"{gap['low95']:.5f}" in page


def test_one_direction(vttig_json, one_flank_folder, tmp_path):
    out = tmp_path / "r.html"
    code, record = vttig_json("report", one_flank_folder, "--out", out)
    page = out.read_text("utf-8")
    assert code == 0 and "not the backlash" in record["verdict"][0]
    assert "from peak to peak" in record["verdict"][1]
    assert "flank B" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "Record both directions" in page and "backlash" in record["sections"]


def test_fit_and_demo_end_with_a_report(vttig, rig_folder, tmp_path):
    log, pair = rig_folder / "log.csv", rig_folder / "pair.toml"
    code, _, err = vttig("fit", log, "--pair", pair, "--report")
    assert code == 2 and "--report without --out" in err
    made = ("fit", log, "--pair", pair, "--out", tmp_path / "run", "--no-figures", "--report")
    code, out, _ = vttig(*made)
    report = tmp_path / "run" / "report.html"
    assert code == 0 and out.splitlines()[-1] == f"report: {report}" and report.is_file()
    assert vttig(*made[:-1], "--overwrite")[0] == 0
    assert not report.exists()  # it was that of the fit before


@pytest.fixture
def drive_run(tmp_path, vttig, monkeypatch):
    """Function that fits a small drive with a name and orders, and returns its run folder."""
    monkeypatch.chdir(tmp_path)

    def fitted(name: str, **orders) -> Path:
        write_drive(tmp_path / "log.csv")
        pair = {"name": name} | PAIR | ({"fit": orders} if orders else {})
        (tmp_path / "pair.toml").write_text(tomli_w.dumps(pair))
        made = ("log.csv", "--pair", "pair.toml", "--out", "run", "--no-figures", "--overwrite")
        assert vttig("fit", *made)[0] in (0, 4)
        return tmp_path / "run"

    return fitted


@pytest.mark.parametrize("name", ["</script><script>alert(1)</script>", "n" * 10_000])
def test_text_of_files_is_text(vttig, drive_run, name):
    run = drive_run(name)
    (run / "<script>b.csv").write_text("a,b\n")
    assert vttig("report", run)[0] == 0
    page = (run / "report.html").read_text("utf-8")
    assert "<script>alert" not in page and "<script>b" not in page
    assert "n" * 1000 not in re.sub('href="data:[^"]*"', "", page)  # the files hold it as it is
    assert page.count("<script") == 3 and len(page) < 3_000_000
    shown = "&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt;"
    assert name.startswith("n") or f"<h1>{shown}</h1>" in page


def test_sixty_parameters(vttig, drive_run):
    orders = list(range(1, 16))
    run = drive_run("many", driving_orders=orders, driven_orders=[k for k in orders if k % 2])
    assert vttig("report", run)[0] == 0
    page = (run / "report.html").read_text("utf-8")
    assert len(page) < 3_000_000 and "driving 15" in page


def test_nothing_determined(vttig, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = np.arange(4000) * 1e-3
    angle = 40.0 * time
    rows = np.stack([time, angle, angle / 2], axis=1)
    np.savetxt("log.csv", rows, delimiter=",", header="time_s,driving_deg,driven_deg", comments="")
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(PAIR))
    code, _, err = vttig("fit", "log.csv", "--pair", "pair.toml", "--out", "run", "--no-figures")
    assert code == 4, err
    assert vttig("report", "run")[0] == 0
    page = (tmp_path / "run" / "report.html").read_text("utf-8")
    assert "The log does not tell" in page and "record" in page.lower()


def test_an_older_version_and_folders_that_hold_no_fit(vttig, run_folder, tmp_path):
    run = copied(run_folder, tmp_path)
    with np.load(run / "summary.npz") as arrays:
        kept = {name: arrays[name] for name in arrays.files if name != "core"}
    np.savez(run / "summary.npz", **kept)
    before = {path.name for path in run.iterdir()}
    for folder, code, said in (
        (run, 3, "older version"),
        (tmp_path / "none", 2, "no such folder"),
        (tmp_path, 2, "run.toml"),
    ):
        found, out, err = vttig("report", folder)
        assert (found, out) == (code, "") and said in err and err.count("\n") == 1
    assert {path.name for path in run.iterdir()} == before


def test_no_file_outside_the_folder_is_read(vttig, run_folder, tmp_path):
    run = copied(run_folder, tmp_path)
    (tmp_path / "secret.csv").write_text("the secret\n")
    (run / "link.csv").symlink_to(tmp_path / "secret.csv")
    (run / "own.csv").write_text("the own\n")
    assert vttig("report", run)[0] == 0
    page = (run / "report.html").read_text("utf-8")
    assert "secret" not in page and "own.csv" in page and "link.csv" not in page


def test_without_the_extra(vttig, run_folder, rig_folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh.plotting", None)
    code, out, err = vttig("report", run_folder, "--out", tmp_path / "r.html")
    assert (code, out) == (2, "") and 'pip install "vttig-jax[report]"' in err
    log, pair = rig_folder / "log.csv", rig_folder / "pair.toml"
    assert vttig("fit", log, "--pair", pair, "--out", tmp_path / "run", "--report")[0] == 2
    assert list(tmp_path.iterdir()) == []
