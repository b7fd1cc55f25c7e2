"""Inspection of a log before a fit, and its report."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..base.files.text_tables import key_values, text_table
from ..base.results import TextResult
from ..base.shown_text import shown_name
from ..base.threads import one_blas_thread
from ..base.units import ARCSEC, REV
from ..pair.schema import HarmonicOrders
from .checks.ratio import SeenRatio, seen_ratio
from .checks.sampling import (
    Aliased,
    Commensurate,
    OrderLine,
    Sampling,
    SpeedPlateau,
    aliased,
    commensurate,
    order_spectrum,
    plateaus_of,
    sampling_of,
)
from .checks.slip import find_slips, slips_text
from .encoder_log import EncoderLog
from .lines.search import Line, blind_lines
from .motion.flank_assignment import assigned_segments
from .motion.segments import Segments, Support, support_of
from .preview import ColumnReport, bullets, column_table, sampling_rows
from .recognition.request import TwoShafts
from .slope import computed_text, exact_slope

LOCKED = ("shaft", "speed_rpm", "counts_per_sample", "rounding_arcsec")
"""What JSON tells of counts that are locked to the clock."""


@dataclass(frozen=True)
class Inspection(TextResult):
    """Report on a log, printed by `print(inspection)` and stored by `to_json()`.

    The first `problems` of the notes report what spoils a fit: slips, and a computed column.
    """

    source: str
    sha256: str
    zero: str
    columns: tuple[ColumnReport, ...]
    sampling: Sampling
    ratio: SeenRatio
    segments: Segments
    plateaus: tuple[SpeedPlateau, ...]
    commensurate: tuple[Commensurate, ...]
    aliased: tuple[Aliased, ...]
    spectrum: tuple[OrderLine, ...]
    support: Support
    notes: tuple[str, ...]
    lines: tuple[Line, ...] = ()
    problems: int = 0
    fit_command: str = ""
    """Command that fits the log with the same columns and options; "" if a pair file was given."""

    def to_json(self) -> dict[str, Any]:
        """Return the report as an object of the schema `vttig.inspect/1`."""

        def stretches(found: Sequence[Any], what: str) -> list[dict[str, Any]]:
            told = ((one, {what: getattr(one, what)}) for one in found)
            return [
                {"start": one.start, "stop": one.stop, **kind, "speed_rpm": 60 * one.speed / REV}
                for one, kind in told
            ]

        ratio = self.ratio
        return {
            "schema": "vttig.inspect/1",
            "source": self.source,
            "sha256": self.sha256 or None,
            "zero": self.zero,
            "samples": {
                kind: getattr(self.segments, kind)
                for kind in ("read", "forward", "backward", "masked")
            },
            "columns": [asdict(column) for column in self.columns],
            "sampling": asdict(self.sampling),
            "ratio": {"given": str(ratio.given)}
            | {name: getattr(ratio, name) for name in ("seen", "std", "verdict", "sentence")},
            "motion": stretches(self.segments.motion, "kind"),
            "segments": stretches(self.segments.segments, "flank"),
            "plateaus": [asdict(plateau) for plateau in self.plateaus],
            "commensurate": [
                {name: getattr(one, name) for name in LOCKED} for one in self.commensurate
            ],
            "aliased": [asdict(finding) for finding in self.aliased],
            "spectrum": [asdict(line) for line in self.spectrum],
            "lines": [asdict(line) for line in self.lines],
            "support": asdict(self.support),
            **({"fit_command": self.fit_command} if self.fit_command else {}),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        segments = self.segments
        parts = [
            f"{shown_name(self.source)}\n",
            column_table(self.columns),
            key_values(
                [
                    *sampling_rows(self.sampling, segments.read),
                    ("angle zero", "first sample" if self.zero == "start" else "reading zero"),
                    ("ratio", self.ratio.short),
                ]
            ),
            key_values(
                [
                    ("flank A (forward)", f"{segments.forward} samples"),
                    ("flank B (backward)", f"{segments.backward} samples"),
                    ("masked", f"{segments.masked} samples (ramps, dwell, gap crossing)"),
                ],
                title="what a fit can use",
            ),
            *_motion_tables(self),
            _spectrum_table(self),
            _lines(self),
            bullets("note", _remarks(self)),
            f"to fit it:\n  {self.fit_command}" if self.fit_command else "",
        ]
        return "\n\n".join(part.rstrip() for part in parts if part)


@one_blas_thread
def inspect_log(log: EncoderLog, pair: TwoShafts | None = None) -> Inspection:
    """Inspect a validated log with all checks; no finding raises an error.

    **Arguments**
    - `pair`: source of the fit orders and tooth counts for the test of aliasing; without it the
      default orders without tooth mesh are tested.
    """
    segments = assigned_segments(log)
    sampling = sampling_of(log.time)
    fit = HarmonicOrders() if pair is None else pair.fit
    orders: dict[str, tuple[float, Sequence[int | float]]] = {
        "driving": (1.0, fit.driving_orders),
        "driven": (float(log.ratio), fit.driven_orders),
    }
    if pair is not None and pair.driving.teeth is not None:
        orders["mesh"] = (float(pair.driving.teeth), range(1, fit.mesh_orders + 1))
    plateaus = plateaus_of(segments.segments)
    spectrum, spectrum_notes = order_spectrum(log, segments.segments)
    slips = find_slips(log, segments)
    problems = (slips_text(slips),) if slips else ()
    computed = exact_slope(log.driving_angle, log.driven_angle)
    if computed is not None:
        cure = "name the measured columns with --column driving=NAME and --column driven=NAME"
        problems = (*problems, f"{computed_text(computed)}; {cure}")
    return Inspection(
        source=log.source,
        sha256=log.sha256,
        zero=log.zero,
        columns=_columns(log),
        sampling=sampling,
        ratio=seen_ratio(log),
        segments=segments,
        plateaus=plateaus,
        commensurate=() if segments.still else commensurate(log, segments.segments),
        aliased=aliased(plateaus, sampling.rate_hz, orders),
        spectrum=spectrum,
        support=support_of(log, segments.segments),
        notes=(*problems, *segments.notes, *log.notes, *spectrum_notes),
        problems=len(problems),
        lines=blind_lines(log, segments.segments),
    )


def _columns(log: EncoderLog) -> tuple[ColumnReport, ...]:
    names, shafts = log.place.columns, {"driving": log.driving, "driven": log.driven}
    reports = [
        ColumnReport(
            role=role,
            name=names.get(role, role),
            unit=channel.unit,
            low=float(channel.reading.min()),
            high=float(channel.reading.max()),
            resolution_arcsec=channel.resolution / ARCSEC or None,
            turns=channel.turns,
            modulus=channel.modulus,
            wraps=channel.wraps,
        )
        for role, channel in shafts.items()
        if channel is not None
    ]
    others = {
        "time": ("s", log.time if "time" in names else None),
        "transmission_error": ("arcsec", None if log.error is None else log.error / ARCSEC),
        "direction": (None, log.direction),
        "axial_mm": ("mm", log.axial_mm),
        "torque": (None, log.torque),
        "speed": ("rad/s", log.speed),
        "acceleration": ("rad/s²", log.acceleration),
    }
    for role, (unit, values) in others.items():
        if values is not None:
            low, high = float(np.min(values)), float(np.max(values))
            reports.append(ColumnReport(role, names.get(role, role), unit, low, high))
    return tuple(sorted(reports, key=lambda one: one.role != "time"))


MOST_LINES = 12
"""Largest number of rows of a table of the report (chosen)."""


def _motion_tables(report: "Inspection") -> list[str]:
    """Return the tables of the motion and of the steady speeds; none of readings at standstill."""
    if report.segments.still:
        return []
    motion, steady = report.segments.motion, report.plateaus
    rows = [(m.kind, str(m.start), str(m.stop), f"{60 * m.speed / REV:.4g}") for m in motion]
    found = [text_table(_first(rows), ["motion", "from sample", "to", ("mean speed", "rpm")])]
    rows = [(p.flank, f"{p.speed_rpm:.5g}", str(p.segments), str(p.samples)) for p in steady]
    heads = ["flank", ("mean driving speed", "rpm"), "segments", "samples"]
    return [*found, text_table(_first(rows), heads)] if rows else found


def _first(rows: list[tuple[str, str, str, str]]) -> list[tuple[str, str, str, str]]:
    """Return the first `MOST_LINES` rows of a table, and how many more there are."""
    more = (f"and {len(rows) - MOST_LINES} more", "", "", "")
    return [*rows[:MOST_LINES], *[more] * (len(rows) > MOST_LINES)]


def _spectrum_table(report: "Inspection") -> str:
    cells: dict[tuple[str, int], dict[str, str]] = {}
    for line in report.spectrum:
        row = cells.setdefault((line.shaft, line.order), {})
        row[line.flank] = f"{line.amplitude_arcsec:.3g}"
    if not cells:
        return ""
    rows = [(f"{s} {k}", row.get("A"), row.get("B")) for (s, k), row in cells.items()]
    return text_table(rows, ["order", ("flank A", "″"), ("flank B", "″")])


def _lines(report: "Inspection") -> str:
    """Return the table of the lines of the blind search, with periods if the speed is steady."""
    if not report.lines:
        return ""
    speeds = [abs(plateau.speed_rpm) for plateau in report.plateaus]
    steady = 0 < max(speeds) <= 1.05 * min(speeds)
    rows = [
        (
            f"{line.cycles_per_rev:.5g}",
            f"{line.cycles_std:.1g}",
            f"{60 / (max(speeds) * line.cycles_per_rev):.4g}" if steady else None,
            f"{line.amplitude_arcsec:.3g}",
            f"{line.amplitude_std_arcsec:.1g}",
            f"{line.false_alarm:.1g}",
        )
        for line in report.lines
    ]
    head = [("line found blind", "cycles/rev"), ("std", "cycles/rev"), ("period", "s")]
    return text_table(rows, [*head, ("amplitude", "″"), ("std", "″"), "by chance"])


def _remarks(report: "Inspection") -> list[str]:
    """Return the sentences of the report: first problems that spoil a fit, then the other notes.

    The order of the problems is ratio, slip, computed column, sampling, coverage.
    """
    remarks = []
    ratio = report.ratio
    if ratio.verdict not in ("agrees", "none") or ratio.better or ratio.is_doubtful:
        remarks.append(ratio.sentence)
    remarks += report.notes[: report.problems]
    remarks += [plateau.sentence for plateau in report.commensurate]
    for alias in report.aliased:
        name = "tooth-mesh" if alias.shaft == "mesh" else alias.shaft
        several = alias.order != alias.highest
        orders = f"orders {alias.order} to {alias.highest}" if several else f"order {alias.order}"
        remarks.append(
            f"{name} {orders} of the fit lie above half the sampling rate at"
            f" {alias.speed_rpm:.4g} rpm and alias; sample faster or take them out of [fit]"
        )
    return [*remarks, *report.support.sentences, *report.notes[report.problems :]]
