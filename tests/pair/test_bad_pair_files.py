"""Every way to get the pair file wrong: one sentence that names file and key, exit 3."""

import pytest

from tests.pair.texts import CONTRACT, DRIVE, MINIMAL
from vttig_jax.base.errors import PairError
from vttig_jax.pair.gear_pair import load_pair
from vttig_jax.pair.pair_file import parse_pair_spec

pytestmark = pytest.mark.smoke

C, M, D = CONTRACT, MINIMAL, DRIVE
MODULE, ANGLE, CENTRE = "module_mm = 2.0", "pressure_angle_deg = 20.0", "125.12"
Z1, Z2, DRIVEN = "teeth = 45", "teeth = 80", "[driven]"
HELIX_2 = "teeth = 80\nface_width_mm = 20.0\nhelix_angle_deg = 3.0"
NORMAL = M.replace("module_mm", "normal_module_mm").replace(Z1, f"{Z1}\nhelix_left_deg = 3.0")
RATIO = 'ratio = "7/1798"'

BAD = [
    # a text, what is replaced in it ("" for its end), by what, and the key that is named
    (C, MODULE, "modul_mm = 2.0", "pair.modul_mm"),
    (M, "", '[log]\nxyz = "a"', "log.xyz"),
    (M, "", "[units]", "units"),
    (C, "counts_per_rev = 90000,", "count_per_rev = 90000,", "driving.encoder.count_per_rev"),
    (C, Z1, "teeth = 0", "driving.teeth"),
    (C, Z2, "teeth = -80", "driven.teeth"),
    (C, Z1, f"teeth = {10**30}", "driving.teeth"),
    (M, "teeth = 80\n", "", "driven.teeth"),
    (C, Z1, "teeth = 45.5", "driving.teeth"),
    (C, MODULE, 'module_mm = "2.0"', "pair.module_mm"),
    ("", "", "pair = 3", "pair"),
    (C, MODULE, f"{MODULE}\nnormal_module_mm = 2.0", "pair.module_mm"),
    (M, f"{MODULE}\n", "", "pair.module_mm"),
    (C, ANGLE, f"{ANGLE}\nnormal_pressure_angle_deg=20.0", "pair.pressure_angle_deg"),
    (M, f"{ANGLE}\n", "", "pair.pressure_angle_deg"),
    (C, ANGLE, "pressure_angle_deg = 95.0", "pair.pressure_angle_deg"),
    (C, "helix_angle_deg = 3.0 ", "helix_angle_deg = 3.0\nhelix_left_deg = 3.0 ",
     "driving.helix_angle_deg"),
    (C, HELIX_2, HELIX_2.replace("3.0", "4.0"), "driven.helix_angle_deg"),
    (NORMAL, Z2, f"{Z2}\nhelix_left_deg = 3.0", "pair.normal_module_mm"),
    (C, CENTRE, "117.0", "pair.centre_distance_mm"),
    (C, CENTRE, "124.4", "pair.centre_distance_mm"),
    (C, CENTRE, "129.0", "pair.centre_distance_mm"),
    (C, MODULE, "module_mm = inf", "pair.module_mm"),
    (C, CENTRE, "nan", "pair.centre_distance_mm"),
    (M, "", D, "pair"),
    ("", "", "[driving]\nteeth = 45", "pair"),
    ("", "", "", "pair"),
    (D, "", "[driving]\nteeth = 45", "driving.teeth"),
    (D, "", "[driven]\nhelix_left_deg = 3.0", "driven.helix_left_deg"),
    (D, RATIO, "", "drive"),
    *((D, RATIO, f"ratio = {text}", "drive.ratio") for text in (
        '"seven"', '"7/0"', '"6:1:2"', '"6:1/2"', '"6:"', '"1/2/3"', '"1/1e-99999999"', "-0.5",
        "nan", '"1e99999999999"', "true")),
    (M, "", '[log]\ndriving_scale = "x"', "log.driving_scale"),
    (M, "", '[log]\ntime = "t"\nsample_rate_hz = 1000.0', "log.sample_rate_hz"),
    (M, "", '[log]\nfrom = "end"', "log.from"),
    (M, "", '[log]\nto = "3min"', "log.to"),
    (M, "", '[log]\ncut = ["4rev:3rev"]', "log.cut"),
    (M, "", '[log]\nmissing = "fill"', "log.missing"),
    (M, "", "[log]\nlead_mm = 0", "log.lead_mm"),
    (M, "", '[log]\ndriven = "a"\ntransmission_error = "b"', "log.transmission_error"),
    (M, "", '[log]\ndecimal = ";"', "log.decimal"),
    (M, "", '[unit]\ndriven = "grad"', "unit.driven"),
    (C, "accuracy_arcsec = 18 }   #", "sign = 2 }   #", "driving.encoder.sign"),
    (M, "", "[fit]\ndriving_orders = [1, 0]", "fit.driving_orders[1]"),
    (M, "", "[fit]\ndriven_orders = [1, -3.087]", "fit.driven_orders[1]"),
    (M, "", "[fit]\ndriving_orders = [nan]", "fit.driving_orders[0]"),
    (M, "", "[fit]\nmesh_orders = -1", "fit.mesh_orders"),
    (M, Z1, f"{Z1}\nprofile_shift = 0.3", "pair.centre_distance_mm"),
    (C, "face_width_mm = 20.0\nhelix", "face_width_mm = 20.0\nprofile_shift=0.5\nhelix",
     "pair.centre_distance_mm"),
    (M, Z1, f"{Z1}\nprofile_shift = 5.5", "driving.profile_shift"),
    (M, Z2, f"{Z2}\ncrowning_um = 5.0", "driven.face_width_mm"),
    (C, Z1, f"{Z1}\ncrowning_um = -5.0", "driving.crowning_um"),
    (M, "", "[rack]\naddendum = 0.0", "rack.addendum"),
    (M, "", "[rack]\ndedendum = 1.25", "rack.dedendum"),
    (M, "", "[rack]\nclearance = -0.1", "rack.clearance"),
    (C.replace(CENTRE, "124.9"), "", "[rack]\nclearance = 0.02", "pair.centre_distance_mm"),
    (D, "", "[rack]\naddendum = 0.9", "rack"),
    (D, "", "[driving]\nprofile_shift = 0.1", "driving.profile_shift"),
    (D, "", "[driven]\ncrowning_um = 3.0", "driven.crowning_um"),
    (D, "", "[driven.stated]\ntip_diameter_mm = 94.0", "driven.stated"),
    (M, "", "[driven.stated]\nover_balls_mm = 165.0", "driven.stated.ball_diameter_mm"),
    (C, "", "[driving.stated]\nspan_mm = 27.8", "driving.stated.span_teeth"),
    (M, "", "[driven.stated]\ntooth_thickness_thin_mm = -1.0",
     "driven.stated.tooth_thickness_thin_mm"),
    (M, "", "[driven.stated]\ntip_diameter = 164.0", "driven.stated.tip_diameter"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "key"), BAD)
