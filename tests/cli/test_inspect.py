import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.io import savemat

PAIR = """
[pair]
module_mm = 2.0
pressure_angle_deg = 20.0
[driving]
teeth = 45
encoder = { counts_per_rev = 90000 }
[driven]
teeth = 80
encoder = { counts_per_rev = 90000 }
"""


@pytest.fixture
def log(tmp_path):
    log = tmp_path / "log.csv"
    rows = (f"{k / 100:.2f},{450 * k},{450 * k * 9 // 16}\n" for k in range(2000))
    log.write_text("time_s,driving_counts,driven_counts\n" + "".join(rows))
    return log


@pytest.fixture
def files(log, pair_file):
    """Arguments of a log with its pair file."""
    return ("inspect", log, "--pair", pair_file(PAIR))


@pytest.mark.portable
def test_with_and_without_a_pair(files, vttig, found):
    code, out, err = vttig(*files)
    assert (code, err) == (0, "")
    assert "ratio" in out and "flank A (forward)" in out and "driving_counts" in out
    code, out, err = vttig(*files[:2])
    assert code == 0 and "first look" in out and "(9/16)" in out
    for call in (files, files[:2]):
        record = found(*call)
        assert record["schema"] == "vttig.inspect/1" and record["samples"]["read"] == 2000
        assert ("segments" in record) == (call == files)


def test_options_reach_the_reader(files, log, told, found, refused):
    swapped = ("--column", "driving=driven_counts", "--column", "driven=driving_counts")
    assert "exchange them" in " ".join(told(*files, *swapped).split())
    assert found(*files, "--sample-rate", 50)["sampling"]["rate_hz"] == pytest.approx(50.0)
    rows = log.read_text().splitlines()
    log.write_text("\n".join(f"{row},{'w_rpm' if k == 0 else 60}" for k, row in enumerate(rows)))
    told(*files, "--column", "speed=w_rpm")
    refused(3, "_rad_per_s2", *files, "--column", "acceleration=w_rpm")
    log.write_text(log.read_text().replace(",", ";").replace(".", ","))
    refused(3, "is no number", *files, "--decimal", ".")
    told(*files, "--decimal", ",")


def test_usage(log, refused, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for options, words in (
        ("--column driving", "ROLE=NAME"),
        ("--column load=x", "ROLE=NAME"),
        ("--column time=a --column time=b", "named twice"),
        ("--column time=time_s --sample-rate 5", "keep the one"),
        ("--sample-rate 0", "sample-rate"),
        ("--decimal ;", "decimal"),
        ("--picture raw.png", "--ratio"),
        ("--teeth 45/80 --picture raw.txt", ".svg"),
        ("--teeth 45/80 --overwrite", "--picture"),
        ("--for linuxcnc --picture raw.png", "--picture"),
    ):
        refused(2, words, "inspect", log, *options.split())
        assert not list(tmp_path.glob("raw.*"))


def test_nested_files_and_numbered_columns_need_no_pair(tmp_path, told, found, refused):
    path, plain = tmp_path / "log.mat", tmp_path / "log.csv"
    angles = np.outer([1.0, 0.5], np.linspace(0, 3600, 400))
    savemat(path, {"rec": {"pos_deg": angles, "gains": np.arange(3.0)}})
    named = ("--column", "driving=pos_deg(1,:)", "--column", "driven=pos_deg(2,:)")
    record = found("inspect", path, *named, "--sample-rate", "20")
    assert record["other_arrays"] == [{"name": "rec.gains", "values": 3}]
    assert record["ratio"]["seen"] == pytest.approx(0.5)
    plain.write_text("".join(f"{k},{k / 2}\n" for k in range(40)))
    numbered = ("--column", "driving=#1", "--column", "driven=#2")
    assert "driven   #2" in told("inspect", plain, *numbered)
    refused(3, "there is no column #9", "inspect", path, "--column", "driving=#9")


def test_unreadable_logs_are_one_sentence(files, log, tmp_path, refused, vttig_json):
    log.write_text("time_s,driving_counts,driven_counts\n")
    for target, words in ((log, "header"), (tmp_path, "folder"), (tmp_path / "no.csv", "no such")):
        refused(3, words, "inspect", target, *files[2:])
        code, record = vttig_json("inspect", target, *files[2:])
        assert (code, record["schema"], record["exit"]) == (3, "vttig.error/1", 3)


def test_inspect_imports_no_jax(files):
    script = (
        "import json, sys; from vttig_jax.cli.main import main;"
        "code = main(json.loads(sys.argv[1])); sys.exit(code or 9 * ('jax' in sys.modules))"
    )
    command = [sys.executable, "-c", script, json.dumps([str(one) for one in files])]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_picture_before_any_fit(files, vttig, refused, tmp_path):
    call = (*files, "--picture", tmp_path / "raw.svg")
    code, out, err = vttig(*call)
    assert code == 0 and err == "" and out.endswith(f"picture: {call[-1]}\n")
    assert call[-1].read_bytes().startswith(b"<?xml")
    refused(2, "--overwrite", *call)
