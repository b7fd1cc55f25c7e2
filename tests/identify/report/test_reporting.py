"""From parameters to one word, and to the variable backlash they mean."""

import pytest

import vttig_jax
from vttig_jax.base.units import DEG
from vttig_jax.identify.report.parameters import (
    Parameter,
    outcome_of,
    undetermined,
    variable_backlash_deg,
)
from vttig_jax.identify.settings import FitSettings


def _known(name: str, value: float | None, unit: str = "mm") -> Parameter:
    return Parameter(name, unit, value, determined=True, significant=value is not None)


def _parameters(driving_phase: float | None = 49.5) -> dict[str, Parameter]:
    return {
        p.name: p
        for p in (
            _known("driving_eccentricity_mm", 0.0226),
            _known("driving_phase_deg", driving_phase, "deg"),
            _known("driven_eccentricity_mm", 0.0273),
            _known("driven_phase_deg", 79.3, "deg"),
        )
    }


@pytest.mark.parametrize("angle_deg", [0.0, 100.0, 7560.0])
def test_variable_backlash_is_the_closed_form(paper_pair, angle_deg):
    bare = vttig_jax.Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.0)
    expected = float(vttig_jax.backlash(angle_deg * DEG, paper_pair, bare)) / DEG
    driven_deg = float(paper_pair.ratio) * angle_deg
    found = variable_backlash_deg(paper_pair, _parameters(), angle_deg, driven_deg)
    assert found == pytest.approx(expected, abs=1e-12)


def test_an_amplitude_without_a_phase_adds_nothing(paper_pair):
    alone = vttig_jax.Eccentricities(0.0, 0.0, 0.0273, 79.3, 0.0)
    expected = float(vttig_jax.backlash(0.3, paper_pair, alone)) / DEG
    driven_deg = float(paper_pair.ratio) * 0.3 / DEG
    found = variable_backlash_deg(
        paper_pair, _parameters(driving_phase=None), 0.3 / DEG, driven_deg
    )
    assert found == pytest.approx(expected, abs=1e-12)


def test_a_driven_gear_mounted_elsewhere_has_its_phase_there(paper_pair):
    angles_deg = (100.0, float(paper_pair.ratio) * 100.0)
    bare = vttig_jax.Eccentricities(0.0226, 49.5, 0.0273, 79.3 + 120.0, 0.0)
    expected = float(vttig_jax.backlash(100.0 * DEG, paper_pair, bare)) / DEG
    found = variable_backlash_deg(paper_pair, _parameters(), angles_deg[0], angles_deg[1] + 120.0)
    assert found == pytest.approx(expected, abs=1e-12)
    assert abs(variable_backlash_deg(paper_pair, _parameters(), *angles_deg) - found) > 0.005


def test_outcome_in_one_word():
    known = _known("driving_eccentricity_mm", 0.02)
    gap, delay = (undetermined(name, "deg", "") for name in ("constant_backlash_deg", "delay_s"))
    encoder = undetermined("driving_encoder_arcsec", "arcsec", "")

    def outcome(
        *parameters: Parameter, converged: bool = True, perfect_encoders: bool = False
    ) -> str:
        choices = FitSettings(perfect_encoders=perfect_encoders)
        return outcome_of({p.name: p for p in parameters}, converged, choices)

    assert outcome(known, delay) == "ok"
    assert outcome(known, gap, delay) == "partly_determined"
    assert outcome(gap, delay) == "not_determined"
    assert outcome(known, delay, converged=False) == "not_converged"
    # What was not asked for does not count.
    assert outcome(known, encoder) == "partly_determined"
    assert outcome(known, encoder, perfect_encoders=True) == "ok"
