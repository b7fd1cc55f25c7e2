"""One row for every public function and model method, with what it promises."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tests.laws.contacts import CONTACTS, THICKNESSES
from tests.laws.law import POWER as POWER
from tests.laws.law import Law
from tests.laws.law import scaled as scaled
from tests.laws.surfaces import SURFACES
from vttig_jax.kinematics import functions as kin
from vttig_jax.kinematics.exact import ExactModel, exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.flank_table import FirstOrderBounds, tabulate_flanks
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.gear_pair import Eccentricities, Gear, GearPair, Rack

ANGLES = np.array([0.3, -2.0, 41.7])
PAIR = GearPair(
    Gear(45, 3.0, 2.0, 20.0),
    Gear(80, 3.0, 2.0, 20.0),
    module_mm=2.0,
    pressure_angles_deg=(20.0, 22.0),
    centre_distance_mm=125.12,
    rack=Rack(tip_radius=0.38),
)
RIG = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038, 0.2)
CENTRED = Eccentricities(constant_backlash_deg=0.038)
SPUR = GearPair(
    Gear(45, face_width_mm=20.0),
    Gear(80, face_width_mm=20.0),
    module_mm=2.0,
    pressure_angles_deg=20.0,
    rack=PAIR.rack,
)
"""Alike in structure, so that one program serves both."""

KINKS = {
    "e = 0": (ANGLES, PAIR, CENTRED),
    "phi = 0": (np.zeros(3), PAIR, RIG),
    "everything zero": (np.zeros(3), SPUR, Eccentricities()),
    "spur, nominal distance": (ANGLES, SPUR, RIG),
}
ORDERS = OrderModel(
    ratio=jnp.asarray(0.5625, float),
    terms=((1, 0), (0, 1), (0, 2), (45, 0), (1, 1)),
    offset=jnp.array([1e-4, 7e-4]),
    cosine=jnp.array([[4e-5, -3e-5, 2e-5, 1e-5, 1e-6], [1e-5, 3e-5, -2e-5, 2e-5, 2e-6]]),
    sine=jnp.array([[-1e-5, 5e-5, 3e-5, -1e-5, 3e-6], [2e-5, -3e-5, 1e-5, 3e-5, -4e-6]]),
)


def _orders(_: GearPair, rig: Eccentricities) -> OrderModel:
    return jax.tree.map(jnp.zeros_like, ORDERS) if rig is CENTRED else ORDERS


def _combined(pair: GearPair, rig: Eccentricities) -> CombinedModel:
    orders = _orders(pair, rig)
    return CombinedModel(ratio=ORDERS.ratio, exact=exact_model(pair, rig), orders=orders)


def _of_rig(name: str, variant: str = "", **options: Any) -> Law:
    function = partial(getattr(kin, name), **options)
    return Law(
        name,
        function,
        (ANGLES, PAIR, RIG),
        "rad",
        KINKS,
        variant,
        slow=variant in ("B", "reference"),
    )


@eqx.filter_jit
def _error(angle, model):
    return model.transmission_error(angle, "A")


@eqx.filter_jit
def _gap(angle, model):
    return model.backlash(angle)


@eqx.filter_jit
def _both(angle, model):
    angle = jnp.asarray(angle, float)
    return model.at_both_angles(angle, 0.5 * angle, "B")


@eqx.filter_jit
def _turned(angle, model):
    angle = jnp.asarray(angle, float)
    return model.turned(angle, 0.5 * angle, model.base_sum[0], 1.0)


METHODS = {
    "transmission_error": _error,
    "backlash": _gap,
    "at_both_angles": _both,
    "turned": _turned,
}


def _of_model(kind: type, make: Callable[[GearPair, Eccentricities], Any], *methods: str):
    kinks = {label: (angle, make(pair, rig)) for label, (angle, pair, rig) in KINKS.items()}
    for method in methods:
        arguments = (ANGLES, make(PAIR, RIG))
        yield Law(f"{kind.__name__}.{method}", METHODS[method], arguments, "rad", kinks)


FUNCTIONS = (
    _of_rig("transmission_error", "A"),
    _of_rig("transmission_error", "B", flank="B", reference="start", pressure_angle="reference"),
    _of_rig("exact_transmission_error", "A"),
    _of_rig("exact_transmission_error", "B", flank="B", reference="start"),
    _of_rig("backlash"),
    _of_rig("backlash", "reference", pressure_angle="reference"),
    _of_rig("exact_backlash"),
    Law(
        "axial_displacement",
        kin.axial_displacement,
        (np.array([0.05, -0.01, 0.3]), PAIR),
        "mm",
        {"no backlash": (np.zeros(3), PAIR)},
        first_is_length=True,
    ),
)
MODELS = (
    *_of_model(FirstOrderBounds, closed_model, "transmission_error", "backlash"),
    *_of_model(
        ExactModel, exact_model, "transmission_error", "backlash", "at_both_angles", "turned"
    ),
    *_of_model(OrderModel, _orders, "transmission_error", "backlash", "at_both_angles"),
    *_of_model(CombinedModel, _combined, "transmission_error", "backlash", "at_both_angles"),
)


@eqx.filter_jit
def _bounds(make, angle, pair, rig):
    """Both flanks with their slopes, and the gap, as one number that shows each of them."""
    angle, closing = jnp.asarray(angle, float), pair.taper / pair.reference_radii[1]
    bounds = make(pair, rig, closing)
    flanks = bounds.at(angle)
    walls = flanks.lower + 2.0 * flanks.upper + bounds.closing_sum * rig.axial_mm
    return walls + 3.0 * flanks.lower_slope + 5.0 * flanks.upper_slope + 7.0 * bounds.gap(angle)


def _table(pair, rig, closing):
    return tabulate_flanks(exact_model(pair, rig), 1, closing=closing, per_turn=16)


def _closed(pair, rig, closing):
    return replace(closed_model(pair, rig), closing=closing)


TABLES = tuple(
    Law(name, partial(_bounds, make), (ANGLES, PAIR, RIG), "rad", KINKS, slow=make is _table)
    for name, make in (("tabulate_flanks", _table), ("closed_model", _closed))
)
LAWS = (*FUNCTIONS, *MODELS, *TABLES, *SURFACES, *THICKNESSES, *CONTACTS)


def public_functions(module: Any) -> set[str]:
    """Names of the functions a module defines and offers."""
    return {
        name
        for name, value in vars(module).items()
        if callable(value)
        and not isinstance(value, type)
        and not name.startswith("_")
        and getattr(value, "__module__", "") == module.__name__
    }
