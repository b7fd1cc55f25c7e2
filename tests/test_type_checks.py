"""A canary: annotations of the package and ranks of arrays are checked while the tests run."""

import jax.numpy as jnp
import pytest
from jaxtyping import TypeCheckError

from vttig_jax.control.hardware.encoder import MotionEstimate
from vttig_jax.kinematics.harmonic import OrderModel
from vttig_jax.pair.gear_pair import involute


def test_a_wrong_kind_of_argument_is_caught():
    with pytest.raises(TypeCheckError):
        involute("twenty degrees")  # pyright: ignore[reportArgumentType]


def test_shapes_that_disagree_are_caught():
    two, three = jnp.zeros((2, 2)), jnp.zeros((2, 3))
    with pytest.raises(TypeCheckError):
        OrderModel(jnp.asarray(0.5), ((1, 0), (0, 1)), jnp.zeros(2), two, three)


def test_a_state_of_the_wrong_shape_is_caught():
    with pytest.raises(TypeCheckError):
        MotionEstimate(jnp.zeros(()), jnp.zeros(2), jnp.zeros(()))


def test_arrays_of_different_rank_are_refused():
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.add(jnp.zeros((2, 2)), jnp.zeros(2))
