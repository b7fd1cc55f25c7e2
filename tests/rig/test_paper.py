"""The paper's rig: its tables, its imperfections, its seeds."""

import numpy as np
import pytest

from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_eccentricities, paper_pair, paper_rig


def test_the_tables_of_the_paper():
    pair, rig = paper_pair(), paper_eccentricities()
    assert (pair.driving.teeth, pair.driven.teeth) == (45, 80)
    assert pair.driving.encoder.counts_per_rev == pair.driven.encoder.counts_per_rev == 90_000
    assert float(pair.centre_distance_mm) == 125.12
    assert (float(rig.driving_mm), float(rig.driven_mm)) == (0.0226, 0.0273)
    assert (float(rig.driving_phase_deg), float(rig.driven_phase_deg)) == (49.5, 79.3)


@pytest.mark.parametrize("seed", [0, 1, 17])
def test_imperfections_of_the_issue(seed):
    rig = paper_rig(seed)
    assert (rig.noise.std_deg, rig.noise.correlation_s, rig.rate_hz) == (0.002, 0.00475, 1987.0)
    assert rig.driving_encoder.amplitude_arcsec == rig.driven_encoder.amplitude_arcsec == 18.0
    for flank in ("A", "B"):
        pitch = [e for e in rig.orders if e.flank == flank and e.shaft != "mesh"]
        rms = np.sqrt(sum(e.amplitude_deg**2 for e in pitch) / 2)
        assert rms == pytest.approx(0.002)
    assert [e.amplitude_deg for e in rig.orders if e.shaft == "mesh"] == [0.003, 0.003]
    assert BacklashMap(rig.flank_model(), None, rig.pair).smallest.backlash > 0


def test_the_seed_draws_orders_and_encoder_phases():
    first, again, other = paper_rig(4), paper_rig(4), paper_rig(5)
    assert first.orders == again.orders != other.orders
    assert first.driving_encoder == again.driving_encoder != other.driving_encoder
    assert other.driven_encoder != first.driven_encoder != first.driving_encoder
    motion = PassMotion(reversal_deg=1800.0)
    assert paper_rig(0, motion).motion == motion
    assert paper_rig().motion == PassMotion()
