"""Would the posterior have made this log? Block means, residuals and jumps against replicates.

A replicate is a log the model could have given: the flank model of one draw with the autoregressive
noise of the same draw. What the fit found besides the flank model (drift, wind-up, delay, starts of
further logs) is taken as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG
from ...identify.report.parameters import NORMAL_95
from ...kinematics.te_curve import TECurve
from .posterior import Posterior, flank_draws

_WINDOW = 10.0 * DEG
"""Driving angle before a turn over which both passes are compared."""

_LEAST, _MOST_LAGS = 3, 40
_DOUBT = 0.01
"""p-value from which the words say that the model would not have made this."""

Runs = tuple[Float[np.ndarray, " _"], ...]
Draws = Float[np.ndarray, " replicates"]


@dataclass(frozen=True)
class Statistic:
    """A number of the log beside the same number of the replicates.

    **Arguments**
    - `measured`: of the log; where it depends on the draw, the mean over them.
    - `predicted`, `low`, `high`: mean and 95 % interval of the replicates.
    - `p_value`: share of replicates at least as far out, both sides.
    """

    measured: float
    predicted: float
    low: float
    high: float
    p_value: float

    @classmethod
    def of(cls, made: Draws, seen: Draws | float) -> "Statistic":
        """From the replicates, and from the log as seen by the draw of each of them."""
        low, high = np.quantile(made, [0.025, 0.975])
        return cls(
            float(np.mean(seen)), float(made.mean()), float(low), float(high), _p_value(made, seen)
        )

    def words(self, form: str, scale: float) -> str:
        """Measured and predicted in a unit of `scale`, and what to think of it."""
        doubt = self.p_value < _DOUBT
        verdict = "the model would hardly give this" if doubt else "as the model predicts"
        one, low, high = (form.format(x / scale) for x in (self.measured, self.low, self.high))
        return f"{one} (replicates {low} … {high}), {verdict} (p = {self.p_value:.2g})"

    def to_json(self, scale: float) -> dict:
        """All of it in a unit of `scale`."""
        return {
            "measured": self.measured / scale,
            "predicted": self.predicted / scale,
            "low95": self.low / scale,
            "high95": self.high / scale,
            "p": self.p_value,
        }


@dataclass(frozen=True)
class Jump:
    """Step of the transmission error at a reversal, flank B less flank A, rad.

    `driving_angle` is the middle of the window before the turn in which both passes are compared;
    the step is the difference of the means of the block means there.
    """

    driving_angle: float
    step: Statistic

    def __str__(self) -> str:
        return f"jump at {self.driving_angle / DEG:.1f}°: " + self.step.words("{:.5f}°", DEG)


@dataclass(frozen=True)
class Predictive:
    """A log beside what its posterior predicts.

    **Arguments**
    - `curves`: measured block means.
    - `centre`, `low`, `high`: of their 95 % predictive interval, rad, run by run.
    - `inside`: share of the block means inside.
    - `share`, `rms`: share within 1.96 noise std, and rms (rad), of what each draw leaves.
    - `jumps`: at every reversal between passes that overlap.
    - `correlation`, `correlation_low`, `correlation_high`: autocorrelation of the residual at lags
      1, 2, … and where 95 % of the replicates have it, lag by lag.
    - `replicates`: how many.
    """

    posterior: Posterior
    curves: tuple[TECurve, ...]
    centre: Runs
    low: Runs
    high: Runs
    inside: float
    share: Statistic
    rms: Statistic
    jumps: tuple[Jump, ...]
    correlation: Float[np.ndarray, " lags"]
    correlation_low: Float[np.ndarray, " lags"]
    correlation_high: Float[np.ndarray, " lags"]
    replicates: int

    @property
    def outside_lags(self) -> int:
        """Lags at which the autocorrelation leaves its band; 5 % of them do by chance."""
        low, high = self.correlation_low, self.correlation_high
        return int(np.sum((self.correlation < low) | (self.correlation > high)))

    def to_json(self) -> dict:
        """Shares, p-values and jumps, angles in degrees."""
        return {
            "replicates": self.replicates,
            "inside": self.inside,
            "share": self.share.to_json(1.0),
            "residual_rms_arcsec": self.rms.to_json(ARCSEC),
            "jumps": [
                {"driving_deg": jump.driving_angle / DEG, "step_deg": jump.step.to_json(DEG)}
                for jump in self.jumps
            ],
            "autocorrelation": {"lags": len(self.correlation), "outside": self.outside_lags},
        }

    def __str__(self) -> str:
        lags = f"{self.outside_lags} of {len(self.correlation)} lags outside their 95 % band"
        rows = [
            ("in the predictive interval", f"{100 * self.inside:.1f} % of the block means"),
            ("within 1.96 std of a draw", self.share.words("{:.1f} %", 0.01)),
            ("residual rms", self.rms.words("{:.3g}″", ARCSEC)),
            ("autocorrelation", lags),
            *(("reversal", str(jump)) for jump in self.jumps),
        ]
        return key_values(rows, title=f"posterior predictive, {self.replicates} replicates")


def predictive(posterior: Posterior, replicates: int = 500, seed: int = 0) -> Predictive:
    """Compare the block means of a log with logs that its posterior predicts.

    The p-values are Bayesian: shares of replicates that lie at least as far out as the log (A.
    Gelman, X.-L. Meng, H. Stern, Statistica Sinica 6 (1996) 733). They use the log twice, so values
    crowd at the middle when the model is right; only a small one speaks.

    **Arguments**
    - `posterior`: with the block means in its fit.
    - `replicates`: logs to draw, at least 40.
    - `seed`: of the noise of the replicates.
    """
    if replicates < 40:
        raise ValueError(f"Argument `replicates` must be at least 40, but is {replicates}.")
    generator = np.random.default_rng(seed)
    picked = generator.integers(0, len(posterior.chosen), replicates)
    filters, innovation, noise_std = posterior.noise(posterior.chosen[picked])
    curves, passes = posterior.fit.curves, _expected(posterior, picked)
    centre = tuple(one.centre for one in passes)
    seen = [c.transmission_error - middle for c, middle in zip(curves, centre, strict=True)]
    lags = max(1, min(_MOST_LAGS, *(len(curve) // 4 for curve in curves)))
    windows = _reversals(curves)
    numbers, correlations, steps = [], [], []
    for k in range(replicates):
        moves = [one.basis @ one.deviations[:, k] for one in passes]
        noise = [autoregressive(generator, filters[k], innovation[k], len(c)) for c in curves]
        # What the draw leaves of the log, beside what it left of the replicate it made.
        left = [one - move for one, move in zip(seen, moves, strict=True)]
        own = NORMAL_95 * noise_std[k]
        numbers.append((_share(left, own), _share(noise, own), _rms(left), _rms(noise)))
        correlations.append((autocorrelation(left, lags), autocorrelation(noise, lags)))
        made = [move + one for move, one in zip(moves, noise, strict=True)]
        steps.append([window.step(made) for window in windows])
    share, share_made, rms, rms_made = np.array(numbers).T
    of_log, of_made = np.array(correlations).transpose(1, 0, 2)
    low, high = np.quantile(of_made, [0.025, 0.975], axis=0)
    size = np.sqrt(np.mean(noise_std**2))
    reach = tuple(NORMAL_95 * np.hypot(one.spread, size) for one in passes)
    within = [np.abs(one) <= half for one, half in zip(seen, reach, strict=True)]
    return Predictive(
        posterior,
        curves,
        centre,
        tuple(middle - half for middle, half in zip(centre, reach, strict=True)),
        tuple(middle + half for middle, half in zip(centre, reach, strict=True)),
        float(np.mean(np.concatenate(within))),
        Statistic.of(share_made, share),
        Statistic.of(rms_made, rms),
        _jumps(windows, curves, centre, np.array(steps)),
        of_log.mean(axis=0),
        low,
        high,
        replicates,
    )


@dataclass(frozen=True)
class _Pass:
    """Expected block means of one run: centre, spread over draws, and how each draw moves it."""

    centre: Float[np.ndarray, " n"]
    spread: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "n c"]
    deviations: Float[np.ndarray, "c replicates"]


def _expected(posterior: Posterior, picked: Int[np.ndarray, " replicates"]) -> list[_Pass]:
    """The fitted runs, moved by what the mean of the draws differs from the fit."""
    model, fit = flank_draws(posterior), posterior.fit
    found = []
    for curve, residual in zip(fit.curves, fit.residuals, strict=True):
        mean, basis = model.linearised(curve.driving_angle, curve.flank)
        fitted = np.asarray(fit.model.transmission_error(curve.driving_angle, curve.flank))
        deviations = model.deviations(curve.flank)
        spread = np.sqrt(np.einsum("nc,cd,nd->n", basis, np.cov(deviations), basis, optimize=True))
        centre = curve.transmission_error - residual + mean - fitted
        found.append(_Pass(centre, spread, basis, deviations[:, picked]))
    return found


@dataclass(frozen=True)
class _Window:
    """Block means of both passes before a turn; `sign` makes the step flank B less flank A."""

    first: int
    second: int
    before: Bool[np.ndarray, " n"]
    after: Bool[np.ndarray, " m"]
    sign: float
    driving_angle: float

    def step(self, runs: Sequence[Float[np.ndarray, " _"]]) -> float:
        """Mean of flank B less mean of flank A, of runs like the curves."""
        after, before = runs[self.second][self.after], runs[self.first][self.before]
        return self.sign * float(after.mean() - before.mean())


def _reversals(curves: tuple[TECurve, ...]) -> list[_Window]:
    """Turns between runs that follow each other on different flanks over the same angles."""
    found = []
    for k, (one, other) in enumerate(pairwise(curves)):
        if one.flank == other.flank or other.time[0] < one.time[-1]:
            continue
        low = max(one.driving_angle.min(), other.driving_angle.min())
        high = min(one.driving_angle.max(), other.driving_angle.max())
        if one.flank == "A":
            low = max(low, high - _WINDOW)
        else:
            high = min(high, low + _WINDOW)
        before, after = ((c.driving_angle >= low) & (c.driving_angle <= high) for c in (one, other))
        if before.sum() >= _LEAST and after.sum() >= _LEAST:
            sign = 1.0 if one.flank == "A" else -1.0
            found.append(_Window(k, k + 1, before, after, sign, float(low + high) / 2))
    return found


def _jumps(
    windows: list[_Window],
    curves: tuple[TECurve, ...],
    centre: Runs,
    steps: Float[np.ndarray, "replicates jumps"],
) -> tuple[Jump, ...]:
    found = []
    for k, window in enumerate(windows):
        made = window.step(centre) + steps[:, k]
        measured = window.step([curve.transmission_error for curve in curves])
        found.append(Jump(window.driving_angle, Statistic.of(made, measured)))
    return tuple(found)


def autoregressive(
    generator: np.random.Generator, filter_: Float[np.ndarray, " taps"], std: float, count: int
) -> Float[np.ndarray, " count"]:
    """Stationary noise that this filter whitens to innovations of this std."""
    from scipy.signal import lfilter  # slow to import

    slowest = float(np.abs(np.roots(filter_)).max(initial=0.0))
    # Until the start is forgotten to 1e-4.
    warm_up = min(int(10 / max(1.0 - slowest, 1e-4)), 100_000)
    noise = lfilter(np.ones(1), filter_, std * generator.standard_normal(count + warm_up))
    return np.asarray(noise)[warm_up:]


def autocorrelation(runs: list[Float[np.ndarray, " _"]], lags: int) -> Float[np.ndarray, " lags"]:
    """Correlation at lags 1 … `lags` inside runs, all runs together."""
    square = sum(float(run @ run) for run in runs)
    products = [sum(float(run[lag:] @ run[:-lag]) for run in runs) for lag in range(1, lags + 1)]
    return np.array(products) / square


def _rms(runs: list[Float[np.ndarray, " _"]]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(runs) ** 2)))


def _share(runs: list[Float[np.ndarray, " _"]], reach: float) -> float:
    return float(np.mean(np.abs(np.concatenate(runs)) <= reach))


def _p_value(made: Draws, seen: Draws | float) -> float:
    """Share of replicates at least as far out, both sides, and never quite zero."""
    above = (np.sum(made >= seen) + 0.5) / (len(made) + 1)
    below = (np.sum(made <= seen) + 0.5) / (len(made) + 1)
    return float(min(1.0, 2 * min(above, below)))
