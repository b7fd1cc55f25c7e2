"""Files of others with the names of results stay, whichever command would write over them."""

import shutil
from pathlib import Path

import pytest

LOG, PAIR = "log.csv", "pair.toml"
COMMANDS = {
    "fit": ("fit", LOG, "--pair", PAIR),
    "sample": ("sample", LOG, "--pair", PAIR),
    "sample resumed": ("sample", LOG, "--pair", PAIR, "--resume"),
    "demo": ("demo",),
    "calibrate": ("calibrate", "--rigs", "20"),
    "contact": ("contact", PAIR, "--span-rev", "0.05"),
    "sweep": ("sweep", "sweep.toml"),
    "sweep resumed": ("sweep", "sweep.toml", "--resume"),
    "fit-many": ("fit-many", LOG, "--pair", PAIR),
    "fit-many resumed": ("fit-many", LOG, "--pair", PAIR, "--resume"),
}
SWEEP = """
pair = "pair.toml"
[eccentricities]
driving_mm = 0.02
driving_phase_deg = 10
driven_mm = 0.03
driven_phase_deg = 20
constant_backlash_deg = 0.04
[sweep]
"motion.reversal_deg" = [90, 180]
"""


@pytest.fixture
def foreign(tmp_path) -> Path:
    folder = tmp_path / "thesis"
    (folder / "figures").mkdir(parents=True)
    (folder / "thesis.tex").write_text("text")
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_writes_over_files_of_others(name, vttig, rig_folder, foreign):
    (rig_folder / "sweep.toml").write_text(SWEEP)
    files = {LOG, PAIR, "sweep.toml"}
    words = [rig_folder / word if word in files else word for word in COMMANDS[name]]
    code, out, err = vttig(*words, "--out", foreign)
    assert (code, out) == (2, "")
    assert "this folder holds figures, which the command writes, and no result of vttig" in err
    assert sorted(path.name for path in foreign.rglob("*")) == ["figures", "thesis.tex"]
    assert (foreign / "thesis.tex").read_text() == "text"


def test_other_files_stay_beside_the_result(vttig, rig_folder, foreign):
    """A result may stand beside the log, and --overwrite is the consent to the rest."""
    log, pair = rig_folder / LOG, rig_folder / PAIR
    words = ("fit", log, "--pair", pair, "--no-figures", "--out")
    assert vttig(*words, foreign, "--overwrite")[0] == 0
    assert (foreign / "fit.json").exists() and (foreign / "thesis.tex").read_text() == "text"
    code, _, err = vttig(*words, foreign)
    assert code == 2 and "already exists" in err
    copy = shutil.copytree(rig_folder, foreign / "rig")
    assert vttig("fit", copy / LOG, *words[2:], copy)[0] == 0
    assert (copy / LOG).read_bytes() == log.read_bytes() and (copy / "fit.json").exists()


def test_the_demo_writes_over_no_log(vttig, tmp_path):
    (tmp_path / "log.csv").write_text("mine")
    code, _, err = vttig("demo", "--out", tmp_path)
    assert code == 2 and "this folder holds log.csv" in err
    assert (tmp_path / "log.csv").read_text() == "mine"
