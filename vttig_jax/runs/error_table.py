"""Transmission error of each measured flank over the driving angle, with bands from draws."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float

from ..base.angles import angles_over_turns_deg
from ..base.files.text_tables import key_values
from ..base.units import DEG
from ..identify.backlash import no_period, shift_of_delay
from ..identify.given import StoredModel
from ..identify.orders import exceeds_noise, is_fractional
from ..identify.result import Fit
from ..kinematics.flank_error import POINTS_PER_PERIOD, FlankError, errors_at, size_of
from ..kinematics.harmonic import OrderModel
from ..model.parameters import FULL_TURN
from ..model.rows import SHAFTS
from ..pair.gear_pair import Flank
from ..posterior.summary.bands import Band, streamed_band
from ..posterior.summary.gap_draws import GapDraws
from ..posterior.summary.posterior import Posterior, flank_draws, gap_draws


class FlankColumns(NamedTuple):
    """Transmission error of a flank at the rows of a table, rad of the driven gear.

    **Arguments**
    - `error`: values, shape (rows,). - `size`: peak-to-peak value and rms over the covered angles
      of the span.
    - `band`: bands of `error`. - `peaks`: for every draw its difference between the angles at which
      the mean of all draws is largest and smallest, and its own peak-to-peak value, which noise
      makes larger. Both are None without draws.
    """

    error: Float[np.ndarray, " rows"]
    size: FlankError
    band: Band | None = None
    peaks: Float[np.ndarray, "2 m"] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the sizes, °, and with draws the interval of the peak-to-peak value."""
        record = self.size.to_json()
        if self.band is None or self.peaks is None:
            return record
        (fixed, *_), (low, median, high) = np.quantile(self.peaks, [0.025, 0.5, 0.975], axis=1).T
        own = self.peaks[1]
        values = own.mean(), own.std(ddof=1), median, min(low, fixed), high
        names = ("mean", "std", "median", "low95", "high95")
        return record | {
            "peak_to_peak_draws_deg": {
                name: float(value) / DEG for name, value in zip(names, values, strict=True)
            },
            "probability": self.band.probability,
            "critical": self.band.critical,
        }


def error_table(
    fit: Fit,
    posterior: Posterior | None,
    step_deg: float,
    turns: float,
    probability: float = 0.95,
    out: Path | None = None,
) -> tuple[dict[str, Any], dict[str, np.ndarray], str]:
    """Return the transmission error of every measured flank: what makes a `RunTable`.

    There is a table also where the gap is unknown. Its columns are the driving angle, the flanks,
    then their bands. The mean of an error tells where the encoders read zero and nothing about the
    gears, and is taken off. If the log determines the gap, the mean of flank A is taken off both
    flanks, so that TE_B − TE_A is the backlash.

    **Arguments**
    - `fit`: fit of a run folder; the table has its orders, except the fractional ones.
    - `posterior`: its draws, which give the bands, or None.
    - `step_deg`, `turns`: step, °, and span, driving turns.
    - `probability`: probability of both bands. - `out`: path of the CSV file.

    **Raises** `UsageError` for a fit of a flank model whose code the run folder does not hold.
    """
    measured, zero_mean, model, draws = measured_error(fit, posterior)
    driving_deg = angles_over_turns_deg(step_deg, turns)
    angle = driving_deg * DEG
    # Between the rows there are further points where the rows do not resolve the highest order.
    split = math.ceil(step_deg / 360.0 * POINTS_PER_PERIOD * max(model.highest_order, 1.0))
    fine = (angle[:, None] + step_deg * DEG * np.arange(split) / split).ravel()
    flanks: dict[Flank, FlankColumns] = {}
    level: float | Float[np.ndarray, " m"] = 0.0
    for flank in measured:
        error = errors_at(model, flank, fine)
        orders = [one for one in fit.orders if one.flank == flank and not is_fractional(one)]
        seen = fit.coverage.holds(fine, flank)
        seen = seen if seen.any() else ~seen  # a log that covers nothing is judged at all angles
        own = turns * float(seen.mean())
        size = size_of(error[seen], own, significant=exceeds_noise(orders))
        if draws is None:
            level = error.mean() if flank in zero_mean else level
            flanks[flank] = FlankColumns(error[::split] - level, size)
            continue
        mean, peaks = _means_and_peaks(draws, fine, flank, seen)
        level = mean if flank in zero_mean else level
        curves = (block - level for block in draws.chunks(angle, flank))
        band = streamed_band(curves, probability)
        flanks[flank] = FlankColumns(band.centre, size, band, peaks)
    found = {f"te_{flank.lower()}_deg": one.error for flank, one in flanks.items()}
    for flank, one in flanks.items():
        for edge, values in one.band.edges.items() if one.band else ():
            found[f"te_{flank.lower()}_{edge}_deg"] = values
    columns = {"driving_deg": driving_deg, **{name: one / DEG for name, one in found.items()}}
    shift = None if zero_mean == tuple(flanks) else shift_of_delay(fit)
    record = {
        "schema": "vttig.map/1",
        "quantity": "error",
        **origin(fit),
        "hunting_turns": fit.pair.hunting_turns,
        "span_turns": turns,
        "step_deg": step_deg,
        "rows": len(driving_deg),
        "no_period": no_period(fit),
        "coverage": fit.coverage.to_json() | {"sentence": _covered(fit, flanks)},
        "zero_mean_flanks": list(zero_mean),
        "backlash_shift_deg": None if shift is None else [end / DEG for end in shift],
        "left_out": [order.to_json() for order in fit.orders if is_fractional(order)],
        "transmission_error": {flank: one.to_json() for flank, one in flanks.items()},
        "csv": None if out is None else out.name,
    }
    return record, columns, _text(fit, flanks, record)


