import json
import subprocess
import sys

import jsonschema
import numpy as np
import pytest
from scipy.io import savemat

from tests.schemas import load_schema
from vttig_jax.cli.main import main

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
def files(tmp_path):
    pair, log = tmp_path / "pair.toml", tmp_path / "log.csv"
    pair.write_text(PAIR)
    first = 450 * np.arange(2000)
    rows = (f"{k / 100:.2f},{a},{a * 9 // 16}\n" for k, a in enumerate(first))
    log.write_text("time_s,driving_counts,driven_counts\n" + "".join(rows))
    return log, pair


def run(capsys, *arguments):
    code = main(["inspect", *map(str, arguments)])
    streams = capsys.readouterr()
    return code, streams.out, streams.err


@pytest.mark.portable
def test_with_a_pair(files, capsys):
    log, pair = files
    code, out, err = run(capsys, log, "--pair", pair)
    assert code == 0 and err == ""
    assert "ratio" in out and "flank A (forward)" in out and "driving_counts" in out


@pytest.mark.portable
def test_json(files, capsys):
    log, pair = files
    for extra in ([], ["--pair", pair]):
        code, out, _ = run(capsys, log, "--json", *extra)
        found = json.loads(out)
        jsonschema.validate(found, load_schema("vttig.inspect/1"))
        assert code == 0 and found["samples"]["read"] == 2000
        assert ("segments" in found) == bool(extra)


def test_without_a_pair(files, capsys):
    code, out, _ = run(capsys, files[0])
    assert code == 0 and "first look" in out and "(9/16)" in out


def test_options_reach_the_reader(files, capsys):
    log, pair = files
    swapped = ["--column", "driving=driven_counts", "--column", "driven=driving_counts"]
    code, out, _ = run(capsys, log, "--pair", pair, *swapped)
    assert code == 0 and "exchange them" in " ".join(out.split())
    _, out, _ = run(capsys, log, "--pair", pair, "--sample-rate", 50, "--json")
    assert json.loads(out)["sampling"]["rate_hz"] == pytest.approx(50.0)
    log.write_text(log.read_text().replace(",", ";").replace(".", ","))
    code, _, err = run(capsys, log, "--decimal", ".", "--pair", pair)
    assert code == 3 and "is no number" in err
    assert run(capsys, log, "--decimal", ",", "--pair", pair)[0] == 0


def test_usage(files, capsys):
    for options, words in (
        (["--column", "driving"], "ROLE=NAME"),
        (["--column", "load=x"], "ROLE=NAME"),
        (["--column", "time=a", "--column", "time=b"], "named twice"),
        (["--column", "time=time_s", "--sample-rate", "5"], "keep the one"),
        (["--sample-rate", "0"], "sample-rate"),
        (["--decimal", ";"], "decimal"),
    ):
        code, out, err = run(capsys, files[0], *options)
        assert code == 2 and words in err and out == ""


def test_nested_files_and_numbered_columns_need_no_pair(tmp_path, capsys):
    path = tmp_path / "log.mat"
    angles = np.outer([1.0, 0.5], np.linspace(0, 3600, 400))
    savemat(path, {"rec": {"pos_deg": angles, "gains": np.arange(3.0)}})
    named = ["--column", "driving=pos_deg(1,:)", "--column", "driven=pos_deg(2,:)"]
    code, out, err = run(capsys, path, *named, "--sample-rate", "20", "--json")
    found = json.loads(out)
    jsonschema.validate(found, load_schema("vttig.inspect/1"))
    assert (code, err) == (0, "")
    assert found["other_arrays"] == [{"name": "rec.gains", "values": 3}]
    assert found["ratio"]["seen"] == pytest.approx(0.5)
    plain = tmp_path / "log.csv"
    plain.write_text("".join(f"{k},{k / 2}\n" for k in range(40)))
    code, out, _ = run(capsys, plain, "--column", "driving=#1", "--column", "driven=#2")
    assert code == 0 and "driven   #2" in out
    code, _, err = run(capsys, path, "--column", "driving=#9")
    assert code == 3 and "there is no column #9" in err


def test_further_roles_are_read(files, capsys):
    log, pair = files
    rows = log.read_text().splitlines()
    log.write_text("\n".join(f"{row},{'w_rpm' if k == 0 else 60}" for k, row in enumerate(rows)))
    assert run(capsys, log, "--pair", pair, "--column", "speed=w_rpm")[0] == 0
    code, _, err = run(capsys, log, "--pair", pair, "--column", "acceleration=w_rpm")
    assert code == 3 and "_rad_per_s2" in err


@pytest.mark.parametrize("extra", [[], ["--json"]])
def test_unreadable_logs_are_one_sentence(files, tmp_path, capsys, extra):
    log, pair = files
    log.write_text("time_s,driving_counts,driven_counts\n")
    for target, words in ((log, "header"), (tmp_path, "folder"), (tmp_path / "no.csv", "no such")):
        code, out, err = run(capsys, target, "--pair", pair, *extra)
        assert code == 3 and words in err and err.count("\n") == 1 and "Traceback" not in err
        if extra:
            found = json.loads(out)
            jsonschema.validate(found, load_schema("vttig.error/1"))
            assert found["exit"] == 3
        else:
            assert out == ""


def test_inspect_imports_no_jax(files):
    log, pair = files
    script = (
        "import sys; from vttig_jax.cli.main import main;"
        f"code = main(['inspect', {str(log)!r}, '--pair', {str(pair)!r}]);"
        "sys.exit(code or 9 * ('jax' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_a_picture_before_any_fit(files, capsys, tmp_path, suffix):
    (log, pair), picture = files, tmp_path / f"raw.{suffix}"
    code, out, err = run(capsys, log, "--pair", pair, "--picture", picture)
    assert code == 0 and err == "" and out.endswith(f"picture: {picture}\n")
    starts = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert picture.read_bytes().startswith(starts[suffix])
    code, out, err = run(capsys, log, "--pair", pair, "--picture", picture)
    assert (code, out) == (2, "") and "--overwrite" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--picture", "raw.png"), "--ratio"),
        (("--teeth", "45/80", "--picture", "raw.txt"), ".svg"),
        (("--teeth", "45/80", "--overwrite"), "--picture"),
        (("--for", "linuxcnc", "--picture", "raw.png"), "--picture"),
    ],
)
def test_a_picture_that_cannot_be(files, capsys, monkeypatch, tmp_path, arguments, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, files[0], *arguments)
    assert (code, out) == (2, "") and said in err and err.count("\n") == 1
    assert not list(tmp_path.glob("raw.*"))
