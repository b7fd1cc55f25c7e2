"""The travel that is left out after reversals, beside the gap that the fit finds."""

import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.motion import flank_assignment

PAIR = drive("1/10")


@pytest.mark.parametrize("seen", [True, False])
def test_a_gap_wider_than_what_is_left_out_is_the_first_warning(seen, monkeypatch):
    """0.5° of the driven shaft are 5° of the driving shaft; unseen, only 1° is left out."""
    log = drive_log(PAIR, there_and_back([60, 120], 12), gap=level(1800.0))
    if not seen:
        monkeypatch.setattr(flank_assignment, "seen_gap", lambda *_, **__: 0.0)
        monkeypatch.setattr(flank_assignment, "crossed_gap", lambda *_: 0.0)
    result = fit(log, PAIR, delay="off")
    said = [note for note in result.warnings if "to cross the fitted gap" in note]
    if seen:
        assert not said
    else:
        assert said == [result.warnings[0]] and "5° of the driving shaft" in said[0]
