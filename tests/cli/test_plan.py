import re

import pytest

from tests.cli.commands import write_paper_pair
from tests.cli.drive import write_pair

NAME = "driven_amplitude_arcsec"
GAP = "constant_backlash_deg"
RUN = {"--turns": 20, "--rate-hz": 200, "--noise-std-deg": 0.003}


@pytest.fixture
def pair(tmp_path):
    """The pair file of a drive 1 : 2."""
    return write_pair(tmp_path / "pair.toml")


@pytest.fixture
def planned(found, pair):
    """Function that plans with options that replace or follow those of a plain run."""

    def run(*more):
        plain = [part for item in RUN.items() if item[0] not in more for part in item]
        return found("plan", "--pair", pair, *plain, *more)

    return run


@pytest.mark.portable
def test_prints_a_table_and_writes_nothing(vttig, pair, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig("plan", "--pair", pair, *(part for item in RUN.items() for part in item))
    assert (code, err) == (0, "") and list(tmp_path.iterdir()) == [pair]
    assert re.search(r"driven_amplitude_arcsec +0\.\d+ +60 +arcsec", out)
    assert "20 turns a pass, 2 passes to and fro at 60 rpm" in out


def test_every_option_of_the_run_changes_the_plan(planned):
    plain = planned()["parameters"][NAME]["std"]
    for more in (
        ("--turns", 30),
        ("--rate-hz", 300),
        ("--noise-std-deg", 0.004),
        ("--noise-correlation-s", 0.01),
        ("--white-std-deg", 0.002),
        ("--speed-rpm", 50),
        ("--speed-rpm", 60, "--speed-rpm", 30),
        ("--directions", "forward"),
        ("--directions", "backward"),
        ("--passes", 4),
        ("--ramp-s", 0.7),
    ):
        assert planned(*more)["parameters"][NAME]["std"] != plain


def test_options_that_change_something_else(planned, pair):
    record = planned()
    plain = record["parameters"]
    assert planned("--dwell-s", 3)["duration_s"] == pytest.approx(record["duration_s"] + 2)
    assumed = planned("--assume", f"{NAME}=20")["parameters"]
    assert assumed[NAME]["assumed"] == 20.0
    ratio = assumed["driven_phase_deg"]["std"] / plain["driven_phase_deg"]["std"]
    assert ratio == pytest.approx(3.0, rel=1e-3)
    for known in ("off", "0.001"):
        assert plain[GAP]["std"] > 2 * planned("--delay", known)["parameters"][GAP]["std"]
    small = planned("--assume", "delay_s=0")["parameters"]["delay_s"]
    assert small["assumed"] == 0.0 and not small["significant"]
    assert plain["delay_s"]["assumed"] is None
    assert not planned("--delay", "off")["parameters"]["delay_s"]["determined"]
    assert planned("--delay", "0.001")["conditional_on"] == ["given_delay"]
    pair.write_text(pair.read_text().replace("[log]", "[log]\nsample_rate_hz = 300"))
    assert planned("--rate-hz", 200)["run"]["rate_hz"] == 200


def test_perfect_encoders_pay_less(found, tmp_path):
    common = ("plan", "--pair", write_paper_pair(tmp_path / "gears.toml"), "--turns", 8)
    noise = ("--rate-hz", 993, "--noise-std-deg", 0.002, "--noise-correlation-s", 0.005)
    plain, perfect = (found(*common, *noise, *more) for more in ((), ("--perfect-encoders",)))
    assert "perfect_encoders" in perfect["conditional_on"]
    stds = [r["parameters"]["driven_eccentricity_mm"]["std"] for r in (plain, perfect)]
    assert stds[0] > 2.5 * stds[1]
    assert plain["noise"]["counting_std_deg"] == pytest.approx(0.001325, rel=1e-3)


def test_the_shortest_run_for_a_wish(refused, found, pair, planned):
    """The rate of the pair file is the default."""
    pair.write_text(pair.read_text().replace("[log]", "[log]\nsample_rate_hz = 200"))
    wish = ("plan", "--pair", pair, "--noise-std-deg", 0.003, "--want", f"{NAME}=0.2")
    record = found(*wish)
    turns = record["run"]["turns"]
    assert record["run"]["rate_hz"] == 200.0
    assert record["parameters"][NAME]["wanted"] == 0.2
    assert record["parameters"][NAME]["std"] <= 0.2
    assert planned("--turns", turns - 1)["parameters"][NAME]["std"] > 0.2
    words = f"{turns - 1:g} turns a pass, as asked, are too few"
    refused(4, words, *wish, "--turns", turns - 1)


RUN_OF_1 = "--turns 20 --rate-hz 200 --noise-std-deg 1"
NO_TURNS = "--rate-hz 200 --noise-std-deg 1"


def test_bad_input_is_one_sentence(refused, pair, tmp_path):
    for options, code, words in (
        ("--turns 20 --rate-hz 200", 2, "--noise-std-deg"),
        ("--turns 20 --noise-std-deg 0.003", 2, "--rate-hz is missing"),
        (NO_TURNS, 2, "--turns is missing"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 0", 2, "--noise-std-deg must not be zero"),
        ("--turns 20 --rate-hz 200 --noise-std-deg nan", 2, "not a finite number"),
        (f"--turns -1 {NO_TURNS}", 2, "--turns"),
        (f"--turns 0.3 {NO_TURNS}", 2, "--turns must be at least 0.5"),
        (f"{RUN_OF_1} --passes 1", 2, "--passes must be"),
        ("--turns 20 --rate-hz 1e9 --noise-std-deg 1", 2, "lower rate"),
        (f"{RUN_OF_1} --want foo=1", 2, "--want must hold names"),
        (f"{RUN_OF_1} --want delay_s", 2, "form name=number"),
        (f"{RUN_OF_1} --want delay_s=x", 2, "not a valid float"),
        (f"{RUN_OF_1} --want a=1 --want a=2", 2, "given twice"),
        (f"{RUN_OF_1} --assume foo=1", 2, "--assume must hold"),
        (f"{RUN_OF_1} --assume delay_s=2", 2, "--assume must hold"),
        (f"{RUN_OF_1} --delay 2", 2, "number of seconds"),
        (f"{RUN_OF_1} --want {GAP}=1e-7", 4, "a second speed"),
        (f"{RUN_OF_1} --noise-std-deg 0 --noise-correlation-s 1", 2, "memory of --noise-std-deg"),
        (f"--turns 0.9 {NO_TURNS}", 4, "full revolution"),
        (f"{NO_TURNS} --directions forward --want {GAP}=1", 4, "one flank alone shows no gap"),
    ):
        refused(code, words, "plan", "--pair", pair, *options.split())
    refused(3, "no such file", "plan", "--pair", tmp_path / "nope.toml", *RUN_OF_1.split())
