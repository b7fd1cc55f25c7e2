import math
import sys
from pathlib import Path

import pytest
from matplotlib.image import imread

from tests.pair.texts import CONTRACT, DRIVE, MINIMAL

PAPER = Path(__file__).parents[2] / "fits" / "paper" / "pair.toml"
COARSE = ["--tolerance-um", "50"]


def row(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(f"  {label}  ")]
    return line.removeprefix(f"  {label}").strip()


def replaced(old, new, text=CONTRACT):
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize("suffix", [".stl", ".STL"])
def test_a_mesh_of_the_papers_gear(vttig_json, tmp_path, suffix):
    out = tmp_path / f"gear{suffix}"
    code, record = vttig_json("surface", PAPER, "--gear", "driving", "--out", out, *COARSE)
    assert code == 0 and record["format"] == suffix[1:].lower()
    assert record["bytes"] == out.stat().st_size and record["teeth"] == 45
    assert 5.0 < record["error_um"] <= 50.0 == record["tolerance_um"]
    assert record["volume_mm3"] == pytest.approx(116300, rel=1e-3)
    if suffix.lower() == ".stl":
        assert record["bytes"] == 84 + 50 * record["triangles"]
    assert "overlap from z = -10 to -2.457 mm" in record["notes"][0]


def test_the_table(vttig, tmp_path):
    out = tmp_path / "gear.stl"
    code, text, err = vttig("surface", PAPER, "--gear", "driven", "--out", out, *COARSE)
    assert (code, err) == (0, "")
    assert text.startswith("VTTIG rig of the paper, driven gear\n")
    assert row(text, "format") == "STL" and row(text, "teeth") == "80"
    assert row(text, "measured error").endswith("µm of 50 µm allowed")
    assert row(text, "volume").endswith("mm³")
    assert text.rstrip().endswith(f"written to {out}")


@pytest.mark.portable
def test_a_sector_with_a_bore(vttig_json, tmp_path):
    options = ["--teeth", "9", "--bore-mm", "0", *COARSE]
    found = {}
    for shaft, teeth in (("driving", 45), ("driven", 80)):
        out = tmp_path / f"{shaft}.stl"
        code, record = vttig_json("surface", PAPER, "--gear", shaft, "--out", out, *options)
        assert code == 0 and record["teeth"] == 9
        found[shaft] = record["volume_mm3"] * teeth / 9
    assert found["driving"] == pytest.approx(math.pi * 44.9**2 * 20, rel=0.02)
    assert found["driven"] == pytest.approx(math.pi * 79.9**2 * 20, rel=0.02)


@pytest.mark.parametrize("suffix", [".svg", ".dxf"])
def test_a_section(vttig, vttig_json, tmp_path, suffix):
    if suffix == ".dxf":
        pytest.importorskip("ezdxf", reason="needs the extra `cad`")
    areas = {}
    for z in ("-10", "0", "10"):
        out = tmp_path / f"section{z}{suffix}"
        options = ["--gear", "driving", "--out", out, "--section-mm", z]
        code, record = vttig_json("surface", PAPER, *options)
        assert code == 0 and record["section_mm"] == float(z)
        assert record["error_um"] <= 1.0 == record["tolerance_um"]
        areas[z] = record["area_mm2"]
    assert areas["-10"] > areas["0"] > areas["10"]
    _, text, _ = vttig("surface", PAPER, *options, "--overwrite")
    assert row(text, "section at z") == "10 mm" and row(text, "area").endswith("mm²")


@pytest.mark.parametrize("suffix", [".step", ".stp"])
def test_a_solid(vttig, vttig_json, tmp_path, suffix):
    pytest.importorskip("OCP.collections", reason="needs the extra `cad`")
    out = tmp_path / f"gear{suffix}"
    options = ["--gear", "driving", "--out", out, "--teeth", "2", *COARSE]
    code, text, _ = vttig("surface", PAPER, *options)
    assert code == 0 and row(text, "format") == "STEP" and int(row(text, "faces")) > 20
    code, record = vttig_json("surface", PAPER, *options, "--overwrite")
    assert code == 0 and record["format"] == "step"
    assert record["volume_mm3"] == pytest.approx(116300 * 2 / 45, rel=1e-3)
    assert out.read_bytes().startswith(b"ISO-10303-21;")


