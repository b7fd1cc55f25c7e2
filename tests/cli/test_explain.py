"""`vttig explain` defines every parameter of a fit, and refuses a word that no report has."""

import json

import pytest

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
