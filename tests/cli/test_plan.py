import re

import pytest
import tomli_w

from vttig_jax.cli.main import VERBS
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.paper import paper_pair

from .drive import write_pair

NAME = "driven_amplitude_arcsec"


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    """The verb, whether or not `main` knows it."""
    monkeypatch.setitem(VERBS, "plan", ("vttig_jax.cli.verbs.plan:command", "Plan a run."))


@pytest.fixture
def pair(tmp_path):
    """The pair file of a drive 1 : 2."""
    return write_pair(tmp_path / "pair.toml")


@pytest.fixture
def planned(vttig_json, pair):
    """Plan with options that replace or follow those of a plain run."""

    def run(*more):
        options = {"--turns": 20, "--rate-hz": 200, "--noise-std-deg": 0.003}
        own = {str(more[k]) for k in range(len(more))}
        plain = [part for item in options.items() if item[0] not in own for part in item]
        code, record = vttig_json("plan", "--pair", pair, *plain, *more)
        assert code == 0
        return record

    return run


@pytest.mark.portable
def test_prints_a_table_and_writes_nothing(vttig, pair, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = list(tmp_path.iterdir())
    code, out, err = vttig(
        "plan", "--pair", pair, "--turns", 20, "--rate-hz", 200, "--noise-std-deg", 0.003
    )
    assert code == 0
    assert err == ""
    assert re.search(r"driven_amplitude_arcsec +0\.\d+ +60 +arcsec", out)
    assert "20 turns a pass, 2 passes to and fro at 60 rpm" in out
    assert list(tmp_path.iterdir()) == before


def test_every_option_of_the_run_changes_the_plan(planned):
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
        plain, other = planned(), planned(*more)
        assert other["parameters"][NAME]["std"] != plain["parameters"][NAME]["std"]


def test_options_that_change_something_else(planned):
    plain = planned()
    assert planned("--dwell-s", 3)["duration_s"] == pytest.approx(plain["duration_s"] + 2)
    assumed = planned("--assume", f"{NAME}=20")["parameters"]
    assert assumed[NAME]["assumed"] == 20.0
    ratio = assumed["driven_phase_deg"]["std"] / plain["parameters"]["driven_phase_deg"]["std"]
    assert ratio == pytest.approx(3.0, rel=1e-3)
    gap = "constant_backlash_deg"
    for known in ("off", "0.001"):
        assert (
            plain["parameters"][gap]["std"]
            > 2 * planned("--delay", known)["parameters"][gap]["std"]
        )
    small = planned("--assume", "delay_s=0")["parameters"]
    assert small["delay_s"]["assumed"] == 0.0 and not small["delay_s"]["significant"]
    assert plain["parameters"]["delay_s"]["assumed"] is None
    assert not planned("--delay", "off")["parameters"]["delay_s"]["determined"]
    assert planned("--delay", "0.001")["conditional_on"] == ["given_delay"]


def test_perfect_encoders_pay_less(vttig_json, tmp_path):
    path = tmp_path / "gears.toml"
    path.write_text(tomli_w.dumps(spec_table(spec_of(paper_pair()))))
    common = ("plan", "--pair", path, "--turns", 8, "--rate-hz", 993)
    noise = ("--noise-std-deg", 0.002, "--noise-correlation-s", 0.005)
    (_, plain), (_, perfect) = (
        vttig_json(*common, *noise, *more) for more in ((), ("--perfect-encoders",))
    )
    assert "perfect_encoders" in perfect["conditional_on"]
    stds = [r["parameters"]["driven_eccentricity_mm"]["std"] for r in (plain, perfect)]
    assert stds[0] > 2.5 * stds[1]
    assert plain["noise"]["counting_std_deg"] == pytest.approx(0.001325, rel=1e-3)


def test_the_shortest_run_for_a_wish(vttig_json, pair, planned):
    noise = ("--rate-hz", 200, "--noise-std-deg", 0.003)
    code, found = vttig_json("plan", "--pair", pair, *noise, "--want", f"{NAME}=0.2")
    assert code == 0
    turns = found["run"]["turns"]
    assert found["parameters"][NAME]["wanted"] == 0.2
    assert found["parameters"][NAME]["std"] <= 0.2
    assert planned("--turns", turns - 1)["parameters"][NAME]["std"] > 0.2
    code, error = vttig_json(
        "plan", "--pair", pair, *noise, "--want", f"{NAME}=0.2", "--turns", turns - 1
    )
    assert (code, error["exit"]) == (4, 4)
    assert f"{turns - 1:g} turns a pass, as asked, are too few" in error["message"]


def test_the_rate_of_the_pair_file_is_the_default(vttig_json, pair):
    text = pair.read_text().replace("[log]", "[log]\nsample_rate_hz = 300")
    pair.write_text(text)
    _, record = vttig_json("plan", "--pair", pair, "--turns", 20, "--noise-std-deg", 0.003)
    assert record["run"]["rate_hz"] == 300.0


def test_bad_input_is_one_sentence(vttig, pair):
    for options, code, words in (
        ("--turns 20 --rate-hz 200", 2, "--noise-std-deg"),
        ("--turns 20 --noise-std-deg 0.003", 2, "--rate-hz is missing"),
        ("--rate-hz 200 --noise-std-deg 0.003", 2, "--turns is missing"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 0", 2, "--noise-std-deg must not be zero"),
        ("--turns 20 --rate-hz 200 --noise-std-deg nan", 2, "not a finite number"),
        ("--turns -1 --rate-hz 200 --noise-std-deg 1", 2, "--turns"),
        ("--turns 0.3 --rate-hz 200 --noise-std-deg 1", 2, "--turns must be at least 0.5"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --passes 1", 2, "--passes must be"),
        ("--turns 20 --rate-hz 1e9 --noise-std-deg 1", 2, "lower rate"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --want foo=1", 2, "--want must hold names"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --want delay_s", 2, "form name=number"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --want delay_s=x", 2, "not a valid float"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --want a=1 --want a=2", 2, "given twice"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --assume foo=1", 2, "--assume must hold"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --assume delay_s=2", 2, "--assume must hold"),
        ("--turns 20 --rate-hz 200 --noise-std-deg 1 --delay 2", 2, "number of seconds"),
        (
            "--turns 20 --rate-hz 200 --noise-std-deg 0.003 --want constant_backlash_deg=1e-7",
            4,
            "a second speed",
        ),
        (
            "--turns 20 --rate-hz 200 --noise-std-deg 0 --noise-correlation-s 1",
            2,
            "memory of --noise-std-deg",
        ),
        ("--turns 0.9 --rate-hz 200 --noise-std-deg 1", 4, "full revolution"),
        (
            "--rate-hz 200 --noise-std-deg 1 --directions forward --want constant_backlash_deg=1",
            4,
            "one flank alone shows no gap",
        ),
    ):
        found, out, err = vttig("plan", "--pair", pair, *options.split())
        assert found == code
        assert words in err
        assert out == ""
        assert len(err.strip().splitlines()) == 1


def test_a_missing_pair_file_is_invalid_input(vttig, tmp_path):
    options = ("--turns", 20, "--rate-hz", 200, "--noise-std-deg", 1)
    code, _, err = vttig("plan", "--pair", tmp_path / "nope.toml", *options)
    assert code == 3
    assert "no such file" in err