def test_a_picture(vttig, vttig_json, tmp_path):
    out = tmp_path / "tooth.png"
    code, record = vttig_json("surface", PAPER, "--gear", "driven", "--out", out)
    assert code == 0 and record["format"] == "png" and record["teeth"] == 80
    assert record["bytes"] == out.stat().st_size and "error_um" not in record
    pixels = imread(out)
    assert pixels.shape[1] == 1200 and 0.01 < (pixels[..., :3] < 0.9).any(axis=-1).mean() < 0.5
    code, text, _ = vttig("surface", PAPER, "--gear", "driven", "--out", out, "--overwrite")
    assert code == 0 and row(text, "format") == "PNG" and "µm" not in text


def test_a_missing_extra_is_named(vttig, tmp_path, monkeypatch):
    for module in ("OCP.collections", "ezdxf"):
        monkeypatch.setitem(sys.modules, module, None)
    for name in ("gear.step", "gear.dxf"):
        out = tmp_path / name
        code, text, err = vttig("surface", PAPER, "--gear", "driving", "--out", out)
        assert (code, text) == (2, "")
        assert "pip install vttig-jax[cad]" in err and err.count("\n") == 1
        assert not out.exists()


BAD_GEARS = {
    "drive": (DRIVE, "drive", "a drive without gears has no surface; give [pair]"),
    "pointed": (
        replaced("face_width_mm = 20.0", "face_width_mm = 30.0"),
        "driving: tip circle",
        "pointed at z = 15 mm: its flanks meet at a diameter of 93.783 mm",
    ),
    "no thickness": (
        replaced("face_width_mm = 20.0", "face_width_mm = 90.0"),
        "driving: thickness",
        "on the reference circle at z = 45 mm",
    ),
    "no width": (MINIMAL, "driving: face_width_mm", "give its face_width_mm"),
}


def test_gears_without_a_solid(vttig, pair_file, tmp_path):
    for name in BAD_GEARS:
        text, place, words = BAD_GEARS[name]
        path, out = pair_file(text), tmp_path / "gear.stl"
        code, printed, err = vttig("surface", path, "--gear", "driving", "--out", out)
        assert (code, printed) == (3, "") and not out.exists()
        assert err.startswith(f"error: {path}: {place}: ") and words in err and err.count("\n") == 1


def test_bad_calls_end_in_one_sentence(vttig, tmp_path):
    for name, options, words in (
        ("gear.iges", [], ".stl, .step, .stp, .svg, .dxf or .png"),
        ("gear", [], "choose a name that ends with one"),
        ("gear.stl", ["--section-mm", "0"], "a .stl file takes no --section-mm"),
        ("tooth.png", ["--teeth", "1"], "a .png file takes no --teeth; leave it out"),
        ("tooth.png", ["--bore-mm", "9", "--section-mm", "0"], "no --bore-mm and no --section-mm"),
        ("tooth.png", ["--tolerance-um", "2"], "takes no --tolerance-um"),
        ("gear.svg", ["--section-mm", "11"], "face ends at ±10 mm"),
        ("gear.stl", ["--teeth", "46"], "has 45 teeth"),
        ("gear.stl", ["--teeth", "0"], "--teeth"),
        ("gear.stl", ["--bore-mm", "85"], "leaves no rim"),
        ("gear.step", ["--bore-mm", "1e-9"], "give --bore-mm 0 for a gear without"),
        ("gear.svg", ["--bore-mm", "0.05"], "give --bore-mm 0 for a gear without"),
        ("gear.stl", ["--bore-mm", "-1"], "--bore-mm"),
        ("gear.stl", ["--tolerance-um", "0"], "--tolerance-um"),
        ("gear.stl", ["--tolerance-um", "0.01"], "write .step"),
        ("gear.obj", [], "trimesh.load"),
        ("gear.svg", ["--tolerance-um", "1e-6"], "give --tolerance-um 1e-05 or more"),
    ):
        out = tmp_path / name
        code, printed, err = vttig("surface", PAPER, "--gear", "driving", "--out", out, *options)
        assert (code, printed) == (2, "") and not out.exists()
        assert words in err and err.count("\n") == 1


def test_a_file_that_exists_is_kept(vttig, tmp_path):
    out = tmp_path / "gear.stl"
    out.write_text("mine")
    call = ["surface", PAPER, "--gear", "driving", "--out", out, *COARSE]
    code, _, err = vttig(*call)
    assert code == 2 and "already exists; add --overwrite" in err and out.read_text() == "mine"
    assert vttig(*call, "--overwrite")[0] == 0 and out.stat().st_size > 1000
