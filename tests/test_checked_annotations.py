"""The first calls of every test are checked, and the calls after them are those of a user."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, TypeCheckError

from tests.checked_annotations import CALLS, first_calls, next_test
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.kinematics.harmonic import OrderModel
from vttig_jax.pair.gear_pair import involute

WRONG = "not an array"


@first_calls(typechecker=beartype)
def length(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> int:
    return len(x) + len(y)


@first_calls(typechecker=beartype)
@dataclass(frozen=True)
class Pair:
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


def test_a_wrong_kind_or_shape_is_refused_at_the_first_call():
    for wrong in ((WRONG, WRONG), (np.zeros(2), np.zeros(3)), (np.zeros((1, 2)),) * 2):
        for made in (length, Pair):
            with pytest.raises(TypeCheckError):
                made(*wrong)
    # The same in the package, and arrays of different rank.
    with pytest.raises(TypeCheckError):
        involute("twenty degrees")  # pyright: ignore[reportArgumentType]
    two, three = jnp.zeros((2, 2)), jnp.zeros((2, 3))
    with pytest.raises(TypeCheckError):
        OrderModel(jnp.asarray(0.5), ((1, 0), (0, 1)), jnp.zeros(2), two, three)
    with pytest.raises(TypeCheckError):
        MotionPoint(jnp.zeros(()), jnp.zeros(2), jnp.zeros(()))
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.add(two, jnp.zeros(2))


@pytest.mark.parametrize("made", [length, Pair])
def test_beyond_the_first_calls_it_is_the_plain_function(made):
    for _ in range(CALLS - 1):
        made(np.zeros(2), np.zeros(2))
    with pytest.raises(TypeCheckError):
        made(WRONG, WRONG)
    made(WRONG, WRONG)
    next_test()
    with pytest.raises(TypeCheckError):
        made(WRONG, WRONG)


@pytest.mark.parametrize("test", [1, 2])
def test_every_test_checks_functions_of_the_package_again(test):
    """Each of the two uses up the checks, so the second shows that a test starts anew."""
    whole = np.array([1])  # an integer where a float is asked for; only a check minds
    with pytest.raises(TypeCheckError):
        involute(whole)
    for _ in range(CALLS):
        involute(np.full(1, 0.3))
    assert involute(whole) == np.tan(1) - 1
    assert involute.__name__ == "involute" and "tan α" in (involute.__doc__ or "")
