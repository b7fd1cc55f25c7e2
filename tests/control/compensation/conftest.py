"""The map of the synthetic rig, and its harmonics."""

import pytest

from tests.control.compensation.test_compensation import ALLOWED
from vttig_jax.control.compensation.compensation import Compensation, compensation_of
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.rig.paper import paper_pair, paper_rig


@pytest.fixture(scope="module")
def grid() -> BacklashMap:
    """Eccentric gears with eight orders of both shafts and the tooth mesh on top."""
    return BacklashMap(paper_rig(1).flank_model(), None, paper_pair())


@pytest.fixture(scope="module")
def compensation(grid) -> Compensation:
    return compensation_of(grid, allowed_rad=ALLOWED)
