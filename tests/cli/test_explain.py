"""`vttig explain` defines every parameter of a fit, and refuses a word that no report has."""

import json

import pytest

from tests.schemas import load_schema
from vttig_jax.report.words import meanings


@pytest.mark.portable
def test_all_words_one_word_and_none(vttig, vttig_json):
    code, record = vttig_json("explain")
    assert code == 0 and len(record["words"]) > 30
    code, out, _ = vttig("explain", "delay_s")
    assert code == 0 and out.count("\n") == 1 and out.startswith("delay_s: ")
    code, _, err = vttig("explain", "fluxcapacitor")
    assert code == 2 and "fluxcapacitor" in err


def test_every_parameter_of_a_fit_has_one_meaning(run_folder):
    fitted = json.loads((run_folder / "fit.json").read_text())
    names = [*fitted["parameters"], "driving_amplitude_arcsec", "gap_over_angles_covered", "ratio"]
    assert len(names) > 10
    assert [name for name in names if name not in " ".join(meanings(name))] == []


def test_the_fields_of_error_tables_have_a_meaning():
    common = {
        "schema",
        "source",
        "pair",
        "sha256",
        "quantity",
        "meaning",
        "sentence",
        "logs",
        "ini",
    }
    common |= {"value", "change", "conditional_on", "zero_readings"}
    for name in ("vttig.correction/1", "vttig.verify/1"):
        schema = load_schema(name)
        items = schema["properties"].get("logs", {}).get("items", {}).get("properties", {})
        own = {*schema["properties"], *items} - common
        assert len(own) > 4 and [word for word in own if not meanings(word)] == []
    assert meanings("over-compensation") == meanings("over_compensation_deg") != {}
