"""Accuracy of a drive in the terms of standards, from what the samples of a fit tell."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.files.text_tables import key_values, listed, text_table
from ..base.results import TextResult
from ..base.units import ARCSEC
from ..kinematics.accuracy import (
    AXIS,
    SINGLE_FLANK,
    axis_numbers,
    perfect_axis,
    single_flank_numbers,
)
from ..kinematics.flank_model import flank_index
from ..model.rows import S
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank
from .turn_averages import ENOUGH_TURNS, Measured

STATEMENT = "a pair in its machine, no master gear: not a conformity statement"

_PASSES, _TARGETS = 5, 8
"""Passes each way and targets in a turn that ISO 230-2 asks for."""

_POINTS, _MOST_POINTS = 16, 2**18
"""Points in a pitch, and in a period, at which curves are looked at (chosen)."""

_PERIODS, _ENDS = ("driving shaft", "driven shaft", "pair"), ("read", "value", "low95", "high95")


@dataclass(frozen=True, eq=False)
class Accuracy(TextResult):
    """Accuracy of a drive: the object of schema `vttig.accuracy/1`."""

    record: dict[str, Any]
    headers = ("number", "as read [″]", "value [″]", "95 % interval [″]", "beside")

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.accuracy/1`."""
        return self.record

    @property
    def rows(self) -> list[list[str]]:
        """Cells of the table under `headers`: single flank, then the axis."""
        single, axis = self.record["single_flank"], self.record["axis"]["numbers"] or {}
        name = "{0[period]}, flank {0[flank]}, {1}".format
        found = {name(row, key): row[key] for row in single for key in SINGLE_FLANK}
        found |= {f"axis, {key}": axis[key] for key in AXIS if axis}
        return [[name, *_cells(one)] for name, one in found.items() if one is not None]

    @property
    def remarks(self) -> list[str]:
        """What the numbers are, and what is not told."""
        record, axis = self.record, self.record["axis"]
        said = [f"Single flank: {record['definition']}"] if record["single_flank"] else []
        return [*said, *filter(None, [axis["definition"]]), *record["open"]]

    def __str__(self) -> str:
        head = key_values([("log", self.record["source"])], title="accuracy")
        table = text_table(self.rows, self.headers)
        return "\n\n".join([head, table, *listed("notes", self.remarks)])


def _cells(one: dict[str, Any]) -> list[str]:
    read, value, low, high = (f"{one[f'{k}_arcsec']:.4g}" for k in _ENDS)
    beside = "" if one["value_um"] is None else f"{one['value_um']:.3g} µm"
    if one["noise_arcsec"] is not None:
        beside = f"noise {one['noise_arcsec']:.3g}″, {100 * one['noise_share']:.0f} %"
    return [read, value, f"{low} … {high}", beside]


def accuracy_of(found: Measured | None, pair: GearPair | Drive, name: str) -> Accuracy:
    """Return the accuracy of a drive, from the log `name`; see `vttig_jax.kinematics.accuracy`.

    **Raises** `NoAnswerError` if neither a shaft made enough turns nor an axis enough passes, and
    for a fit of a given model or of an older version, which has no averages of turns.
    """
    if found is None:
        said = "the run keeps no averages of turns: an older version made it, or it is the fit of"
        raise NoAnswerError(f"{said} a given flank model; fit the log anew.", where=name)
    radius = float(pair.reference_radii[1]) if isinstance(pair, GearPair) else None
    single = [row for flank in S for row in _single_flank(pair, found, flank, radius)]
    axis, open_ = _axis(found)
    short = "Single flank: no shaft made {:g} turns while it ran, as an average needs."
    open_ += [] if len(found.harmonics) else [short.format(ENOUGH_TURNS)]
    if not single and not axis["numbers"]:
        raise NoAnswerError(" ".join(open_), where=name)
    head = {"schema": "vttig.accuracy/1", "source": name, "pair": pair.name}
    head |= {"statement": STATEMENT, "definition": _definition(pair, radius), "circle_mm": radius}
    return Accuracy(head | {"single_flank": single, "axis": axis, "open": open_})


def _definition(pair: Any, radius: float | None) -> str:
    text = (
        f"{STATEMENT}. F_is is the range of the transmission error averaged synchronously over the"
        " turns of a shaft; of the pair, of the sum of both averages over the hunting period."
    )
    return text + (
        " Without teeth there is no f_is."
        if radius is None
        else " f_is is the largest range within one pitch, of it all (1995) or without its long"
        " waves (2013), which are the short-wave part; f_l is the range of the long waves. Filter:"
        f" long waves are the harmonics below half a cycle in a pitch, {pair.driving.teeth / 2:g}"
        " cycles in a turn of the driving shaft. Lengths are arcs at the reference circle of the"
        f" driven gear, radius {radius:g} mm."
    )


