"""Sine and cosine together, as polynomials that XLA vectorises on the CPU.

For float64 `jnp.sin` and `jnp.cos`, XLA calls a scalar library function for each element. Sums and
products run in vector lanes, and one range reduction serves both functions.

**Source of the constants.** The range reduction is r = x − k·π/2 with k the nearest integer, so
that |r| ≤ π/4. π/2 is a sum of parts; they are so short that k times each part but the last is
exact for |x| ≤ 1e5 (k < 2¹⁶): 36 + 53 bits in float64, 8 + 8 + 8 + 24 bits in float32. On
|r| ≤ π/4, with t = r²,

    sin r = r + r t S(t)          cos r = 1 − t/2 + t² C(t)

S and C interpolate the remainder of the series at the n Chebyshev nodes of [0, (π/4)²],
t_i = (π/4)²/2 · (1 − cos((2i + 1)π/2n)), solved with 60 digits. The error of sine and cosine is
1e-17 and 5e-19 for n = 6 (float64), 1e-8 and 8e-10 for n = 3 (float32); a test derives the
constants again. The leading terms are exact, so that sin r = r for small r.
"""

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real


class _Constants(NamedTuple):
    half_pi: tuple[float, ...]
    sine: tuple[float, ...]
    cosine: tuple[float, ...]


_CONSTANTS: Final = {
    "float64": _Constants(
        half_pi=(1.5707963267923333, 2.563344151594519e-12),
        sine=(
            -0.16666666666666666,
            0.008333333333330948,
            -0.00019841269836758574,
            2.755731610255244e-06,
            -2.5051131845003624e-08,
            1.5918129294866608e-10,
        ),
        cosine=(
            0.041666666666666664,
            -0.0013888888888887398,
            2.480158729876569e-05,
            -2.7557317271729793e-07,
            2.08761462684032e-09,
            -1.1382632425521717e-11,
        ),
    ),
    "float32": _Constants(
        half_pi=(1.5703125, 0.0004825592041015625, 1.2665987014770508e-06, 9.92093629470503e-10),
        sine=(-0.1666666466231438, 0.008332748270629749, -0.00019587890880412386),
        cosine=(0.04166666465950221, -0.0013888303035894866, 2.4547942085071572e-05),
    ),
}

_QUADRANTS_PER_RADIAN: Final = 0.6366197723675814  # 2/π


def sincos(x: Real[ArrayLike, "*shape"]) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Return (sin x, cos x) of angles in rad.

    For |x| ≤ 1e5 the absolute error is at most 5e-16 in float64 and 1.5e-7 in float32 (for x as
    stored). For larger |x| it is at most ε|x| with the machine epsilon ε of the dtype, as large as
    the effect of rounding x. The result is NaN for infinities and for |x| ≥ 1/ε, where neighbouring
    numbers are one radian apart. The derivative is exactly (cos x, −sin x). Integers are converted
    to the default float.

    **Raises** `ValueError` for dtypes other than float32, float64 and integers.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.base.numerics.sincos import sincos
    >>> vttig_jax.enable_x64()
    >>> sine, cosine = sincos(np.pi / 6)
    >>> round(float(sine), 15), round(float(cosine), 15)
    (0.5, 0.866025403784439)

    ```
    """
    angle = jnp.asarray(x)
    if jnp.issubdtype(angle.dtype, jnp.integer):
        angle = angle.astype(float)
    if angle.dtype.name not in _CONSTANTS:
        raise ValueError(
            f"Argument `x` must be float32, float64 or integer, but its dtype is {angle.dtype}."
        )
    return _sincos(angle)


@jax.custom_jvp
def _sincos(x: Array) -> tuple[Array, Array]:
    constants = _CONSTANTS[x.dtype.name]
    turns = jnp.round(x * _QUADRANTS_PER_RADIAN)
    r = jnp.where(jnp.abs(x) * float(jnp.finfo(x.dtype).eps) < 1.0, x, jnp.nan)
    for part in constants.half_pi:
        r = r - turns * part
    t = r * r
    sine = r + r * t * _polynomial(t, constants.sine)
    cosine = 1.0 - 0.5 * t + t * t * _polynomial(t, constants.cosine)
    # The quadrant 0…3 is computed by sums and products only, because XLA does not vectorise a
    # gather or an integer modulo.
    quadrant = turns - 4.0 * jnp.floor(turns * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sine_sign = jnp.where(quadrant >= 2.0, -1.0, 1.0).astype(x.dtype)
    cosine_sign = jnp.where((quadrant == 1.0) | (quadrant == 2.0), -1.0, 1.0).astype(x.dtype)
    return (
        sine_sign * jnp.where(odd, cosine, sine),
        cosine_sign * jnp.where(odd, sine, cosine),
    )


@_sincos.defjvp
def _sincos_jvp(primals: tuple[Array], tangents: tuple[Array]):
    (x,), (dx,) = primals, tangents
    sine, cosine = _sincos(x)
    return (sine, cosine), (cosine * dx, -sine * dx)


def _polynomial(t: Array, coefficients: tuple[float, ...]) -> Array:
    """Evaluate Σ_j coefficients_j tʲ by Horner's rule."""
    value = jnp.full_like(t, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * t + coefficient
    return value