def _covered(fit: Fit, flanks: Iterable[Flank]) -> str:
    """Return how much of the hunting period the log shows on these flanks."""
    turns, shares = fit.pair.hunting_turns, fit.coverage.to_json()["flank_shares"]
    covered = {flank: shares.get(flank, 0.0) * turns for flank in flanks}
    seen = [f"{own:.3g} of {turns} driving turns on flank {f}" for f, own in covered.items()]
    text = f"{'at least ' if fit.coverage.unplaced else ''}{', '.join(seen)}"
    if min(covered.values()) > turns * (1 - 1e-9):
        return text
    turned = fit.core.scope.turns
    short = " and the ".join(shaft for shaft in SHAFTS if turned[shaft] < FULL_TURN)
    assumed = f", and those of the {short} shaft are assumed to be zero" if short else ""
    return f"{text}; elsewhere the error is extrapolated by the fitted orders{assumed}"


def _text(fit: Fit, flanks: dict[Flank, FlankColumns], record: dict[str, Any]) -> str:
    """Return the report of an error table."""
    why, shift, turns = record["no_period"], record["backlash_shift_deg"], record["span_turns"]
    rows = [("hunting period", f"none: {why}" if why else fit.pair.hunting_period)]
    rows += [] if why else [("covered", record["coverage"]["sentence"])]
    rows.append(("span", f"{turns:.6g} driving turns in steps of {record['step_deg']:g}°"))
    if turns > 1 and not any(driven for _, driven in fit.model.terms):
        alike = "every driving turn is alike, because no order of the driven shaft is fitted"
        rows.append(("", f"{alike}; --span-rev 1 shows it all"))
    zero = " and ".join(f"mean of flank {flank}" for flank in record["zero_mean_flanks"])
    if len(record["zero_mean_flanks"]) < len(flanks):
        zero += "; flank B stands above flank A by the backlash"
    elif len(flanks) == 2:
        zero += "; the log does not determine the gap between them"
    if shift:
        zero += (
            "; a delay that the log leaves open shifts flank B by"
            f" {shift[0]:.5f}° … {shift[1]:+.5f}°"
        )
    rows.append(("zero of the error", zero))
    for flank, one in flanks.items():
        rows.append((f"flank {flank}", f"{one.size}, over {one.size.turns:.3g} driving turns"))
        if one.band is not None:
            peaks = record["transmission_error"][flank]["peak_to_peak_draws_deg"]
            span = f"{peaks['median']:.5f}° ({peaks['low95']:.5f}° … {peaks['high95']:.5f}°)"
            rows.append(("peak to peak of draws", f"{span}, 95 %"))
            rows += one.band.rows("curve")
    return key_values([*rows, *left_out_rows(fit)], title="transmission error")


def left_out_rows(fit: Fit) -> list[tuple[str, str]]:
    """Return what a report says of fitted orders without a fixed position on the gears."""
    left: dict[str, float] = {}
    for one in fit.orders:
        if is_fractional(one):
            name = f"{one.shaft} order {one.order}"
            left[name] = max(one.amplitude_arcsec, left.get(name, 0.0))
    if not left:
        return []
    names = ", ".join(f"{name} ({amplitude:.3g}″)" for name, amplitude in left.items())
    rms = math.sqrt(sum(amplitude**2 for amplitude in left.values()) / 2)
    return [("left out", f"{names}: no fixed position on the gears; they stay, {rms:.3g}″ rms")]


def measured_error(
    fit: Fit, posterior: Posterior | None = None
) -> tuple[tuple[Flank, ...], tuple[Flank, ...], OrderModel, GapDraws | None]:
    """Return the transmission error of a fit, or of its draws.

    **Returns** the measured flanks; those whose mean is taken off (A alone if the gap is known, so
    that TE_B − TE_A is the backlash); the fit, or the mean of its draws; and the draws, or None.

    **Raises** `UsageError` for a fit of a flank model whose code the run folder does not hold.
    """
    if isinstance(fit.given, StoredModel):
        fit.given.refuse(fit.source)
    flanks: tuple[Flank, ...] = tuple(one for one in get_args(Flank) if one in fit.flanks)
    has_gap = len(flanks) == 2 and fit.parameters["constant_backlash_deg"].determined
    zero_mean = flanks[:1] if has_gap else flanks
    if posterior is None:
        return flanks, zero_mean, fit.model, None
    draws = gap_draws(posterior) if has_gap else flank_draws(posterior)
    return flanks, zero_mean, draws.mean_model, draws


def _means_and_peaks(
    draws: GapDraws,
    angle: Float[np.ndarray, " n"],
    flank: Flank,
    seen: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "2 m"]]:
    """Return the mean of TE of every draw over driving angles, rad, and its `peaks` where `seen`.

    See `FlankColumns`.
    """
    total, low, high = 0.0, np.inf, -np.inf
    for block in draws.chunks(angle, flank):
        total = total + block.sum(axis=0)
    centre = errors_at(draws.mean_model, flank, angle[seen])
    ends = angle[seen][[centre.argmax(), centre.argmin()]]
    for block in draws.chunks(angle[seen], flank):
        low, high = np.minimum(low, block.min(axis=0)), np.maximum(high, block.max(axis=0))
    largest, smallest = draws.errors(ends, flank)
    return np.asarray(total / len(angle)), np.stack([largest - smallest, high - low])


def origin(fit: Fit) -> dict[str, Any]:
    """Return the keys of a record that say where its numbers come from."""
    return {
        "pair": fit.pair.name,
        "source": fit.source,
        "sha256": fit.sha256,
        "conditional_on": list(fit.conditional_on),
        "zero": fit.zero,
        "zero_readings": fit.zero_readings,
    }
