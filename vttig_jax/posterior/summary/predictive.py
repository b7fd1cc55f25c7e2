"""Posterior predictive check: block means, residuals and reversal jumps of a log and of replicates.

A replicate is a log simulated from the model: the flank model of one draw with the autoregressive
noise of the same draw. Drift, wind-up, delay and the starts of further logs keep their fitted
values.

If the draws are wider than the noise model alone gives, the log has errors that the noise model
lacks, such as rounding that is constant in a run. The replicates then have such errors, too: the
deviation of another draw, as far as it exceeds the width of the noise model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.files.text_tables import key_values
from ...base.numerics.quantiles import NORMAL_95
from ...base.results import PlottedResult
from ...base.units import ARCSEC, DEG
from ...kinematics.flank_model import flank_index
from ...kinematics.harmonic import OrderModel, linearised_series
from ...kinematics.te_curve import TECurve
from .posterior import Posterior, flank_draws

_WINDOW = 10.0 * DEG
"""Largest range of driving angles next to a reversal in which both passes are compared, rad
(chosen)."""

_FEWEST_MEANS, _MOST_LAGS = 3, 40  # least block means in a window, most lags shown (chosen)
_DOUBTFUL_P = 0.01
"""p-value below which the report says that the model would hardly give this (chosen)."""

Runs = tuple[Float[np.ndarray, " _"], ...]
Draws = Float[np.ndarray, " replicates"]


@dataclass(frozen=True)
class Statistic:
    """Statistic of the log beside the same statistic of the replicates.

    **Arguments**
    - `measured`: value of the log; if it depends on the draw, its mean over the draws.
    - `predicted`, `low`, `high`: mean and 95 % interval of the replicates.
    - `p_value`: two-sided fraction of replicates at least as extreme as the log.
    """

    measured: float
    predicted: float
    low: float
    high: float
    p_value: float

    @classmethod
    def of(cls, replicated: Draws, measured: Draws | float) -> "Statistic":
        """Compare replicated values with the measured value, which may differ between draws."""
        low, high = np.quantile(replicated, [0.025, 0.975]).tolist()
        p_value = _p_value(replicated, measured)
        return cls(float(np.mean(measured)), float(replicated.mean()), low, high, p_value)

    def words(self, form: str, scale: float) -> str:
        """Return a text with the measured value, the interval of the replicates and a verdict.

        The format string `form` shows a value divided by `scale`, the size of its unit.
        """
        doubt = self.p_value < _DOUBTFUL_P
        verdict = "the model would hardly give this" if doubt else "as the model predicts"
        measured, low, high = (form.format(x / scale) for x in (self.measured, self.low, self.high))
        return f"{measured} (replicates {low} … {high}), {verdict} (p = {self.p_value:.2g})"

    def to_json(self, scale: float) -> dict:
        """Return the fields, divided by `scale`, the size of the unit in the JSON object."""
        return {
            "measured": self.measured / scale,
            "predicted": self.predicted / scale,
            "low95": self.low / scale,
            "high95": self.high / scale,
            "p": self.p_value,
        }


@dataclass(frozen=True)
class Jump:
    """Step of the transmission error at a reversal, flank B minus flank A, rad.

    `driving_angle`, rad, is the centre of the range of angles next to the reversal that both passes
    cover. `step` compares the means of the block means of both passes in this range.
    """

    driving_angle: float
    step: Statistic

    def __str__(self) -> str:
        return f"jump at {self.driving_angle / DEG:.1f}°: " + self.step.words("{:.5f}°", DEG)


@dataclass(frozen=True)
class Predictive(PlottedResult):
    """Log beside the predictions of its posterior.

    **Arguments**
    - `curves`: measured block means.
    - `centre`, `low`, `high`: centre and ends of their 95 % predictive interval, rad, run by run.
    - `inside`: fraction of the block means inside the interval.
    - `share`, `rms`: of the residual that each draw leaves, the fraction within 1.96 standard
      deviations of the noise of this draw, and the rms, rad.
    - `jumps`: steps at every reversal between passes that overlap.
    - `correlation`, `correlation_low`, `correlation_high`: autocorrelation of the residual at lags
      1, 2, … and its 95 % interval in the replicates, lag by lag.
    - `replicates`: number of replicates.
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
        """Number of lags at which the autocorrelation leaves its band; 5 % of them do by chance."""
        low, high = self.correlation_low, self.correlation_high
        return int(np.sum((self.correlation < low) | (self.correlation > high)))

    def to_json(self) -> dict:
        """Return the results as JSON values: angles in degrees, the rms residual in arcsec."""
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

    The p-values are Bayesian: fractions of replicates at least as extreme as the log (A. Gelman,
    X.-L. Meng, H. Stern, Statistica Sinica 6 (1996) 733). The log is used twice, for the posterior
    and for the comparison. If the model is right, the p-values are therefore rarely small, and only
    a small value is informative.

    **Arguments**
    - `posterior`: posterior whose fit holds the block means.
    - `replicates`: number of simulated logs, at least 40.
    - `seed`: seed of the choice of the draws and of the noise of the replicates.
    """
    if replicates < 40:
        raise ValueError(f"Argument `replicates` must be at least 40, but is {replicates}.")
    generator = np.random.default_rng(seed)
    picked = generator.integers(0, len(posterior.chosen), replicates)
    others = np.random.default_rng([seed, 1]).integers(0, len(posterior.chosen), replicates)
    filters, innovation, noise_std = posterior.noise(posterior.chosen[picked])
    curves, passes = posterior.fit.curves, _expected_passes(posterior, picked, others)
    centre = tuple(run.centre for run in passes)
    deviations = [c.transmission_error - middle for c, middle in zip(curves, centre, strict=True)]
    lags = max(1, min(_MOST_LAGS, *(len(curve) // 4 for curve in curves)))
    windows = _reversals(curves)
    numbers, correlations, steps = [], [], []
    for k in range(replicates):
        shifts = [run.basis @ run.deviations[:, k] for run in passes]
        settling = _settling(filters[k])
        noise = [_filtered(generator, filters[k], innovation[k], len(c), settling) for c in curves]
        noise = [own + run.basis @ run.errors[:, k] for own, run in zip(noise, passes, strict=True)]
        # Residual of the log under this draw, beside the noise of its replicate.
        residual = [run - move for run, move in zip(deviations, shifts, strict=True)]
        limit = NORMAL_95 * noise_std[k]
        numbers.append((_share(residual, limit), _share(noise, limit), _rms(residual), _rms(noise)))
        correlations.append((autocorrelation(residual, lags), autocorrelation(noise, lags)))
        replicate = [move + run for move, run in zip(shifts, noise, strict=True)]
        steps.append([window.step(replicate) for window in windows])
    share, share_made, rms, rms_made = np.array(numbers).T
    correlation, predicted = np.array(correlations).transpose(1, 0, 2)
    low, high = np.quantile(predicted, [0.025, 0.975], axis=0)
    size = np.sqrt(np.mean(noise_std**2))
    reach = tuple(NORMAL_95 * np.hypot(run.spread, size) for run in passes)
    within = [np.abs(run) <= half for run, half in zip(deviations, reach, strict=True)]
    return Predictive(
        posterior=posterior,
        curves=curves,
        centre=centre,
        low=tuple(middle - half for middle, half in zip(centre, reach, strict=True)),
        high=tuple(middle + half for middle, half in zip(centre, reach, strict=True)),
        inside=float(np.mean(np.concatenate(within))),
        share=Statistic.of(share_made, share),
        rms=Statistic.of(rms_made, rms),
        jumps=_jumps(windows, curves, centre, np.array(steps)),
        correlation=correlation.mean(axis=0),
        correlation_low=low,
        correlation_high=high,
        replicates=replicates,
    )


@dataclass(frozen=True)
class _Pass:
    """Expected block means of one run, rad: their centre, and their spread over all draws.

    `basis` @ `deviations` is the difference between the expectation of each replicate's draw and
    the centre. `basis` @ `errors` is the error of each replicate that its noise lacks.
    """

    centre: Float[np.ndarray, " n"]
    spread: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "n c"]
    deviations: Float[np.ndarray, "c replicates"]
    errors: Float[np.ndarray, "c replicates"]


def _expected_passes(
    posterior: Posterior,
    picked: Int[np.ndarray, " replicates"],
    others: Int[np.ndarray, " replicates"],
) -> list[_Pass]:
    """Return the expected block means of every run.

    `picked` are the draws of the replicates, `others` those from which they get further errors.
    The centre is the fitted run plus the difference of TE between the mean draw and the fit.
    """
    model, fit = flank_draws(posterior), posterior.fit
    lacking = np.sqrt(max(1.0 - posterior.widening**-2, 0.0))
    passes = []
    for curve, residual in zip(fit.curves, fit.residuals, strict=True):
        mean, basis = model.linearised(curve.driving_angle, curve.flank)
        fitted = _series_of(fit.model, curve)
        deviations = model.deviations(curve.flank)
        spread = np.sqrt(np.einsum("nc,cd,nd->n", basis, np.cov(deviations), basis, optimize=True))
        centre = curve.transmission_error - residual + mean - fitted
        errors = lacking * deviations[:, others]
        passes.append(_Pass(centre, spread, basis, deviations[:, picked], errors))
    return passes


def _series_of(model: OrderModel, curve: TECurve) -> Float[np.ndarray, " n"]:
    """Return the TE of a flank model, rad, at the driving angles and on the flank of a run."""
    side = flank_index(curve.flank)
    own = [np.asarray(part)[side] for part in (model.offset, model.cosine, model.sine)]
    return linearised_series(float(model.ratio), model.terms, own, curve.driving_angle)[0]


@dataclass(frozen=True)
class _Window:
    """Range of driving angles next to a reversal that the runs before and after it both cover.

    - `first`, `second`: indices of the runs before and after the reversal.
    - `before`, `after`: for each block mean of these two runs, whether it lies in the range.
    - `sign`: +1 if the run before is on flank A, −1 if it is on flank B.
    - `driving_angle`: middle of the range, rad.
    """

    first: int
    second: int
    before: Bool[np.ndarray, " n"]
    after: Bool[np.ndarray, " m"]
    sign: float
    driving_angle: float

    def step(self, runs: Sequence[Float[np.ndarray, " _"]]) -> float:
        """Return the mean on flank B minus the mean on flank A in the range.

        `runs` holds one array per run, with a value for each of its block means.
        """
        after, before = runs[self.second][self.after], runs[self.first][self.before]
        return self.sign * float(after.mean() - before.mean())


def _reversals(curves: tuple[TECurve, ...]) -> list[_Window]:
    """Return one window for every reversal between two runs on different flanks.

    The window has the driving angles that both runs cover next to the reversal, at most `_WINDOW`.
    """
    windows = []
    for k, (first, second) in enumerate(pairwise(curves)):
        if first.flank == second.flank or second.time[0] < first.time[-1]:
            continue
        low = max(first.driving_angle.min(), second.driving_angle.min())
        high = min(first.driving_angle.max(), second.driving_angle.max())
        if first.flank == "A":
            low = max(low, high - _WINDOW)
        else:
            high = min(high, low + _WINDOW)
        before, after = (
            (c.driving_angle >= low) & (c.driving_angle <= high) for c in (first, second)
        )
        if before.sum() >= _FEWEST_MEANS and after.sum() >= _FEWEST_MEANS:
            sign = 1.0 if first.flank == "A" else -1.0
            windows.append(
                _Window(
                    first=k,
                    second=k + 1,
                    before=before,
                    after=after,
                    sign=sign,
                    driving_angle=float(low + high) / 2,
                )
            )
    return windows


def _jumps(
    windows: list[_Window],
    curves: tuple[TECurve, ...],
    centre: Runs,
    steps: Float[np.ndarray, "replicates jumps"],
) -> tuple[Jump, ...]:
    jumps = []
    for k, window in enumerate(windows):
        replicated = window.step(centre) + steps[:, k]
        measured = window.step([curve.transmission_error for curve in curves])
        jumps.append(Jump(window.driving_angle, Statistic.of(replicated, measured)))
    return tuple(jumps)


def autoregressive(
    generator: np.random.Generator, filter_: Float[np.ndarray, " taps"], std: float, count: int
) -> Float[np.ndarray, " count"]:
    """Return `count` stationary noise values, which `filter_` whitens to innovations of `std`."""
    return _filtered(generator, filter_, std, count, _settling(filter_))


def _settling(filter_: Float[np.ndarray, " taps"]) -> int:
    """Return after how many samples a start value has decayed below 1e-4, at most 100 000."""
    slowest = float(np.abs(np.roots(filter_)).max(initial=0.0))
    return min(int(10 / max(1.0 - slowest, 1e-4)), 100_000)


def _filtered(
    generator: np.random.Generator,
    filter_: Float[np.ndarray, " taps"],
    std: float,
    count: int,
    settling: int,
) -> Float[np.ndarray, " count"]:
    from scipy.signal import lfilter  # slow to import

    noise = lfilter(np.ones(1), filter_, std * generator.standard_normal(count + settling))
    return np.asarray(noise)[settling:]


def autocorrelation(runs: list[Float[np.ndarray, " _"]], lags: int) -> Float[np.ndarray, " lags"]:
    """Return the autocorrelation at lags 1 … `lags`, from products inside runs, over all runs."""
    from scipy.fft import next_fast_len

    length = next_fast_len(max(len(run) for run in runs) + lags, real=True)
    spectra = (np.fft.rfft(run, length) for run in runs)
    power: Any = sum(spectrum.real**2 + spectrum.imag**2 for spectrum in spectra)
    products = np.fft.irfft(power, length)
    return products[1 : lags + 1] / products[0]


def _rms(runs: list[Float[np.ndarray, " _"]]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(runs) ** 2)))


def _share(runs: list[Float[np.ndarray, " _"]], reach: float) -> float:
    return float(np.mean(np.abs(np.concatenate(runs)) <= reach))


def _p_value(replicated: Draws, measured: Draws | float) -> float:
    """Return the two-sided fraction of replicates at least as extreme as the measured value.

    `measured` may differ between replicates. The fraction is never exactly zero.
    """
    above = (np.sum(replicated >= measured) + 0.5) / (len(replicated) + 1)
    below = (np.sum(replicated <= measured) + 0.5) / (len(replicated) + 1)
    return float(min(1.0, 2 * min(above, below)))
