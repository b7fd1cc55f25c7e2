"""Both flanks as functions of the driving angle, quick enough for every step of a simulation.

A reversal is simulated in the offset x = φ₂ − i φ₁. Flank A is its lower bound, flank B the upper
(s is the axial displacement):

    TE_A(φ₁) + s tan β_L/R₂  ≤  x  ≤  TE_B(φ₁) − s tan β_R/R₂

An exact or fitted flank model is implicit in φ₂ and too slow inside a loop. In contact the TE is a
function of φ₁ alone. A `FlankTable` holds its values and slopes at evenly spaced nodes and
interpolates between them; `FirstOrderBounds` evaluates the closed form of eccentric gears.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ..base.arrays import Number, Numbers, float64
from ..base.numerics.sincos import sincos
from ..base.units import REV
from ..pair.schema import FLANKS, Flank
from .flank_model import FIRST_ORDERS, Angles, AnglesLike, FlankModel, GridOrders, flank_index

PER_CYCLE = 64
"""Nodes in one cycle of the highest order.

The interpolation is then within (2π/64)⁴/384 = 2.4e-7 of the amplitude of that order."""

_FEWEST = 512
"""Least number of nodes in a driving turn: first orders are within 6e-11 of their amplitude."""

_CHUNK = 4096
"""Nodes computed at once, so that the harmonics of a long table need little memory; chosen."""

_NO_CLOSING = np.zeros(2)


class Flanks(eqx.Module):
    """TE on flank A (`lower`) and flank B (`upper`), rad, and their slopes dTE/dφ₁."""

    lower: Angles
    upper: Angles
    lower_slope: Angles
    upper_slope: Angles


class Bounds(FlankModel):
    """Flank model whose flanks and slopes at a driving angle are found without iteration.

    `closing` holds tan β_L/R₂ and tan β_R/R₂, rad/mm: the change of TE per axial displacement,
    upwards on flank A and downwards on flank B. It is zero for gears without taper.
    """

    closing: eqx.AbstractVar[Float[Numbers, "2"]]

    @abstractmethod
    def at(self, driving_angle: Angles) -> Flanks:
        """Return both flanks at a driving angle (rad) for an axial displacement of zero."""

    @abstractmethod
    def gap(self, driving_angle: Angles) -> Angles:
        """Return the backlash j = TE_B − TE_A (rad) at a driving angle (rad) for s = 0."""

    @abstractmethod
    def turned(self, turns: Int[ArrayLike, ""]) -> "Bounds":
        """Return flanks whose values at φ₁ are those of these flanks at φ₁ + 2π · `turns`."""

    def transmission_error(self, driving_angle: AnglesLike, flank: Flank) -> Angles:
        """Return TE of `flank`, rad."""
        flanks = self.at(jnp.asarray(driving_angle, float))
        return (flanks.lower, flanks.upper)[flank_index(flank)]

    @property
    def closing_sum(self) -> Float[Array, ""]:
        """Decrease of the backlash per axial displacement, rad/mm; see equation (16)."""
        return jnp.sum(jnp.asarray(self.closing))

    def closed_at(self, gap: Angles) -> Angles:
        """Return the axial displacement, mm, that closes a gap (rad); infinite without taper."""
        slope = self.closing_sum
        return jnp.where(slope > 0, gap * (1.0 / jnp.where(slope > 0, slope, 1.0)), jnp.inf)


class FirstOrderBounds(Bounds):
    """Flanks with the first order of each shaft: one sine and cosine of φ₁ and of i φ₁.

        TE_f = offset_f + Σ_s [cosine_fs cos φ_s + sine_fs sin φ_s],   φ_s = φ₁, i φ₁

    **Arguments**
    - `ratio`: i. - `offset`: mean TE of flanks A and B, rad. - `closing`: see `Bounds`.
    - `cosine`, `sine`: coefficients, rad, shape (2, 2): flank, shaft.
    """

    ratio: Float[Numbers, ""] = eqx.field(converter=float64)
    offset: Float[Numbers, "2"] = eqx.field(converter=float64)
    cosine: Float[Numbers, "2 2"] = eqx.field(converter=float64)
    sine: Float[Numbers, "2 2"] = eqx.field(converter=float64)
    closing: Float[Numbers, "2"] = eqx.field(converter=float64, default=(0.0, 0.0))

    @property
    def grid_orders(self) -> GridOrders:
        """The first order of each shaft."""
        return FIRST_ORDERS

    def at(self, driving_angle: Angles) -> Flanks:
        """See `Bounds.at`."""
        speeds = (1.0, jnp.asarray(self.ratio))
        waves = [sincos(speed * driving_angle) for speed in speeds]
        cosine, sine, offset = map(jnp.asarray, (self.cosine, self.sine, self.offset))
        value, slope = list(offset), [jnp.zeros(()), jnp.zeros(())]
        for flank in (0, 1):
            for shaft, (speed, (s, c)) in enumerate(zip(speeds, waves, strict=True)):
                a, b = cosine[flank, shaft], sine[flank, shaft]
                value[flank] = value[flank] + (a * c + b * s)
                slope[flank] = slope[flank] + speed * (b * c - a * s)
        return Flanks(value[0], value[1], slope[0], slope[1])

    def gap(self, driving_angle: Angles) -> Angles:
        """See `Bounds.gap`."""
        cosine, sine, gap = (
            jnp.asarray(c)[1] - jnp.asarray(c)[0] for c in (self.cosine, self.sine, self.offset)
        )
        for shaft, speed in enumerate((1.0, jnp.asarray(self.ratio))):
            s, c = sincos(speed * driving_angle)
            gap = gap + (cosine[shaft] * c + sine[shaft] * s)
        return gap

    def turned(self, turns: Int[ArrayLike, ""]) -> "FirstOrderBounds":
        """See `Bounds.turned`."""
        return self.ahead(REV * turns * jnp.stack([jnp.zeros(()), jnp.asarray(self.ratio)]))

    def ahead(self, angle: Float[Numbers, "shaft=2"]) -> "FirstOrderBounds":
        """Return flanks whose waves of each shaft are ahead by an angle, rad."""
        c, s = jnp.cos(angle)[None], jnp.sin(angle)[None]
        a, b = jnp.asarray(self.cosine), jnp.asarray(self.sine)
        return replace(self, cosine=a * c + b * s, sine=b * c - a * s)


class FlankTable(Bounds):
    """Both flanks by cubic Hermite interpolation between evenly spaced nodes.

    Within an interval, t = 0 … 1 is the elapsed share, and of each flank both ends give the value
    and the slope. A periodic table repeats after its last node; another one keeps the values of its
    ends outside. Several tables, such as those of posterior draws, may share the array of nodes.

    **Arguments**
    - `nodes`: TE_A, step · dTE_A/dφ₁, TE_B, step · dTE_B/dφ₁ at each node, rad, shape (rows, 4).
    - `ratio`: i. - `start`, `step`: angle of the first node, and their distance, rad.
    - `closing`: see `Bounds`. - `first`: row of the first node.
    - `intervals`: number of intervals, one less than the nodes. - `periodic`: see above.
    """

    nodes: Float[Numbers, "rows 4"]
    ratio: Float[Number, ""] = eqx.field(converter=float64)
    start: Float[Number, ""] = eqx.field(converter=float64)
    step: Float[Number, ""] = eqx.field(converter=float64)
    closing: Float[Numbers, "2"] = eqx.field(converter=float64)
    first: Int[Numbers, ""]
    intervals: int = eqx.field(static=True)
    periodic: bool = eqx.field(static=True)

    @property
    def grid_orders(self) -> GridOrders:
        """The order of the driving shaft with `PER_CYCLE` nodes in a cycle."""
        return ((REV / (float(self.step) * PER_CYCLE), 0),)

    def at(self, driving_angle: Angles) -> Flanks:
        """See `Bounds.at`."""
        share, start, end = self._interval(driving_angle)
        rate = 1.0 / jnp.asarray(self.step)
        lower, lower_slope = _hermite(share, *start[:2], *end[:2])
        upper, upper_slope = _hermite(share, *start[2:], *end[2:])
        return Flanks(lower, upper, lower_slope * rate, upper_slope * rate)

    def gap(self, driving_angle: Angles) -> Angles:
        """See `Bounds.gap`."""
        share, start, end = self._interval(driving_angle)
        gaps = [node[i + 2] - node[i] for node in (start, end) for i in (0, 1)]
        return _hermite(share, *gaps)[0]

    def turned(self, turns: Int[ArrayLike, ""]) -> "FlankTable":
        """See `Bounds.turned`."""
        return replace(self, start=self.start - REV * turns)

    @property
    def length(self) -> Any:
        """Driving angle from the first to the last node, rad."""
        return self.step * self.intervals

    def _interval(self, angle: Angles):
        """Return the share of the interval that holds an angle, and the numbers of its ends."""
        share, row = place_of(angle, self.start, self.step, self.intervals, self.periodic)
        row = row + jnp.asarray(self.first, jnp.int32)
        found = gathered(self.nodes, 4 * row, 8)
        return share, found[:4], found[4:]


def place_of(
    angle: Angles, start: Any, step: Any, intervals: int, periodic: bool
) -> tuple[Float[Array, "*shape"], Int[Array, "*shape"]]:
    """Return the share of the interval that holds an angle, and the number of this interval.

    The first of so many intervals of length `step` begins at `start`, rad. A table that is not
    periodic has the values of its ends outside.
    """
    place = (angle - start) * (1.0 / jnp.asarray(step))
    if periodic:
        whole = jnp.floor(place)
        row = whole - intervals * jnp.floor(whole / intervals)
    else:
        place = jnp.clip(place, 0.0, float(intervals))
        whole = row = jnp.minimum(jnp.floor(place), intervals - 1.0)
    return place - whole, row.astype(jnp.int32)


def gathered(table: Any, first: Any, count: int) -> list[Array]:
    """Return consecutive numbers of a table, one by one: XLA joins such gathers with what follows.

    XLA clamps the index of a gather, so that an angle that is not a number does no harm.
    """
    numbers = jnp.asarray(table).reshape(-1)
    return [numbers.at[first + i].get(mode="promise_in_bounds") for i in range(count)]


def _hermite(share, start, rise, end, fall):
    """Return value and slope of the cubic at `share`, from those at both ends of the interval."""
    change = end - start
    c2, c3 = 3 * change - 2 * rise - fall, rise + fall - 2 * change
    value = start + share * (rise + share * (c2 + share * c3))
    return value, rise + share * (2 * c2 + 3 * share * c3)


def tabulate_flanks(
    model: FlankModel,
    turns: int,
    *,
    periodic: bool = True,
    first_turn: int | Number = 0,
    closing: Float[Numbers, "2"] = _NO_CLOSING,
    per_turn: int | None = None,
) -> FlankTable:
    """Tabulate both flanks of a model; a pure function of all its numbers.

    It works under `jax.jit`, `jax.vmap` over stacked models, and derivatives in both modes, also
    with respect to eccentricities, helix angles and fitted coefficients.

    **Arguments**
    - `model`: any flank model; see `as_flank_model` for fits, maps and functions.
    - `turns`: driving turns of the table. - `periodic`: whether the flanks repeat after them, as
      they do after the hunting period.
    - `first_turn`: driving turn at which the table begins. - `closing`: see `Bounds`.
    - `per_turn`: nodes in a driving turn. By default `nodes_per_turn(model)`, which needs a model
      whose ratio is not traced.

    **Example**
    ```python
    >>> import jax, jax.numpy as jnp, vttig_jax
    >>> from vttig_jax.kinematics import exact_model, tabulate_flanks
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> pair = paper_pair()
    >>> table = tabulate_flanks(exact_model(pair, paper_eccentricities()), pair.hunting_turns)
    >>> bool(abs(table.gap(1.0) - exact_model(pair, paper_eccentricities()).backlash(1.0)) < 1e-14)
    True

    ```
    """
    per_turn = nodes_per_turn(model) if per_turn is None else per_turn
    step = REV / per_turn
    rows = turns * per_turn + 1
    angle = REV * first_turn + step * jnp.arange(-(-rows // _CHUNK) * _CHUNK)

    def nodes(angle: Float[Array, " chunk"]) -> Float[Array, "chunk 4"]:
        columns: list[Array] = []
        for flank in FLANKS:
            error = partial(model.transmission_error, flank=flank)
            value, slope = jax.jvp(error, (angle,), (jnp.ones_like(angle),))
            columns += [value, step * slope]
        return jnp.stack(columns, axis=1)

    return FlankTable(
        nodes=jax.lax.map(nodes, angle.reshape(-1, _CHUNK)).reshape(-1, 4)[:rows],
        ratio=model.ratio,
        start=REV * first_turn,
        step=step,
        closing=closing,
        first=np.asarray(0),
        intervals=turns * per_turn,
        periodic=periodic,
    )


def nodes_per_turn(model: FlankModel) -> int:
    """Return the number of nodes in a driving turn that suits the highest order of a model."""
    if isinstance(model.ratio, Tracer):
        raise ValueError(
            "Argument `per_turn` must be given for a model whose ratio is traced, because the"
            " number of nodes is a shape; find it with `nodes_per_turn` outside."
        )
    return max(_FEWEST, PER_CYCLE * math.ceil(model.highest_order - 1e-9))


class FunctionModel(FlankModel):
    """Flank model that a function of the user gives.

    **Arguments**
    - `ratio`: i. - `function`: (driving angle in rad, "A" or "B") → TE in rad, in JAX.
    - `order`: highest order that a table must resolve, in cycles per driving turn.
    """

    ratio: Float[Numbers, ""] = eqx.field(converter=float64)
    function: Callable[[Any, Flank], Any]
    order: float = eqx.field(static=True, default=8.0)

    @property
    def grid_orders(self) -> GridOrders:
        """Highest order, as the user gives it."""
        return ((self.order, 0),)

    def transmission_error(self, driving_angle: AnglesLike, flank: Flank) -> Angles:
        """Return TE of `flank`, rad."""
        return jnp.asarray(self.function(jnp.asarray(driving_angle, float), flank))


def as_flank_model(source: Any, ratio: Any) -> FlankModel:
    """Return the flank model of a `FlankModel`, `BacklashMap`, `Fit`, posterior draw or function.

    `ratio` is that of a function, which maps (driving angle in rad, "A" or "B") to TE in rad.

    **Raises** `ValueError` for any other object.
    """
    for candidate in (source, *(getattr(source, name, None) for name in ("flank_model", "model"))):
        if isinstance(candidate, FlankModel):
            return candidate
    if callable(source):
        return FunctionModel(ratio, source)
    raise ValueError(
        "A map must be a flank model, a backlash map, a fit or a function (angle, flank) → TE, but"
        f" is a {type(source).__name__}."
    )
