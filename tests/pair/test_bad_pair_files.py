"""Every way to get the pair file wrong: one sentence that names file and key, exit 3."""

import pytest

from tests.pair.texts import CONTRACT, DRIVE, MINIMAL, OTHER_KEYS
from vttig_jax.base.errors import PairError
from vttig_jax.pair.load import load_pair
from vttig_jax.pair.pair_file import parse_pair_spec

pytestmark = pytest.mark.smoke


@pytest.fixture
def write(tmp_path):
    def write(text, name="pair.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def replaced(old, new, text=CONTRACT):
    assert old in text
    return text.replace(old, new)


BAD_TABLES = {
    "unknown key": (
        replaced("module_mm = 2.0", "modul_mm = 2.0"),
        "pair.modul_mm",
        "unknown key `modul_mm`; did you mean `module_mm`?",
    ),
    "unknown key without a neighbour": (
        MINIMAL + '[log]\nxyz = "a"\n',
        "log.xyz",
        "known keys here: time, sample_rate_hz",
    ),
    "unknown table": ("[units]\n" + MINIMAL, "units", "did you mean `unit`?"),
    "unknown key inside": (
        replaced("counts_per_rev = 90000,", "count_per_rev = 90000,"),
        "driving.encoder.count_per_rev",
        "did you mean `counts_per_rev`?",
    ),
    "teeth zero": (replaced("teeth = 45", "teeth = 0"), "driving.teeth", ">= 1, but it is 0"),
    "teeth negative": (replaced("teeth = 80", "teeth = -80"), "driven.teeth", "but it is -80"),
    "teeth absurd": (
        replaced("teeth = 45", f"teeth = {10**30}"),
        "driving.teeth",
        "<= 100000, but it is",
    ),
    "teeth missing": (
        replaced("teeth = 80\n", "", MINIMAL),
        "driven.teeth",
        "a [pair] needs both tooth counts",
    ),
    "teeth fractional": (
        replaced("teeth = 45", "teeth = 45.5"),
        "driving.teeth",
        "expected a whole number, but it is 45.5.",
    ),
    "wrong type": (
        replaced("module_mm = 2.0", 'module_mm = "2.0"'),
        "pair.module_mm",
        "expected a number, but it is '2.0'.",
    ),
    "table expected": ("pair = 3\n", "pair", "expected a table, but it is 3."),
    "both modules": (
        replaced("module_mm = 2.0", "module_mm = 2.0\nnormal_module_mm = 2.0"),
        "pair.module_mm",
        "`module_mm` and `normal_module_mm` are both given; give one.",
    ),
    "no module": (
        replaced("module_mm = 2.0\n", "", MINIMAL),
        "pair.module_mm",
        "`module_mm` and `normal_module_mm` are both missing; give one.",
    ),
    "both pressure angles": (
        replaced(
            "pressure_angle_deg = 20.0", "pressure_angle_deg = 20.0\nnormal_pressure_angle_deg=20.0"
        ),
        "pair.pressure_angle_deg",
        "are both given",
    ),
    "no pressure angle": (
        replaced("pressure_angle_deg = 20.0\n", "", MINIMAL),
        "pair.pressure_angle_deg",
        "are both missing",
    ),
    "pressure angle out of range": (
        replaced("pressure_angle_deg = 20.0", "pressure_angle_deg = 95.0"),
        "pair.pressure_angle_deg",
        "but it is 95.0",
    ),
    "both helix forms": (
        replaced("helix_angle_deg = 3.0 ", "helix_angle_deg = 3.0\nhelix_left_deg = 3.0 "),
        "driving.helix_angle_deg",
        "give either one angle for both flanks or one for each",
    ),
    "helix angles that differ": (
        replaced(
            "teeth = 80\nface_width_mm = 20.0\nhelix_angle_deg = 3.0",
            "teeth = 80\nface_width_mm = 20.0\nhelix_angle_deg = 4.0",
        ),
        "driven.helix_angle_deg",
        "are (4.0, 4.0), but (3.0, 3.0) on the driving gear",
    ),
    "normal module of unequal flanks": (
        MINIMAL.replace("module_mm", "normal_module_mm")
        .replace("teeth = 45", "teeth = 45\nhelix_left_deg = 3.0")
        .replace("teeth = 80", "teeth = 80\nhelix_left_deg = 3.0"),
        "pair.normal_module_mm",
        "give module_mm",
    ),
    "base circles overlap": (
        replaced("125.12", "117.0"),
        "pair.centre_distance_mm",
        "lets the base circles overlap (their radii sum to 117.462 mm)",
    ),
    "below contact": (
        replaced("125.12", "124.4"),
        "pair.centre_distance_mm",
        "too short: the tips touch the roots at 124.5 mm",
    ),
    "too far": (
        replaced("125.12", "129.0"),
        "pair.centre_distance_mm",
        "too long: the teeth lose contact at 129 mm",
    ),
    "infinite module": (replaced("module_mm = 2.0", "module_mm = inf"), "pair.module_mm", "is inf"),
    "nan": (replaced("125.12", "nan"), "pair.centre_distance_mm", "but it is nan"),
    "pair and drive": (MINIMAL + DRIVE, "pair", "[pair] and [drive] are both given"),
    "neither pair nor drive": ("[driving]\nteeth = 45\n", "pair", "[drive] are both missing"),
    "empty": ("", "pair", "[pair] and [drive] are both missing"),
    "drive with teeth": (
        DRIVE + "[driving]\nteeth = 45\n",
        "driving.teeth",
        "a [drive] has no gear geometry",
    ),
    "drive with helix": (
        DRIVE + "[driven]\nhelix_left_deg = 3.0\n",
        "driven.helix_left_deg",
        "a [drive] has no gear geometry",
    ),
    "drive without ratio": ("[drive]\n", "drive", "table missing required field ratio"),
    "ratio text": (
        '[drive]\nratio = "seven"\n',
        "drive.ratio",
        'is not a positive ratio; write a number or a quotient such as "7/1798".',
    ),
    "ratio zero denominator": ('[drive]\nratio = "7/0"\n', "drive.ratio", "'7/0' is not a positi"),
    "ratio of three": ('[drive]\nratio = "6:1:2"\n', "drive.ratio", "'6:1:2' is not a positive"),
    "ratio of both": ('[drive]\nratio = "6:1/2"\n', "drive.ratio", "'6:1/2' is not a positive"),
    "ratio to none": ('[drive]\nratio = "6:"\n', "drive.ratio", "'6:' is not a positive ratio"),
    "ratio of quotients": ('[drive]\nratio = "1/2/3"\n', "drive.ratio", "'1/2/3' is not a pos"),
    "ratio over a tiny number": ('[drive]\nratio = "1/1e-99999999"\n', "drive.ratio", "not a pos"),
    "ratio negative": ("[drive]\nratio = -0.5\n", "drive.ratio", "-0.5 is not a positive ratio"),
    "ratio nan": ("[drive]\nratio = nan\n", "drive.ratio", "nan is not a positive ratio"),
    "ratio beyond numbers": ('[drive]\nratio = "1e99999999999"\n', "drive.ratio", "not a positive"),
    "ratio truth": ("[drive]\nratio = true\n", "drive.ratio", "but it is True"),
    "scale text": (
        MINIMAL + '[log]\ndriving_scale = "x"\n',
        "log.driving_scale",
        "'x' is not a positive ratio",
    ),
    "time twice": (
        MINIMAL + '[log]\ntime = "t"\nsample_rate_hz = 1000.0\n',
        "log.sample_rate_hz",
        "`time` and `sample_rate_hz` are both given",
    ),
    "second shaft twice": (
        MINIMAL + '[log]\ndriven = "a"\ntransmission_error = "b"\n',
        "log.transmission_error",
        "`driven` and `transmission_error` are both given",
    ),
    "unknown choice": (
        MINIMAL + '[log]\ndecimal = ";"\n',
        "log.decimal",
        "expected ',' or '.', but it is ';'.",
    ),
    "unknown unit": (MINIMAL + '[unit]\ndriven = "grad"\n', "unit.driven", "'arcsec' or 'counts'"),
    "wrong sign": (
        replaced("accuracy_arcsec = 18 }   #", "sign = 2 }   #"),
        "driving.encoder.sign",
        "expected -1 or 1, but it is 2.",
    ),
    "order zero": (
        MINIMAL + "[fit]\ndriving_orders = [1, 0]\n",
        "fit.driving_orders[1]",
        "expected a number > 0.0, but it is 0.",
    ),
    "negative fractional order": (
        MINIMAL + "[fit]\ndriven_orders = [1, -3.087]\n",
        "fit.driven_orders[1]",
        "expected a number > 0.0, but it is -3.087.",
    ),
    "order that is no number": (
        MINIMAL + "[fit]\ndriving_orders = [nan]\n",
        "fit.driving_orders[0]",
        "expected a number > 0.0, but it is nan.",
    ),
    "mesh orders": (MINIMAL + "[fit]\nmesh_orders = -1\n", "fit.mesh_orders", "but it is -1."),
    "shift without centre distance": (
        replaced("teeth = 45", "teeth = 45\nprofile_shift = 0.3", MINIMAL),
        "pair.centre_distance_mm",
        "this key is missing; give the centre distance, because profile shifts change it.",
    ),
    "shift beyond the centre distance": (
        replaced("face_width_mm = 20.0\nhelix", "face_width_mm = 20.0\nprofile_shift=0.5\nhelix"),
        "pair.centre_distance_mm",
        "too short: the tips touch the roots at 126.5 mm",
    ),
    "shift out of range": (
        replaced("teeth = 45", "teeth = 45\nprofile_shift = 5.5", MINIMAL),
        "driving.profile_shift",
        "<= 5.0, but it is 5.5.",
    ),
    "crowning without face width": (
        replaced("teeth = 80", "teeth = 80\ncrowning_um = 5.0", MINIMAL),
        "driven.face_width_mm",
        "this key is missing; give the face width, because the flanks have a crowning.",
    ),
    "hollow crowning": (
        replaced("teeth = 45", "teeth = 45\ncrowning_um = -5.0", CONTRACT),
        "driving.crowning_um",
        ">= 0.0, but it is -5.0.",
    ),
    "rack without depth": (
        MINIMAL + "[rack]\naddendum = 0.0\n",
        "rack.addendum",
        "> 0.0, but it is 0.0.",
    ),
    "rack with an unknown key": (
        MINIMAL + "[rack]\ndedendum = 1.25\n",
        "rack.dedendum",
        "did you mean `addendum`?",
    ),
    "rack with clearance below zero": (
        MINIMAL + "[rack]\nclearance = -0.1\n",
        "rack.clearance",
        ">= 0.0, but it is -0.1.",
    ),
    "clearance that the centre distance needs": (
        replaced("125.12", "124.9") + "[rack]\nclearance = 0.02\n",
        "pair.centre_distance_mm",
        "tips touch the roots at 124.96 mm",
    ),
    "drive with a rack": (
        DRIVE + "[rack]\naddendum = 0.9\n",
        "rack",
        "a [drive] has no teeth; remove this table.",
    ),
    "drive with a profile shift": (
        DRIVE + "[driving]\nprofile_shift = 0.1\n",
        "driving.profile_shift",
        "a [drive] has no gear geometry",
    ),
    "drive with a crowning": (
        DRIVE + "[driven]\ncrowning_um = 3.0\n",
        "driven.crowning_um",
        "a [drive] has no gear geometry",
    ),
    "drive with stated measures": (
        DRIVE + "[driven.stated]\ntip_diameter_mm = 94.0\n",
        "driven.stated",
        "a [drive] has no gear geometry",
    ),
    "stated over balls of no size": (
        MINIMAL + "[driven.stated]\nover_balls_mm = 165.0\n",
        "driven.stated.ball_diameter_mm",
        "this key is missing; over_balls_mm needs the diameter of the balls.",
    ),
    "stated span of no teeth": (
        CONTRACT + "[driving.stated]\nspan_mm = 27.8\n",
        "driving.stated.span_teeth",
        "this key is missing; span_mm needs the number of teeth spanned.",
    ),
    "stated thickness below zero": (
        MINIMAL + "[driven.stated]\ntooth_thickness_thin_mm = -1.0\n",
        "driven.stated.tooth_thickness_thin_mm",
        "> 0.0, but it is -1.0.",
    ),
    "stated by another name": (
        MINIMAL + "[driven.stated]\ntip_diameter = 164.0\n",
        "driven.stated.tip_diameter",
        "did you mean `tip_diameter_mm`?",
    ),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_is_one_sentence_that_names_file_and_key(name, write):
    text, key, words = BAD_TABLES[name]
    path = write(text)
    with pytest.raises(PairError) as caught:
        load_pair(path)
    assert caught.value.where == f"{path}: {key}"
    assert words in caught.value.message
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("text", [CONTRACT, OTHER_KEYS, MINIMAL, DRIVE])
def test_the_texts_the_bad_ones_are_made_of_are_good(text, write):
    assert 0 < load_pair(write(text)).ratio < 1


def test_a_table_without_file_names_the_key_alone():
    with pytest.raises(PairError) as caught:
        parse_pair_spec({"pair": {"module_mm": 2.0, "pressure_angle_deg": 20.0}})
    assert str(caught.value).startswith("driving.teeth: this key is missing")


def test_invalid_toml_names_the_line(write):
    path = write('[pair]\nmodule_mm = \nname = "x"\n')
    with pytest.raises(PairError, match=r"not valid TOML: .*line 2"):
        load_pair(path)


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(PairError, match="this is a folder"):
        load_pair(tmp_path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(PairError, match=r"no_such\.toml: no such file; name the TOML"):
        load_pair(tmp_path / "no_such.toml")


@pytest.mark.parametrize(
    ("failure", "sentence"),
    [
        (PermissionError(13, "Permission denied"), "no permission to read this file"),
        (OSError(5, "Input/output error"), "cannot be read: Input/output error"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(failure, sentence, write, monkeypatch):
    """The failure is made, because a superuser may read everything."""
    path = write(MINIMAL)

    def refuse(_):
        raise failure

    monkeypatch.setattr("vttig_jax.base.files.toml_io.read_regular", refuse)
    with pytest.raises(PairError, match=sentence):
        load_pair(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "pair.toml"
    path.write_bytes(b'name = "\xff\xfe"\n')
    with pytest.raises(PairError, match=r"not a text file \(byte 8 is not UTF-8\)"):
        load_pair(path)
