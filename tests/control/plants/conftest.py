"""The paper's rig of first order, to 540° and back at 60 rpm."""

import pytest

from tests.control.parts import trapezoid
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.rig.paper import paper_pair


@pytest.fixture(scope="module")
def bounds(paper_rig):
    return closed_model(paper_pair(), paper_rig)


@pytest.fixture(scope="module")
def rig(bounds):
    return bounds, trapezoid(60.0, 540.0, 0.1, 0.5)
