"""Recession of a flank along the axis, as a formula or as a spline through tabulated values."""

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
    """Smooth function of z: recession of a flank along the reference circle.

    The tangential modification of the paper is x_t(z) = −(δ_left(z) + δ_right(z))/m. The function
    takes arrays, so that it can be jitted and differentiated.
    """

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """Return δ(z) in mm, positive where the tooth is thinner than in the middle of the face."""
        ...


class Taper(eqx.Module):
    """Recession of a tapered, crowned and thinned flank: δ(z) = t + z tan β + c (2 z/b)².

    **Arguments**
    - `slope`: tan β, positive where the flank thins the tooth towards +z.
    - `crowning_mm`: recession c due to crowning at both ends of the face.
    - `face_width_mm`: face width b; it is used only with a crowning.
    - `thinning_mm`: recession t in the middle of the face, half the thinning of the tooth.
    """

    slope: Scalar = eqx.field(converter=float64)
    crowning_mm: Scalar = eqx.field(converter=float64, default=0.0)
    face_width_mm: Scalar = eqx.field(converter=float64, default=1.0)
    thinning_mm: Scalar = eqx.field(converter=float64, default=0.0)

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Number, "*shape"]:
        """Return δ(z) in mm."""
        crown = self.crowning_mm * (2 * z / self.face_width_mm) ** 2
        return z * self.slope + crown + self.thinning_mm


class Tabulated(eqx.Module):
    """Recession δ(z) as a natural cubic spline through measured points, linear beyond its ends.

    The spline is twice continuously differentiable, so that the flank has a curvature. It is linear
    in the tabulated values and can be differentiated with respect to them.

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
        """Raise `PairError` for a table that defines no spline; traced values are not checked.

        Such a table has different numbers of heights and values, fewer than two heights, numbers
        that are not finite, or heights that do not increase. `where` is the `where` of the error.
        """
        if any(isinstance(leaf, Tracer) for leaf in (self.z_mm, self.recession_mm)):
            return
        z, recession = np.asarray(self.z_mm), np.asarray(self.recession_mm)
        if z.ndim != 1 or z.shape != recession.shape or len(z) < 2:
            raise PairError(
                f"the table has heights of shape {z.shape} and values of shape {recession.shape};"
                " give as many values as heights, two or more of each.",
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
                f"z does not increase: it goes from {z[row]:g} to {z[row + 1]:g} mm in rows"
                f" {row + 1} and {row + 2} of the table; sort its rows by z and keep one row for"
                " each height.",
                where=where,
            )

    def __call__(self, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape"]:
        """Return δ(z) in mm."""
        xp = namespace(self, z)
        heights, values = xp.asarray(self.z_mm), xp.asarray(self.recession_mm)
        second = _second_derivatives(heights, values)
        inside = xp.clip(z, heights[0], heights[-1])
        right = xp.clip(xp.searchsorted(heights, inside, side="right"), 1, len(heights) - 1)
        left = right - 1
        width = heights[right] - heights[left]
        a, b = (heights[right] - inside) / width, (inside - heights[left]) / width
        cubic = (a**3 - a) * second[left] + (b**3 - b) * second[right]
        value = a * values[left] + b * values[right] + cubic * width**2 / 6
        return value + (z - inside) * self._end_slope(inside, second)

    def _end_slope(self, inside: Any, second: Any) -> Any:
        """Return the slope at the nearer end of the table; the extrapolation keeps this slope."""
        xp = namespace(self, inside)
        z, values = xp.asarray(self.z_mm), xp.asarray(self.recession_mm)
        width = z[1:] - z[:-1]
        chord = (values[1:] - values[:-1]) / width
        first = chord[0] - width[0] * second[1] / 6
        last = chord[-1] + width[-1] * second[-2] / 6
        return xp.where(inside <= z[0], first, last)


def _second_derivatives(z: Any, values: Any) -> Any:
    """Return the second derivatives of the natural spline at its knots; both ends are zero."""
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
