"""The restricted likelihood of compressed logs: a pure function of noise and prior scales.

Row k of a run is y_k = x_k β + n_k. The noise n is an autoregression within each run, and every
column has a Gaussian prior: flat, of known width, or of a width τ that a group of columns shares.
With the filter f of the autoregression (f₀ = 1) the whitened normal equations are

    [X | y]ᵀ Σ⁻¹ [X | y] = G = Σ_{i ≤ j} f_i f_j D_ij / σ²

(the exact form of Box and Jenkins; `problem.py` makes the D_ij), so that the cost of the likelihood
does not depend on the length of the logs. With D = diag(prior precision), M = G_xx + D and
β̂ = M⁻¹ (G_xy − D c), where c is the value at which the columns are centred,

    −2 ln L(θ) = N ln σ² − R Σ_k k ln(1 − π_k²) + Σ_random ln v_j + ln|M|
                 + rᵀ G r + (β̂ + c)ᵀ D (β̂ + c)

with r = (β̂, −1), N rows and R runs. θ holds the partial autocorrelations as atanh π_k, ln σ and the
ln τ of every group. Prior of θ: atanh π_k ~ N(0, w_k²), w from 2.5 for k = 1 down to 0.4;
τ is half-Cauchy around its usual scale, as a density of ln τ.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Numbers

LAGS = 8
"""Order of the autoregression of the rows."""

FIRST, SECOND = np.triu_indices(LAGS + 1)
"""Lags (i, j) of every window, i ≤ j."""

MEMORY = np.array([2.5, 0.7, 0.7] + [0.4] * (LAGS - 3))
"""Prior widths of atanh π_k."""

_LAG = np.arange(1.0, LAGS + 1)
_FLIPS = np.stack([np.pad(np.eye(k + 2)[::-1], (0, LAGS - k - 1)) for k in range(LAGS)])
_JITTER = 1e-11


class Compressed(eqx.Module):
    """Compressed logs with the prior of their columns; the last column is y.

    **Arguments**
    - `windows`: D_ij of all columns for the lags (`FIRST`, `SECOND`).
    - `rows`, `runs`: N and R.
    - `member`: 1/sd² of a column in its group, where τ sd is its prior width; 0 in other groups.
    - `precision`: precision of a prior of known width; 0 for a flat prior.
    - `centre`: c, the value at which a column is centred.
    - `usual`: scale of the prior of each τ. - `on`: 1 for groups in the model, 0 for others.
    - `constant`: Σ ln sd² over the columns of groups. - `memory`: prior widths of atanh π_k.
    """

    windows: Float[Numbers, "pairs all all"]
    rows: Float[Numbers, ""]
    runs: Float[Numbers, ""]
    member: Float[Numbers, "columns groups"]
    precision: Float[Numbers, " columns"]
    centre: Float[Numbers, " columns"]
    usual: Float[Numbers, " groups"]
    on: Float[Numbers, " groups"]
    constant: Float[Numbers, ""]
    memory: Float[Numbers, " lags"]


class Solved(eqx.Module):
    """Value of the density at θ, with its derivatives and the coefficients given θ.

    - `value`: −ln of the penalised restricted likelihood; `gradient`, `hessian` by θ.
    - `likelihood`: −2 ln L without the prior of θ.
    - `beta`, `spread`: mean β̂ and covariance M⁻¹ of the coefficients given θ.
    - `moments`: the next θ by expectation and maximisation.
    """

    value: Float[Array, ""]
    gradient: Float[Array, " p"]
    hessian: Float[Array, "p p"]
    likelihood: Float[Array, ""]
    beta: Float[Array, " columns"]
    spread: Float[Array, "columns columns"]
    moments: Float[Array, " p"]


@jax.jit
def whitening(partial: Float[Array, " lags"]) -> Float[Array, " taps"]:
    """Return the filter of an autoregression from its partial autocorrelations (Levinson)."""

    def longer(taps: Float[Array, " taps"], step: tuple[Array, Array]) -> tuple[Array, None]:
        one, flip = step
        return taps - one * (flip @ taps), None

    first = jnp.zeros(LAGS + 1).at[0].set(1.0)
    return jax.lax.scan(longer, first, (partial, jnp.asarray(_FLIPS)))[0]


def weights(theta: Float[Array, " p"], on: Float[Numbers, " groups"]) -> Float[Array, " w"]:
    """Return the weights f_i f_j/σ² of the windows, followed by 1/τ² of every group."""
    taps = whitening(partial_of(theta))
    of_windows = taps[FIRST] * taps[SECOND] * jnp.exp(-2 * theta[LAGS])
    return jnp.concatenate([of_windows, on * jnp.exp(-2 * theta[LAGS + 1 :])])


def partial_of(theta: Float[Numbers, " p"]) -> Float[Array, " lags"]:
    """Return the partial autocorrelations π_k."""
    return 0.9999 * jnp.tanh(theta[:LAGS])


def _explicit(theta: Float[Array, " p"], logs: Compressed) -> Float[Array, ""]:
    """Return the terms of −2 ln L that depend on θ alone."""
    count = jnp.sum(jnp.asarray(logs.member) > 0, axis=0) * jnp.asarray(logs.on)
    noise = 2 * jnp.asarray(logs.rows) * theta[LAGS]
    ends = jnp.asarray(logs.runs) * jnp.sum(_LAG * jnp.log1p(-(partial_of(theta) ** 2)))
    return noise - ends + 2 * count @ theta[LAGS + 1 :] + jnp.asarray(logs.constant)


def _penalty(theta: Float[Array, " p"], logs: Compressed) -> Float[Array, ""]:
    """Return −2 ln of the prior of θ; a group that is off is held at its usual scale."""
    far = theta[LAGS + 1 :] - jnp.log(logs.usual)
    cauchy = 2 * jnp.logaddexp(0.0, 2 * far) - 2 * far
    return jnp.sum((theta[:LAGS] / jnp.asarray(logs.memory)) ** 2) + jnp.sum(
        jnp.where(logs.on > 0, cauchy, far**2)
    )


def solved(theta: Float[Array, " p"], logs: Compressed) -> Solved:
    """Return the density at θ with its exact gradient and Hessian.

    −2 ln L depends on θ through the weights of the windows and of the groups, in which G and D are
    linear, so that its derivatives are traces of products of M⁻¹ with the windows.
    """
    windows = jnp.asarray(logs.windows)
    size = windows.shape[-1]
    pairs = len(FIRST)
    flat = windows.reshape(pairs, -1)

    def of_theta(theta: Float[Array, " p"]) -> Float[Array, " terms"]:
        return jnp.append(weights(theta, logs.on), _explicit(theta, logs) + _penalty(theta, logs))

    terms, slope = of_theta(theta), jax.jacfwd(of_theta)(theta)
    bent = jax.jacfwd(jax.jacfwd(of_theta))(theta)
    weight = terms[:-1]
    taken = jnp.concatenate([weight[None, :pairs], slope[:pairs, :LAGS].T]) @ flat
    gram, bends = taken[0].reshape(size, size), taken[1:].reshape(LAGS, size, size)
    prior = logs.precision + logs.member @ weight[pairs:]
    whole = gram[:-1, :-1] + jnp.diag(prior)
    scale = 1 / jnp.sqrt(jnp.diag(whole))
    factor = jnp.linalg.cholesky(whole * scale[:, None] * scale[None] + _JITTER * jnp.eye(size - 1))
    inverse = jax.scipy.linalg.solve_triangular(factor, jnp.diag(scale), lower=True)
    spread = inverse.T @ inverse
    right = gram[:-1, -1] - prior * logs.centre
    beta = spread @ right
    beta = beta + spread @ (right - whole @ beta)
    residual, at = jnp.append(beta, -1.0), beta + logs.centre
    logdet = 2 * jnp.sum(jnp.log(jnp.diag(factor))) - 2 * jnp.sum(jnp.log(scale))
    square = residual @ gram @ residual + prior @ at**2
    # derivatives by the weights
    held = jnp.zeros((size, size)).at[:-1, :-1].set(spread) + jnp.outer(residual, residual)
    by_weight = jnp.concatenate([flat @ held.ravel(), (jnp.diag(spread) + at**2) @ logs.member])
    outer = jnp.append(by_weight, 1.0)
    # derivatives of M by θ: windows for the noise, diagonals for the groups
    noise = LAGS + 1
    bends = jnp.concatenate([bends, -2 * gram[None]])  # σ: G ∝ 1/σ²
    diagonals = logs.member * jnp.diag(slope[pairs:-1, noise:])[None]
    slopes = jnp.concatenate([(bends @ residual)[:, :-1], (diagonals * at[:, None]).T]).T
    by_std = -2 * (jnp.eye(size - 1) - spread * prior[None])
    moved = jnp.concatenate(
        [spread @ bends[:LAGS, :-1, :-1], by_std[None], spread[None] * diagonals.T[:, None, :]]
    )
    traces = jnp.einsum("sij,tji->st", moved, moved)
    curve = jnp.tensordot(outer, bent, 1) - traces - 2 * slopes.T @ spread @ slopes
    value = terms[-1] + logdet + square
    return Solved(
        value=0.5 * value,
        gradient=0.5 * outer @ slope,
        hessian=0.5 * curve,
        likelihood=value - _penalty(theta, logs),
        beta=beta,
        spread=spread,
        moments=_moments(theta, logs, by_weight),
    )


def _moments(
    theta: Float[Array, " p"], logs: Compressed, by_weight: Float[Array, " w"]
) -> Float[Array, " p"]:
    """Return θ after one step of expectation and maximisation.

    The noise by Yule and Walker from the expected lag products of the noise; each τ² from the
    expected squares of its coefficients, with two squares of its usual scale.
    """
    products = by_weight[: LAGS + 1] / logs.rows
    half = jnp.concatenate([products[:1], 0.5 * products[1:]])
    places = np.abs(np.subtract.outer(np.arange(LAGS + 1), np.arange(LAGS + 1)))
    factor = jnp.linalg.cholesky(half[places])
    inverse = jax.scipy.linalg.solve_triangular(factor, jnp.eye(LAGS + 1), lower=True)
    partial = jnp.clip(-inverse[1:, 0] / jnp.diag(inverse)[1:], -0.97, 0.97)
    count = jnp.sum(jnp.asarray(logs.member) > 0, axis=0) * jnp.asarray(logs.on)
    squares = by_weight[len(FIRST) :] + 2 * logs.usual**2
    tau = jnp.where(logs.on > 0, 0.5 * jnp.log(squares / (count + 2)), jnp.log(logs.usual))
    return jnp.concatenate([jnp.arctanh(partial), -jnp.log(inverse[-1:, -1]), tau])


class Normal(eqx.Module):
    """Normal equations M β̂ = b at θ, with their factor.

    - `factor`: lower L with S M S = L Lᵀ, S = diag(`scale`); `half`: L⁻¹ S b.
    - `quadratic`: yᵀ Σ⁻¹ y + cᵀ D c, of which β̂ explains `half`².
    """

    scale: Float[Array, " columns"]
    factor: Float[Array, "columns columns"]
    half: Float[Array, " columns"]
    quadratic: Float[Array, ""]

    def solved(self, half: Float[Array, " columns"]) -> Float[Array, " columns"]:
        """Return S L⁻ᵀ `half`: β̂ for `half`, and a draw from N(0, M⁻¹) for standard normals."""
        back = jax.scipy.linalg.solve_triangular(self.factor, half, lower=True, trans="T")
        return self.scale * back

    @property
    def spread(self) -> Float[Array, "columns columns"]:
        """Covariance M⁻¹ of the coefficients."""
        half = jax.scipy.linalg.solve_triangular(self.factor, jnp.diag(self.scale), lower=True)
        return half.T @ half


def normal(theta: Float[Array, " p"], logs: Compressed) -> Normal:
    """Return the normal equations of the coefficients given θ."""
    gram = jnp.tensordot(weights(theta, logs.on)[: len(FIRST)], logs.windows, 1)
    prior = logs.precision + logs.member @ (logs.on * jnp.exp(-2 * theta[LAGS + 1 :]))
    whole = gram[:-1, :-1] + jnp.diag(prior)
    scale = 1 / jnp.sqrt(jnp.diag(whole))
    size = len(prior)
    factor = jnp.linalg.cholesky(whole * scale[:, None] * scale[None] + _JITTER * jnp.eye(size))
    right = scale * (gram[:-1, -1] - prior * logs.centre)
    half = jax.scipy.linalg.solve_triangular(factor, right, lower=True)
    return Normal(scale, factor, half, gram[-1, -1] + prior @ jnp.asarray(logs.centre) ** 2)


def log_density(
    theta: Float[Array, " p"], logs: Compressed, given: Normal | None = None
) -> Float[Array, ""]:
    """Return the log density of θ with all coefficients integrated out, up to a constant.

    `given`: the normal equations at θ, if they are known.
    """
    one = normal(theta, logs) if given is None else given
    logdet = 2 * jnp.sum(jnp.log(jnp.diag(one.factor))) - 2 * jnp.sum(jnp.log(one.scale))
    explicit = _explicit(theta, logs) + _penalty(theta, logs)
    return -0.5 * (explicit + logdet + one.quadratic - one.half @ one.half)
