"""The recession of a flank along the axis, as a formula or as a curve through tabulated heights."""

from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from ...base.arrays import Number, Numbers, float64, namespace
from ...base.errors import PairError

Scalar = Float[Number, ""]


@runtime_checkable
class Recession(Protocol):
    """Any smooth function of z: by how much a flank recedes at the reference circle.

    The tangential modification of the paper is x_t(z) = −(δ_left(z) + δ_right(z))/m. Written over
    arrays, so that it can be jitted and differentiated.
    """

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """δ(z) in mm, positive where the tooth is thinner than in the middle of the face."""
        ...


class Taper(eqx.Module):
    """Linear and crowned: δ(z) = z tan β + c (2 z/b)².

    **Arguments**
    - `slope`: tan β, positive where the flank thins the tooth towards +z.
    - `crowning_mm`: c, by which the flank recedes at either end of the face.
    - `face_width_mm`: b; matters only beside a crowning.
    """

    slope: Scalar = eqx.field(converter=float64)
    crowning_mm: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=1.0)

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """δ(z) in mm."""
        return z * self.slope + self.crowning_mm * (2 * z / self.face_width_mm) ** 2


class Tabulated(eqx.Module):
    """δ(z) through measured points: the natural cubic spline, straight beyond its ends.

    Twice continuously differentiable everywhere, so that the flank has a curvature, and linear in
    the table, through which it can be differentiated.

    **Arguments**
    - `z_mm`: two or more heights, strictly increasing, shape (n,).
    - `recession_mm`: δ at these heights, positive where the tooth is thinner, shape (n,).

    **Raises** `PairError` for heights that do not increase and for numbers that are not finite.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.geometry import Tabulated
    >>> measured = Tabulated([-10.0, 0.0, 10.0], [-0.52, 0.0, 0.53])
    >>> measured(np.array([-10.0, 5.0, 20.0])).round(5)
    array([-0.52   ,  0.26406,  1.0625 ])

    ```
    """

    z_mm: Float[Numbers, " n"] = eqx.field(converter=float64)
    recession_mm: Float[Numbers, " n"] = eqx.field(converter=float64)

    def __check_init__(self) -> None:
        self.check()

    def check(self, where: str = "recession") -> None:
        """Raise `PairError` for a table that folds or is not finite; traced ones pass."""
        if any(isinstance(leaf, Tracer) for leaf in (self.z_mm, self.recession_mm)):
            return
        z, recession = np.asarray(self.z_mm), np.asarray(self.recession_mm)
        if z.ndim != 1 or z.shape != recession.shape or len(z) < 2:
            raise PairError(
                f"a table of {z.shape} heights and {recession.shape} values; give as many values as"
                " heights, two or more of each.",
                where=where,
            )
        if not np.all(np.isfinite(z)) or not np.all(np.isfinite(recession)):
            row = int(np.argmin(np.isfinite(z) & np.isfinite(recession)))
            raise PairError(
                f"row {row + 1} of the table is not a number (z = {z[row]:g} mm, δ ="
                f" {recession[row]:g} mm); remove or repair it.",
                where=where,
            )
        if not np.all(np.diff(z) > 0):
            row = int(np.argmax(np.diff(z) <= 0))
            raise PairError(
                f"folded: z goes from {z[row]:g} to {z[row + 1]:g} mm in rows {row + 1} and"
                f" {row + 2} of the table; sort its rows by z and keep one of each height.",
                where=where,
            )

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape"]:
        """δ(z) in mm."""
        xp = namespace(self, z)
        bends = _bends(xp.asarray(self.z_mm), xp.asarray(self.recession_mm))
        heights, values = xp.asarray(self.z_mm), xp.asarray(self.recession_mm)
        inside = xp.clip(z, heights[0], heights[-1])
        right = xp.clip(xp.searchsorted(heights, inside, side="right"), 1, len(heights) - 1)
        left = right - 1
        width = heights[right] - heights[left]
        rest, run = (heights[right] - inside) / width, (inside - heights[left]) / width
        arch = (rest**3 - rest) * bends[left] + (run**3 - run) * bends[right]
        value = rest * values[left] + run * values[right] + arch * width**2 / 6
        return value + (z - inside) * self._end_slope(inside, bends)

    def _end_slope(self, inside: Any, bends: Any) -> Any:
        """Slope of the nearer end, which the curve keeps beyond it."""
        xp = namespace(self, inside)
        z, values = xp.asarray(self.z_mm), xp.asarray(self.recession_mm)
        width = z[1:] - z[:-1]
        chord = (values[1:] - values[:-1]) / width
        first = chord[0] - width[0] * bends[1] / 6
        last = chord[-1] + width[-1] * bends[-2] / 6
        return xp.where(inside <= z[0], first, last)


def _bends(z: Any, values: Any) -> Any:
    """Second derivatives of the natural spline at its knots, zero at both ends."""
    if namespace(z, values) is np:
        return CubicSpline(z, values, bc_type="natural")(z, 2)
    width = z[1:] - z[:-1]
    chord = (values[1:] - values[:-1]) / width
    if len(z) == 2:
        return jnp.zeros_like(values)
    lower = jnp.concatenate([jnp.zeros(1), width[1:-1]])
    upper = jnp.concatenate([width[1:-1], jnp.zeros(1)])
    right = 6 * (chord[1:] - chord[:-1])
    middle = 2 * (width[1:] + width[:-1])
    inner = jax.lax.linalg.tridiagonal_solve(lower, middle, upper, right[:, None])[:, 0]
    return jnp.concatenate([jnp.zeros(1), inner, jnp.zeros(1)])
