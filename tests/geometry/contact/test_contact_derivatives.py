"""Derivatives of first touch, first and second, against central differences; ties and kinks."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.compiler import fast_to_compile
from tests.geometry.pairs import FLANKS, pair_of
from tests.laws import checks
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations, FlankMap
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities, Flank, GearPair, Rack

gears = partial(
    pair_of,
    helix=(3.0, 2.0),
    crowning=(12.0, 8.0),
    widths=(20.0, 18.0),
    pressure=(20.0, 22.0),
    distance=125.4,
    rack=Rack(tip_radius=0.38),
)
ANGLES = np.array([0.013, 0.094])
WEIGHTS = np.array([1.0, -0.3])


def flank_map(sign: float) -> FlankMap:
    roll, z = np.linspace(12.0, 24.0, 4), np.linspace(-9.0, 9.0, 3)
    wave = np.sin(0.4 * roll)[:, None] + 0.3 * np.cos(0.2 * z) * roll[:, None] / 20
    return FlankMap(roll, z, sign * 1.5 * wave)


DEVIATIONS = Deviations(
    driving=(flank_map(1.0), flank_map(-1.0)),
    driving_pitch_um=np.linspace(-1.0, 1.0, 90).reshape(2, 45),
)
RIG = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.04, 0.2)
TILT = Misalignment(1e-4, -2e-4)
NO_TILT = Misalignment(0.0, 0.0)


def total(arguments, flank: Flank):
    pair, rig, tilt, deviations = arguments
    model = contact_model(pair, rig, misalignment=tilt, deviations=deviations)
    return jnp.sum(WEIGHTS * model.transmission_error(ANGLES, flank))


def known(tree):
    """Every number as an array, so that all can be moved."""
    return jax.tree.map(jnp.asarray, tree)


SMALL = {"inclination_rad": 1e-7, "deviation_rad": 1e-7, "driving_mm": 1e-5, "driven_mm": 1e-5}


@pytest.mark.slow
@pytest.mark.parametrize("flank", FLANKS)
def test_every_number_of_a_rig_that_has_everything(flank):
    """Crowned, tilted, deviating, eccentric, shifted: first touch is a single point."""
    arguments = known((gears(), RIG, TILT, DEVIATIONS))
    slopes = jax.tree.leaves(eqx.filter_grad(total)(arguments, flank))
    paths, tree = jax.tree_util.tree_flatten_with_path(arguments)
    leaves = [leaf for _, leaf in paths]
    alive = 0
    for place, (path, leaf) in enumerate(paths):
        name = getattr(path[-1], "name", "")
        if "along_" in name or "roll_mm" in name or name == "z_mm":
            continue  # made from the points of a map, which are no free numbers
        step = SMALL.get(name, 1e-4)
        entries = list(np.ndindex(leaf.shape))
        for entry in entries[:: max(len(entries) // 4, 1)]:
            ends = []
            for way in (1, -1):
                there = leaf.at[entry].add(way * step)
                moved = [there if k == place else one for k, one in enumerate(leaves)]
                ends.append(total(jax.tree.unflatten(tree, moved), flank))
            central = float(ends[0] - ends[1]) / (2 * step)
            slope = float(slopes[place][entry])
            # Rounding leaves the section of first touch uncertain by some 1e-5 of its height.
            assert slope == pytest.approx(central, rel=5e-5, abs=1e-10), (name, entry)
            alive += abs(central) > 1e-9
    assert alive >= 18


def model_of(pair: GearPair, rig: Eccentricities = RIG, tilt: Misalignment = NO_TILT):
    """All of one shape, so that they are compiled once."""
    return contact_model(pair, rig, misalignment=tilt, sections=3)


UNTAPERED = {"addendum": 1.0, "width": 18.0, "tilt": 0.0}
EDGES = {"A": np.array([0.0279, 0.0489]), "B": np.array([0.1082, 0.0873])}
"""Where first the driving, then the driven tip of the short teeth carries."""


def error(numbers, angles, flank: Flank):
    """Of flanks that do not taper; all tests take the derivative in all of these numbers."""
    pair = gears(crowning=(0.0, 0.0), helix=(0.0, 0.0))
    places = lambda pair: (pair.rack.addendum, pair.driven.face_width_mm)  # noqa: E731
    moved = eqx.tree_at(places, pair, (numbers["addendum"], numbers["width"]))
    tilt = Misalignment(0.0, numbers["tilt"])
    return model_of(moved, tilt=tilt).transmission_error(angles, flank)


def as_drawn(pair: GearPair, rig: Eccentricities):
    """The exact relation with the backlash of the drawn teeth, which is that of the contact."""
    drawn = jnp.degrees(pair.drawing_backlash)
    return exact_model(pair, eqx.tree_at(lambda r: r.constant_backlash_deg, rig, drawn))


@pytest.mark.slow
def test_where_everything_ties_the_derivatives_are_those_of_the_exact_relation():
    """All sections and two pairs of teeth touch at once: any of them gives the same."""
    pair, rig = gears(crowning=(0.0, 0.0), helix=(3.0, 3.0)), known(RIG)

    def contact(rig, flank):
        model = contact_model(pair, rig, misalignment=NO_TILT, sections=3)
        return model.transmission_error(ANGLES, flank)

    def exact(rig, flank):
        return as_drawn(pair, rig).transmission_error(ANGLES, flank)

    for flank in FLANKS:
        found = jax.tree.leaves(jax.jacfwd(contact)(rig, flank))
        expected = jax.tree.leaves(jax.jacfwd(exact)(rig, flank))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-13)


def bends_of(function, arguments, direction):
    """Second derivative along a direction, and differences of the first one.

    The first derivative is held against differences of values.
    """

    def along(arguments, direction):
        moved = lambda t: jax.tree.map(lambda x, d: x + t * d, arguments, direction)  # noqa: E731

        def slope(t):
            return jax.jvp(lambda t: function(*moved(t)), (t,), (1.0,))[1]

        return function(*arguments), *jax.jvp(slope, (0.0,), (1.0,))

    along = jax.jit(along, **fast_to_compile())
    _, slope, bend = along(arguments, direction)

    def differences(step):
        above, below = (
            along(jax.tree.map(lambda x, d, h=h: x + h * d, arguments, direction), direction)
            for h in (step, -step)
        )
        return [(one - other) / (2 * step) for one, other in zip(above, below, strict=True)]

    fine, coarse = differences(0.05), differences(0.1)
    of_value, of_slope = ((4 * fine[k] - coarse[k]) / 3 for k in (0, 1))
    np.testing.assert_allclose(slope, of_value, rtol=1e-5)
    return bend, of_slope


@pytest.mark.slow
@pytest.mark.parametrize("flank", ["A", "B"])
def test_second_derivatives_of_perfect_gears_are_those_of_the_exact_relation(flank):
    """In all eccentricities and in the driving angle, for a batch of angles."""
    pair = gears(crowning=(0.0, 0.0), helix=(3.0, 3.0))

    def second(build):
        def error(numbers):
            model = build(pair, Eccentricities(*numbers[:-1]))
            return model.transmission_error(numbers[-1], flank)

        numbers = jnp.stack([jnp.array([0.0226, 49.5, 0.0273, 79.3, 0.04, 0.2, x]) for x in ANGLES])
        return jax.jit(jax.vmap(jax.hessian(error)), **fast_to_compile())(numbers)

    found, expected = second(contact_model), second(as_drawn)
    size = np.abs(np.diagonal(expected, axis1=1, axis2=2)).max(axis=0) + 1e-9
    size = np.sqrt(np.outer(size, size))[None]
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-8)
    # At a constant point of the flanks ∂²TE/∂φ² would be a thousand times larger.
    assert 1e-4 < np.abs(found[:, -1, -1]).max() < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("flank", FLANKS)
def test_derivatives_of_edges_and_ends_are_those_of_differences(flank):
    """On both tip edges, on the flanks, and at an end of the face, which moves with the width."""
    numbers = {name: jnp.asarray(value) for name, value in UNTAPERED.items()}
    numbers |= {"addendum": jnp.asarray(0.5), "tilt": jnp.asarray(2e-4)}
    angles = jnp.concatenate([EDGES[flank], ANGLES])
    direction = {"addendum": 1e-5, "width": 1e-3, "tilt": 1e-6}, jnp.full(4, 1e-4)

    def touch(numbers, angles):
        return error(numbers, angles, flank)

    found, expected = bends_of(touch, (numbers, angles), direction)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.abs(found[:2]).min() > 10 * np.abs(found[2:]).min()


@pytest.mark.slow
def test_at_a_kink_the_derivative_is_that_of_one_side_and_the_second_one_is_finite():
    """A tilt of nought: the flank touches all along the face, otherwise at either end."""

    def touch(tilt):
        return error({**UNTAPERED, "tilt": tilt}, ANGLES, "A")

    slope = jax.jit(jax.jacfwd(touch), **fast_to_compile())
    left, kink, right = (slope(tilt)[0] for tilt in (-1e-6, 0.0, 1e-6))
    assert left < -0.1 < 0.1 < right and left <= kink <= right
    bend = jax.jit(jax.jacfwd(jax.jacfwd(touch)), **fast_to_compile())(0.0)
    assert np.all(np.isfinite(bend)) and np.abs(bend).max() < 1.0


@pytest.mark.slow
def test_second_derivatives_of_a_point_that_moves_along_the_face():
    """Crowned, tilted and with deviations: the section of first touch follows the tilt."""

    def touch(tilt, crowning, angles):
        pair = eqx.tree_at(lambda pair: pair.driven.crowning_um, known(gears()), crowning)
        model = contact_model(
            pair, RIG, misalignment=Misalignment(1e-4, tilt), deviations=DEVIATIONS, sections=3
        )
        return model.transmission_error(angles, "A")

    at = jnp.asarray(-2e-4), jnp.asarray(8.0), jnp.asarray(ANGLES)
    found, expected = bends_of(touch, at, (1e-5, 1e-2, jnp.full(2, 1e-3)))
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    # In a constant section and at a constant point the tilt alone would bend it by 2e-12 only.
    by_tilt, differences = bends_of(touch, at, (1e-5, 0.0, jnp.zeros(2)))
    np.testing.assert_allclose(by_tilt, differences, rtol=5e-3)
    assert np.abs(by_tilt).min() > 1e-9


@pytest.mark.slow
def test_new_values_compile_nothing():
    def touch(scale):
        rig = jax.tree.map(lambda leaf: leaf * scale, RIG)
        pair = gears(crowning=(12.0 * scale, 8.0), helix=(3.0 * scale, 2.0))
        model = model_of(pair, rig, Misalignment(1e-4 * scale, -2e-4))
        return model.transmission_error(ANGLES * scale, "A"), model.backlash(ANGLES)

    touch(1.0)
    with checks.compilations() as seen:
        touch(1.01)
    assert not seen


@pytest.mark.slow
def test_many_angles_are_a_few():
    """Longer rows are searched in pieces; an angle does not know of its company."""
    model = contact_model(gears(crowning=(0.0, 0.0), helix=(3.0, 3.0)), RIG)
    assert len(model.search_grid.batches(np.zeros(9001))) > 1
    angles = np.linspace(-50.0, 50.0, 9001)
    some = [0, 4543, 4544, 9000]
    found = np.asarray(model.transmission_error(angles, "A"))[some]
    np.testing.assert_allclose(
        found, model.transmission_error(angles[some], "A"), rtol=0, atol=1e-15
    )
    assert np.ptp(found) > 1e-5


def test_a_few_lengths_serve_all():
    """So that another number of angles compiles nothing."""
    model = contact_model(gears(crowning=(0.0, 0.0), helix=(3.0, 3.0)), RIG)
    lengths = {model.search_grid.batches(np.zeros(n)).size for n in (1, 64, 65, 129, 1000, 4000)}
    assert lengths == {64, 128, 256, 1024, 4096}
    for count in (4700, 5000, 9700, 20_000, 123_457):
        row = np.ravel(model.search_grid.batches(np.arange(count, dtype=float)))
        assert count <= len(row) < 1.1 * count
        np.testing.assert_array_equal(row[count - 1 :], count - 1)
    assert model.transmission_error(np.zeros((0, 2)), "A").shape == (0, 2)
