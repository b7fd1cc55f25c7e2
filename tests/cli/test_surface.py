import math
import sys

import pytest
from matplotlib.image import imread

from tests.cli.commands import PAPER, row_of
from tests.pair.texts import CONTRACT, DRIVE, MINIMAL

COARSE = ("--tolerance-um", "50")
DRIVING = ("surface", PAPER, "--gear", "driving", "--out")
DRIVEN = ("surface", PAPER, "--gear", "driven", "--out")


def test_a_mesh_of_the_papers_gear(vttig, found, tmp_path):
    for suffix in (".stl", ".STL"):
        out = tmp_path / f"gear{suffix}"
        record = found(*DRIVING, out, *COARSE)
        assert record["format"] == "stl" and record["teeth"] == 45
        assert record["bytes"] == out.stat().st_size == 84 + 50 * record["triangles"]
        assert 5.0 < record["error_um"] <= 50.0 == record["tolerance_um"]
        assert record["volume_mm3"] == pytest.approx(116300, rel=1e-3)
        assert "overlap from z = -10 to -2.457 mm" in record["notes"][0]
    code, text, err = vttig(*DRIVEN, tmp_path / "driven.stl", *COARSE)
    assert (code, err) == (0, "")
    assert text.startswith("VTTIG rig of the paper, driven gear\n")
    assert row_of(text, "format") == "STL" and row_of(text, "teeth") == "80"
    assert row_of(text, "measured error").endswith("µm of 50 µm allowed")
    assert row_of(text, "volume").endswith("mm³")
    assert text.rstrip().endswith(f"written to {tmp_path / 'driven.stl'}")


@pytest.mark.portable
def test_a_sector_with_a_bore(found, tmp_path):
    for call, teeth, radius in ((DRIVING, 45, 44.9), (DRIVEN, 80, 79.9)):
        out = tmp_path / f"{teeth}.stl"
        record = found(*call, out, "--teeth", "9", "--bore-mm", "0", *COARSE)
        whole = record["volume_mm3"] * teeth / 9
        assert record["teeth"] == 9 and whole == pytest.approx(math.pi * radius**2 * 20, rel=0.02)


@pytest.mark.parametrize("suffix", [".svg", ".dxf"])
def test_a_section(told, found, tmp_path, suffix):
    if suffix == ".dxf":
        pytest.importorskip("ezdxf", reason="needs the extra `cad`")
    areas, out = [], tmp_path / f"section{suffix}"
    for z in ("-10", "0", "10"):
        record = found(*DRIVING, out, "--section-mm", z, "--overwrite")
        assert record["section_mm"] == float(z)
        assert record["error_um"] <= 1.0 == record["tolerance_um"]
        areas.append(record["area_mm2"])
    assert areas == sorted(areas, reverse=True)
    text = told(*DRIVING, out, "--section-mm", "10", "--overwrite")
    assert row_of(text, "section at z") == "10 mm" and row_of(text, "area").endswith("mm²")


@pytest.mark.parametrize("suffix", [".step", ".stp"])
def test_a_solid(told, found, tmp_path, suffix):
    pytest.importorskip("OCP.collections", reason="needs the extra `cad`")
    out = tmp_path / f"gear{suffix}"
    call = (*DRIVING, out, "--teeth", "2", *COARSE)
    text = told(*call)
    assert row_of(text, "format") == "STEP" and int(row_of(text, "faces")) > 20
    record = found(*call, "--overwrite")
    assert record["format"] == "step"
    assert record["volume_mm3"] == pytest.approx(116300 * 2 / 45, rel=1e-3)
    assert out.read_bytes().startswith(b"ISO-10303-21;")


def test_a_picture(told, found, tmp_path):
    out = tmp_path / "tooth.png"
    record = found(*DRIVEN, out)
    assert record["format"] == "png" and record["teeth"] == 80
    assert record["bytes"] == out.stat().st_size and "error_um" not in record
    pixels = imread(out)
    assert pixels.shape[1] == 1200 and 0.01 < (pixels[..., :3] < 0.9).any(axis=-1).mean() < 0.5
    text = told(*DRIVEN, out, "--overwrite")
    assert row_of(text, "format") == "PNG" and "µm" not in text


def test_a_missing_extra_is_named(refused, tmp_path, monkeypatch):
    for module, name in (("OCP.collections", "gear.step"), ("ezdxf", "gear.dxf")):
        monkeypatch.setitem(sys.modules, module, None)
        refused(2, "pip install vttig-jax[cad]", *DRIVING, tmp_path / name)
        assert not (tmp_path / name).exists()


def test_gears_without_a_solid(refused, pair_file, tmp_path):
    face, out = "face_width_mm = 20.0", tmp_path / "gear.stl"
    assert face in CONTRACT
    for text, place, words in (
        (DRIVE, "drive", "a drive without gears has no surface; give [pair]"),
        (
            CONTRACT.replace(face, "face_width_mm = 30.0"),
            "driving: tip circle",
            "pointed at z = 15 mm: its flanks meet at a diameter of 93.783 mm",
        ),
        (
            CONTRACT.replace(face, "face_width_mm = 90.0"),
            "driving: thickness",
            "on the reference circle at z = 45 mm",
        ),
        (MINIMAL, "driving: face_width_mm", "give its face_width_mm"),
    ):
        path = pair_file(text)
        said = refused(3, words, "surface", path, "--gear", "driving", "--out", out)
        assert said.startswith(f"error: {path}: {place}: ") and not out.exists()


def test_bad_calls_end_in_one_sentence(refused, tmp_path):
    for name, options, words in (
        ("gear.iges", "", ".stl, .step, .stp, .svg, .dxf or .png"),
        ("gear", "", "choose a name that ends with one"),
        ("gear.stl", "--section-mm 0", "a .stl file takes no --section-mm"),
        ("tooth.png", "--teeth 1", "a .png file takes no --teeth; leave it out"),
        ("tooth.png", "--bore-mm 9 --section-mm 0", "no --bore-mm and no --section-mm"),
        ("tooth.png", "--tolerance-um 2", "takes no --tolerance-um"),
        ("gear.svg", "--section-mm 11", "face ends at ±10 mm"),
        ("gear.stl", "--teeth 46", "has 45 teeth"),
        ("gear.stl", "--teeth 0", "--teeth"),
        ("gear.stl", "--bore-mm 85", "leaves no rim"),
        ("gear.step", "--bore-mm 1e-9", "give --bore-mm 0 for a gear without"),
        ("gear.svg", "--bore-mm 0.05", "give --bore-mm 0 for a gear without"),
        ("gear.stl", "--bore-mm -1", "--bore-mm"),
        ("gear.stl", "--tolerance-um 0", "--tolerance-um"),
        ("gear.stl", "--tolerance-um 0.01", "write .step"),
        ("gear.obj", "", "trimesh.load"),
        ("gear.svg", "--tolerance-um 1e-6", "give --tolerance-um 1e-05 or more"),
    ):
        refused(2, words, *DRIVING, tmp_path / name, *options.split())
        assert not (tmp_path / name).exists()
    out = tmp_path / "gear.stl"
    out.write_text("mine")
    refused(2, "already exists; add --overwrite", *DRIVING, out, *COARSE)
    assert out.read_text() == "mine"
