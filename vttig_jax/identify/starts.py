"""Start angles of logs without a common zero: where the orders of both logs coincide.

Logs whose starts are told share their orders: amplitudes are those of all, phases of the first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.errors import LogError
from ..base.numerics.polar_spread import polar_spread
from ..base.units import ARCSEC, DEG, REV
from ..logs.encoder_log import EncoderLog
from ..model.columns import GAP, Column, ColumnName
from ..model.density import LAGS, normal
from ..model.functionals import Posterior
from ..model.mixed_fit import MixedFit
from ..model.rows import SHAFTS, UNTOLD, Extra, RowName, Rows, S, Shafts, Start, Wave
from .orders import CLEAR, order_rows
from .records import Disagreement, LogRecord, LogStart

OWN = Start(spread=(np.inf, np.inf))
"""Start of a log that shares no order with the first one."""

_ANGLES = np.linspace(0.0, REV, 1441)[:-1]
_SETTLED, _MOST_FITS = 0.3, 3
_SHARE = 0.2
"""First orders that differ by more than a fifth, beyond chance, are those of two rigs (chosen)."""


@dataclass(frozen=True, eq=False)
class Turns(Extra):
    """Derivatives of logs by their start angles, whose columns belong to the model.

    The harmonic C cos ψ + S sin ψ with ψ = n₁(φ₁ + a₁) + n₂(φ₂ + a₂) has the derivatives
    n (S cos ψ − C sin ψ) by a₁ and a₂. Only harmonics that a log shares count.

    **Arguments**
    - `waves`: harmonic → S and C of both flanks (mean and difference), rad.
    """

    waves: dict[Wave, Float[np.ndarray, "2 2"]]

    @classmethod
    def of(cls, fit: MixedFit) -> "Turns":
        """Return the derivatives at the harmonics that a fit has for its first log."""
        index, found = fit.posterior.problem.index, fit.posterior.coefficients
        both = (False, True) if GAP in index else (False,)
        waves = {}
        for wave in fit.waves:
            rows = wave.row("sin"), wave.row("cos")
            places = [[index[ColumnName(row, 0, differs)] for differs in both] for row in rows]
            waves[wave] = found[np.array(places)]
        return cls(waves)

    def with_derivatives(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns."""
        slopes = np.zeros((2, len(rows.table)))
        s = np.where(rows.flank == "A", S["A"], S["B"])
        sides = np.stack([np.ones(len(rows.table)), s])
        for wave, series in self.waves.items():
            if shafts.start.tells(wave):
                sine, cosine = series @ sides[: series.shape[1]]
                cos, sin = (rows.column(wave.row(part)) for part in ("cos", "sin"))
                slopes += np.outer((wave.driving, wave.driven), sine * cos - cosine * sin)
        names = [RowName("start", shaft) for shaft in SHAFTS]
        return rows.with_columns(dict(zip(names, slopes, strict=True)))


def start_of(fit: MixedFit, log: int) -> Start:
    """Return the start of a log after the steps of a fit."""
    start, posterior = fit.shafts[log].start, fit.posterior
    angles, spread = list(start.angles), list(start.spread)
    for place, shaft in enumerate(SHAFTS):
        if (name := ColumnName(RowName("start", shaft), log)) in posterior.problem.index:
            step = posterior.one(posterior.row(name))
            angles[place] += step.value
            spread[place] = step.std
    return Start((angles[0], angles[1]), (spread[0], spread[1]))


def alone(fit: MixedFit) -> MixedFit:
    """Return a fit whose logs have harmonics of their own, at the noise and widths of `fit`."""
    posterior, logs = fit.posterior, range(len(fit.rows))
    columns: list[Column] = []
    for column in posterior.problem.columns:
        of_wave = column.row.part is not None
        columns += [replace(column, logs=(log,)) for log in logs] if of_wave else [column]
    problem = posterior.problem.of(tuple(columns), fit.rows, fit.weights, fit.delay_s)
    theta = posterior.theta.copy()
    theta[LAGS:] += np.log(posterior.problem.unit / problem.unit)
    given = normal(jnp.asarray(theta), problem.compressed)
    at = replace(posterior.at, beta=given.solved(given.half), spread=given.spread)
    return replace(fit, posterior=Posterior(problem, theta, at))


def with_starts(
    core: MixedFit, fit: Callable[[Sequence[Shafts], Turns, MixedFit], MixedFit]
) -> tuple[MixedFit, Turns | None]:
    """Return the fit in which the logs share the orders whose phases their starts tell.

    A start is not linear: its derivative is a column, and the fit is repeated until the steps are
    small. Logs whose first orders contradict those of the first log keep their own. `fit` is a
    function of the logs with their starts, the derivatives and the fit before.
    """
    starts = [one.start for one in core.shafts]
    own = {log for log, start in enumerate(starts) if start == OWN}
    for log in own and own - {one.log - 1 for one in disagreements(core)}:
        starts[log] = _start(core, log)
    if all(start in (OWN, Start()) for start in starts):
        return core, None
    turns = None
    for _ in range(_MOST_FITS):
        turns = Turns.of(core)
        shafts = zip(core.shafts, starts, strict=True)
        core = fit([replace(one, start=start) for one, start in shafts], turns, core)
        last, starts = starts, [start_of(core, log) for log in range(len(starts))]
        steps = [
            abs(new - old) < _SETTLED * std
            for one, two in zip(starts, last, strict=True)
            for new, old, std in zip(one.angles, two.angles, one.spread, strict=True)
            if std
        ]
        if all(steps):
            break
    return core, turns


