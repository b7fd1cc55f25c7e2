"""The words of reports: `vttig explain`, and the legend under `-v`."""

import json
import re

import pytest

from tests.schemas import load_schema
from vttig_jax.report.words import WORDS, explained, meanings


@pytest.mark.portable
def test_all_words_one_word_and_none(told, found, refused):
    assert len(found("explain")["words"]) > 30
    out = told("explain", "delay_s")
    assert out.count("\n") == 1 and out.startswith("delay_s: ")
    refused(2, "fluxcapacitor", "explain", "fluxcapacitor")


def test_every_parameter_of_a_fit_has_one_meaning(run_folder):
    fitted = json.loads((run_folder / "fit.json").read_text())
    names = [*fitted["parameters"], "driving_amplitude_arcsec", "gap_over_angles_covered", "ratio"]
    assert len(names) > 10
    assert [name for name in names if name not in " ".join(meanings(name))] == []


def test_the_fields_of_error_tables_have_a_meaning():
    common = {"schema", "source", "pair", "sha256", "quantity", "meaning", "sentence", "logs"}
    common |= {"ini", "value", "change", "conditional_on", "zero_readings"}
    for name in ("vttig.correction/1", "vttig.verify/1"):
        schema = load_schema(name)
        items = schema["properties"].get("logs", {}).get("items", {}).get("properties", {})
        own = {*schema["properties"], *items} - common
        assert len(own) > 4 and [word for word in own if not meanings(word)] == []
    assert meanings("over-compensation") == meanings("over_compensation_deg") != {}


def test_words_that_occur_and_no_others():
    legend = explained("noise  blocks of 5 ms (AR(2))\nhunting period  16 driving turns")
    assert legend.splitlines()[0] == "words:" and len(legend.splitlines()) == 4
    assert "autoregression" in legend and "same teeth meet" in legend
    assert explained("area, hunter, profiled, stdout") == ""
    for pattern, (word, meaning) in WORDS.items():
        assert word and len(f"  {word}: {meaning}") <= 140 and not meaning.endswith(".")
        shown = f"{word.replace('(n)', '(2)')} at 1 τ: {word} 2"
        assert re.search(pattern, shown) or word == "order"


def test_a_fit_explains_its_words_and_its_noise_under_v(told, found, rig_folder):
    """A plan with this noise expects the errors of the fit."""
    pair = ("--pair", rig_folder / "pair.toml")
    command = ("fit", rig_folder / "log.csv", *pair)
    plain, out = told(*command), told(*command, "-v")
    assert out.startswith(plain.rstrip("\n")) and "\n\nwords:\n" in out
    legend = out.partition("\nwords:\n")[2]
    for word in ("flank A, flank B", "std", "order", "constant_backlash_deg", "slow share"):
        assert f"  {word}: " in legend
    assert "R-hat" not in legend and "words:" not in plain
    (line,) = [line for line in out.splitlines() if line.startswith("to plan")]
    noise = " ".join(re.findall(r"--[a-z-]+ [\d.e+-]*\d", line)).split()
    planned = found("plan", *pair, "--turns", "8", "--speed-rpm", "120", *noise)
    fitted = found(*command, "-v")  # an object and no legend
    one, other = (r["parameters"]["driving_eccentricity_mm"] for r in (planned, fitted))
    assert 0.75 < one["std"] / other["std"] < 1.33
