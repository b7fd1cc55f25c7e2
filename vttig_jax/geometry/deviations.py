"""Measured flank deviations as maps, and pitch deviations of each tooth."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from ..base.arrays import Numbers, float64, known
from ..base.errors import PairError
from ..base.files.text_tables import key_values
from .tooth import SHAFTS


class FlankMap(eqx.Module):
    """Deviation of one flank over profile and face: a bicubic spline through measured points.

    A deviation f rotates a point of the flank about the axis of its gear by f/r_b. This is f along
    the normal in the transverse plane, as a profile tester measures it; extra material is positive.
    The splines are those of `scipy.interpolate.CubicSpline` (not-a-knot) in each direction. Beyond
    the measured points the map keeps its value at their edge. It applies to all teeth.

    **Arguments**
    - `roll_mm`: roll lengths √(r² − r_b²) of the rows, two or more, increasing, shape (n,).
    - `z_mm`: heights of the columns in the gear's own frame, where the tooth thins towards +z, two
      or more, increasing, shape (m,).
    - `deviation_um`: deviations, shape (n, m). JAX may trace them, but not roll lengths and
      heights.

    **Raises** `PairError` for points that do not increase or are not finite, and for other shapes.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.geometry import FlankMap
    >>> vttig_jax.enable_x64()
    >>> roll, z = np.linspace(8.0, 22.0, 5), np.array([-8.0, 0.0, 8.0])
    >>> relief = FlankMap(roll, z, -0.1 * (roll[:, None] - 15.0) ** 2 + 0.2 * z)
    >>> relief.prepared()(np.array([15.0, 20.0]), np.array([0.0, 4.0])).round(4)
    Array([ 0. , -1.7], dtype=float64)

    ```
    """

    roll_mm: Float[Numbers, " n"]
    z_mm: Float[Numbers, " m"]
    deviation_um: Float[Numbers, "n m"]
    along_roll: Float[Numbers, "4 pieces n"]
    along_z: Float[Numbers, "4 strips m"]

    def __init__(self, roll_mm: Any, z_mm: Any, deviation_um: Any):
        for name, values in (("roll_mm", roll_mm), ("z_mm", z_mm)):
            if not known(values):
                raise ValueError(f"Argument `{name}` must be known numbers, but is traced.")
            _check_knots(values, name)
        self.roll_mm, self.z_mm = np.asarray(roll_mm, float), np.asarray(z_mm, float)
        self.deviation_um = float64(deviation_um)
        shape = len(self.roll_mm), len(self.z_mm)
        if self.deviation_um.shape != shape:
            raise PairError(
                f"the map has shape {self.deviation_um.shape} over {shape[0]} roll lengths and"
                f" {shape[1]} heights; give shape {shape}.",
                where="deviation_um",
            )
        if known(self.deviation_um):
            _check_finite(np.asarray(self.deviation_um), "deviation_um")
        self.along_roll, self.along_z = _pieces(self.roll_mm), _pieces(self.z_mm)

    def prepared(self) -> "Bicubic":
        """Return the map with one bicubic polynomial for each patch between neighbouring knots."""
        polynomials = jnp.einsum(
            "aip,bjq,pq->ijab", self.along_roll, self.along_z, jnp.asarray(self.deviation_um)
        )
        knots = jnp.asarray(self.roll_mm), jnp.asarray(self.z_mm)
        return Bicubic(*knots, polynomials.reshape(-1, 16))


def _check_knots(values: Any, where: str) -> None:
    """Raise `PairError` for knots of a spline that are too few, not finite or do not increase."""
    knots = np.asarray(values)
    if knots.ndim != 1 or len(knots) < 2:
        raise PairError(
            f"the shape is {knots.shape}; give two or more points, shape (n,).", where=where
        )
    _check_finite(knots, where)
    if not np.all(np.diff(knots) > 0):
        row = int(np.argmax(np.diff(knots) <= 0))
        raise PairError(
            f"the map goes from {knots[row]:g} to {knots[row + 1]:g} mm at points {row + 1} and"
            f" {row + 2}; sort the points and keep each value once.",
            where=where,
        )


def _check_finite(values: np.ndarray, where: str) -> None:
    """Raise `PairError` for an array with a number that is not finite."""
    if not np.all(np.isfinite(values)):
        point = tuple(int(i) + 1 for i in np.argwhere(~np.isfinite(values))[0])
        raise PairError(f"point {point} is not a number; remove or repair it.", where=where)


class Bicubic(eqx.Module):
    """Piecewise bicubic polynomials of a `FlankMap`.

    `roll` and `z` are the knots in mm; `polynomials` has the 16 coefficients of each patch.
    """

    roll: Float[Array, " n"]
    z: Float[Array, " m"]
    polynomials: Float[Array, "patches 16"]

    def __call__(
        self, roll: Float[Numbers, "*shape"], z: Float[Numbers, "*shape"]
    ) -> Float[Array, "*shape"]:
        """Return the deviation in µm at roll lengths and heights in mm."""
        row, across = _place(self.roll, roll)
        column, along = _place(self.z, z)
        powers = self.polynomials[row * (len(self.z) - 1) + column]
        value = jnp.zeros_like(across)
        for first in range(4):
            inner = jnp.zeros_like(along)
            for second in range(4):
                inner = inner * along + powers[..., 4 * first + second]
            value = value * across + inner
        return value


class Deviations(eqx.Module):
    """Deviations of both gears of a pair from their drawing; None stands for no deviation.

    **Arguments**
    - `driving`, `driven`: maps of flank A and flank B of each gear, or None.
    - `driving_pitch_um`, `driven_pitch_um`: cumulative pitch deviations of flank A and flank B of
      each tooth, shape (2, teeth), positive for extra material. They are arcs on the base circle;
      multiply an arc measured on a circle r_M by r_b/r_M. The first tooth is the one between the
      axes at φ = 0; the others follow in the order in which they come into mesh.
    """

    driving: tuple[FlankMap | None, FlankMap | None] = (None, None)
    driven: tuple[FlankMap | None, FlankMap | None] = (None, None)
    driving_pitch_um: Float[Numbers, "2 z1"] | None = eqx.field(
        converter=lambda value: None if value is None else float64(value), default=None
    )
    driven_pitch_um: Float[Numbers, "2 z2"] | None = eqx.field(
        converter=lambda value: None if value is None else float64(value), default=None
    )

    @property
    def maps(self) -> tuple[FlankMap, ...]:
        """Maps of all flanks that have one."""
        return tuple(m for m in (*self.driving, *self.driven) if m is not None)

    def __str__(self) -> str:
        def span(values: Numbers) -> str:
            return f"{np.min(values):.2f} … {np.max(values):.2f} µm"

        rows = []
        for gear in SHAFTS:
            pitches = getattr(self, f"{gear}_pitch_um")
            for side, flank in enumerate("AB"):
                if (given := getattr(self, gear)[side]) is not None:
                    count = f"{len(given.roll_mm)} × {len(given.z_mm)} points"
                    rows.append((f"{gear} flank {flank}", f"{count}, {span(given.deviation_um)}"))
                if pitches is not None and np.any(row := pitches[side]):
                    rows.append((f"{gear} pitch {flank}", f"{len(row)} teeth, {span(row)}"))
        return key_values(rows or [("none", None)], title="deviations of the flanks")


def _pieces(knots: np.ndarray) -> np.ndarray:
    """Return the linear map from values at the knots to the coefficients of a cubic spline.

    The shape is (power, piece, knot); the highest power comes first. Two points give a line and
    three points a parabola, each written as a cubic.
    """
    coefficients = CubicSpline(knots, np.eye(len(knots))).c
    missing = np.zeros((4 - len(coefficients), *coefficients.shape[1:]))
    return np.concatenate([missing, coefficients])


def _place(knots: Array, values: Numbers) -> tuple[Array, Array]:
    """Return the index of the piece of each value and the distance from the start of the piece."""
    inside = jnp.clip(values, knots[0], knots[-1])
    # XLA vectorises a sum over the few knots, but not a search.
    piece = sum((inside >= knot).astype(int) for knot in knots[1:-1]) + jnp.zeros_like(inside, int)
    return piece, inside - knots[piece]