def disagreements(core: MixedFit) -> Iterator[Disagreement]:
    """Yield first orders of a log that differ from those of the first log, beyond chance.

    Logs of one zero are compared in amplitude and phase, those with zeros of their own in amplitude
    only. A log that shares its orders by its start has been compared before.
    """
    one_zero = len(core.shafts) > 1 and not any(any(one.start.spread) for one in core.shafts)
    core = alone(core) if one_zero else core
    index = core.posterior.problem.index
    for log in range(1, len(core.shafts)):
        for wave in core.waves:
            if not wave.is_first or ColumnName(wave.row("cos"), log) not in index:
                continue
            for flank in core.scope.flanks:
                rows = np.concatenate([order_rows(core, wave, flank, k) for k in (0, log)])
                mean, covariance = core.posterior.given_noise(rows / ARCSEC, moved=True)
                first, this = (
                    polar_spread(mean[own], covariance[own, own])[:2]
                    for own in (slice(0, 2), slice(2, 4))
                )
                if one_zero:
                    apart = np.hstack([-np.eye(2), np.eye(2)])
                    off, std, *_ = polar_spread(apart @ mean, apart @ covariance @ apart.T)
                else:
                    off, std = abs(this[0] - first[0]), float(np.hypot(this[1], first[1]))
                if off > CLEAR * std:
                    yield Disagreement(log + 1, wave.shaft, flank, first[0], this[0], off, std)


def require_one_rig(core: MixedFit, sources: Sequence[str]) -> None:
    """Raise `LogError` if first orders of the logs are those of two rigs."""
    for one in disagreements(core):
        if one.difference_arcsec > _SHARE * max(one.first_arcsec, one.this_arcsec):
            raise LogError(
                f"{one.sentence(sources[0])}; these are not logs of one rig, or not with the same"
                " zero: fit them one by one.",
                where=sources[one.log - 1],
            )


def log_records(core: MixedFit, logs: Sequence[EncoderLog]) -> tuple[LogRecord, ...]:
    """Return the record of every log."""
    found = []
    for number, (log, rows) in enumerate(zip(logs, core.rows, strict=True)):
        size, zeros = rows.samples.shape[1], dict[str, int | float | None]()
        forward, backward = (size * int(np.sum(rows.flank == flank)) for flank in S)
        used = forward + backward
        samples = {"read": len(log), "used": used, "forward": forward, "backward": backward}
        samples["masked"] = len(log) - used
        for shaft, channel in zip(SHAFTS, (log.driving, log.driven), strict=True):
            zeros[shaft] = None
            if channel is not None:
                first = channel.reading[0].item()
                zeros[shaft] = channel.origin if log.zero == "start" else first
        start = _log_start(start_of(core, number))
        found.append(LogRecord(log.source, log.sha256, log.zero, start, zeros, samples))
    return tuple(found)


def _log_start(start: Start) -> LogStart:
    told: list[float | None] = []
    for angle, std in zip(start.angles, start.spread, strict=True):
        told += [angle / DEG % 360, std / DEG] if std < UNTOLD else [None, None]
    return LogStart(*told)


def _start(core: MixedFit, log: int) -> Start:
    """Return the start angles of a log relative to the first one.

    Order k has the coefficient z₁ in the first log and z₂ = z₁ exp(−j k a) in one that starts at
    the angle a. Their joint likelihood over a tells the start, if it is narrow.
    """
    angles, spread = [], []
    for shaft in SHAFTS:
        height = np.zeros(len(_ANGLES))
        for wave in core.waves:
            if wave.shaft != shaft:
                continue
            for flank in core.scope.flanks:
                rows = np.concatenate([order_rows(core, wave, flank, k) for k in (0, log)])
                mean, covariance = core.posterior.given_noise(rows, moved=True)
                first, other = (mean[k] + 1j * mean[k + 1] for k in (0, 2))
                variance = np.trace(covariance) / 2
                # The phase p of a sin(kφ + p) grows by k a where the angle starts at a.
                off = other - first * np.exp(1j * wave.order * _ANGLES)
                height -= 0.5 * np.abs(off) ** 2 / variance
        weight = np.exp(height - height.max())
        weight /= weight.sum()
        mean_angle = float(np.angle(np.sum(weight * np.exp(1j * _ANGLES))))
        off = np.mod(_ANGLES - mean_angle + REV / 2, REV) - REV / 2
        std = float(np.sqrt(np.sum(weight * off**2)))
        angles.append(mean_angle)
        spread.append(max(std, _ANGLES[1] / 2) if std < UNTOLD else np.inf)
    return Start((angles[0], angles[1]), (spread[0], spread[1]))