def test_a_bad_table_is_one_sentence_that_names_file_and_key(tmp_path, text, old, new, key):
    assert old in text
    path = tmp_path / "pair.toml"
    path.write_text(text.replace(old, new) if old else f"{text}{new}\n", encoding="utf-8")
    with pytest.raises(PairError) as caught:
        load_pair(path)
    assert caught.value.where == f"{path}: {key}"
    assert caught.value.message[-1] in ".?" and "\n" not in str(caught.value)
    assert caught.value.exit_code == 3


def test_a_table_of_no_file_and_a_file_that_is_not_there(tmp_path):
    with pytest.raises(PairError, match="no such file"):
        load_pair(tmp_path / "pair.toml")
    with pytest.raises(PairError, match="folder"):
        load_pair(tmp_path)
    with pytest.raises(PairError) as caught:
        parse_pair_spec({"pair": {"module_mm": 2.0, "pressure_angle_deg": 20.0}})
    assert caught.value.where == "driving.teeth"


@pytest.mark.parametrize("failure", [PermissionError(13, "denied"), OSError(5, "Input/output")])
def test_a_file_that_cannot_be_read_is_refused(failure, tmp_path, monkeypatch):
    """The failure is made, because a superuser may read everything."""

    def refuse(_):
        raise failure

    (tmp_path / "pair.toml").write_text(MINIMAL)
    monkeypatch.setattr("vttig_jax.base.files.toml_io.read_regular", refuse)
    with pytest.raises(PairError):
        load_pair(tmp_path / "pair.toml")