def _single_flank(
    pair: GearPair | Drive, found: Measured, flank: Flank, radius: float | None
) -> Iterator[dict[str, Any]]:
    own = found.harmonics[found.harmonics[:, 0] == flank_index(flank)]
    ratio, hunting = abs(pair.ratio), pair.hunting_turns
    driving, driven = own[:, 1:3].T.astype(int)
    whole = np.where(driving > 0, driving * hunting, driven * ratio.numerator)
    teeth = (pair.driving.teeth, pair.driven.teeth) if isinstance(pair, GearPair) else (0, 0)
    told = np.append(found.turns >= ENOUGH_TURNS, np.all(found.turns >= ENOUGH_TURNS))
    counts = (driving, driven, whole), (*teeth, teeth[0] * hunting), told
    for name, cycles, pitches, enough in zip(_PERIODS, *counts, strict=True):
        parts = pitches or 1
        each = max(2 * int(cycles.max(initial=0)) // parts + 2, _POINTS)
        if enough and parts * each <= _MOST_POINTS and len(own):
            value, short = own[:, 3] + 1j * own[:, 4], whole >= (teeth[0] or np.inf) * hunting
            points = parts * (each + each % 2)
            terms = single_flank_numbers(value, own[:, 5], cycles, pitches, points, short)
            numbers = {k: _number(v, radius) for k, v in zip(SINGLE_FLANK, terms.T, strict=True)}
            yield {"flank": flank, "period": name, **numbers}


def _number(
    terms: Float[np.ndarray, "4"], radius: float | None = None, noise: float | None = None
) -> dict[str, Any] | None:
    """Return the object of a number as read, its value and interval, rad; None if undefined."""
    if np.isnan(terms).any():
        return None
    found = {f"{k}_arcsec": float(v) / ARCSEC for k, v in zip(_ENDS, terms, strict=True)}
    return found | {
        "value_um": None if radius is None else 1e3 * float(terms[1]) * radius,
        "noise_arcsec": None if noise is None else float(noise) / ARCSEC,
        "noise_share": None if noise is None else float(noise / max(terms[0], 1e-300)),
    }


def _axis(found: Measured) -> tuple[dict[str, Any], list[str]]:
    """Return the object `axis` of schema `vttig.accuracy/1`, and what is not told."""
    count = np.sum(np.isfinite(found.readings), axis=2)
    enough = np.all(count >= _PASSES, axis=1)
    wide = np.ptp(found.places[enough]) if enough.any() else np.inf
    full = enough.sum() >= max(3.0, _TARGETS * wide)
    used = enough if full else np.all(count >= 1, axis=1)
    record = {"numbers": None, "targets": int(used.sum()), "passes": 0, "definition": ""}
    if used.sum() < 3:
        return record, ["Axis: fewer than three targets were approached in both directions."]
    readings, count = found.readings[used], count[used]
    free, mean = np.maximum(count - 1, 0), np.nanmean(readings, axis=2)
    off = np.nansum((readings - mean[..., None]) ** 2, axis=2)
    if not full:  # one noise for all, of repeats if there are enough
        told = free.sum() >= _TARGETS
        noise = np.sqrt(off.sum() / free.sum()) if told else float(found.scatter)
        free, off = np.full(count.shape, 100), np.full(count.shape, 100 * noise**2)
    std = np.sqrt(off / free)
    terms = axis_numbers(mean, std, count, free)
    perfect = perfect_axis(count, free).mean(axis=0) * np.sqrt(np.mean(std**2))
    numbers = {k: _number(v, None, n) for k, v, n in zip(AXIS, terms.T, perfect, strict=True)}
    record |= {"numbers": numbers, "passes": int(count.min())}
    record["definition"] = (
        f"Axis, after ISO 230-2: {len(count)} targets of the driven shaft against the driving one,"
        f" at least {count.min()} passes in each direction, standard deviations with n − 1. The"
        " noise is what an axis without error would show with this scatter."
    )
    if full:
        return record, []
    record["numbers"] = numbers | {"R": None, "A": None}
    said = f"Axis: R and A need {_PASSES} passes each way at {_TARGETS} targets or more in a turn."
    return record, [said]
