"""What a log holds and what is wrong with it, before anything is fitted."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..base.threads import one_blas_thread
from ..base.units import ARCSEC, REV
from ..pair.spec import FitOptions
from .blind_lines import blind_lines
from .channel import Channel
from .encoder_log import EncoderLog
from .flank_evidence import assigned_segments
from .line_search import Line
from .ratio import SeenRatio, seen_ratio
from .sampling import (
    Aliased,
    Commensurate,
    Plateau,
    Sampling,
    aliased,
    commensurate,
    plateaus_of,
    sampling_of,
)
from .segments import Segments
from .shafts import TwoShafts
from .slip import find_slip
from .spectrum import OrderLine, order_spectrum
from .support import Support, support_of


@dataclass(frozen=True)
class ColumnReport:
    """One column of a log; `turns` and `resolution_arcsec` where its unit makes it an angle."""

    role: str | None
    name: str
    unit: str | None
    low: float
    high: float
    resolution_arcsec: float | None = None
    turns: float | None = None
    modulus: int | float | None = None
    wraps: int = 0


@dataclass(frozen=True)
class Inspection:
    """Report on a log. `print(inspection)` is meant to be read, `to_json()` to be kept."""

    source: str
    sha256: str
    zero: str
    columns: tuple[ColumnReport, ...]
    sampling: Sampling
    ratio: SeenRatio
    segments: Segments
    plateaus: tuple[Plateau, ...]
    commensurate: tuple[Commensurate, ...]
    aliased: tuple[Aliased, ...]
    spectrum: tuple[OrderLine, ...]
    support: Support
    notes: tuple[str, ...]
    lines: tuple[Line, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The report as `vttig.inspect/1`."""
        motion = [
            {"start": m.start, "stop": m.stop, "kind": m.kind, "speed_rpm": 60 * m.speed / REV}
            for m in self.segments.motion
        ]
        pieces = [
            {"start": s.start, "stop": s.stop, "flank": s.flank, "speed_rpm": 60 * s.speed / REV}
            for s in self.segments.segments
        ]
        ratio = self.ratio
        return {
            "schema": "vttig.inspect/1",
            "source": self.source,
            "sha256": self.sha256 or None,
            "zero": self.zero,
            "samples": {
                "read": self.segments.read,
                "forward": self.segments.forward,
                "backward": self.segments.backward,
                "masked": self.segments.masked,
            },
            "columns": [asdict(column) for column in self.columns],
            "sampling": asdict(self.sampling),
            "ratio": {
                "given": str(ratio.given),
                "seen": ratio.seen,
                "std": ratio.std,
                "verdict": ratio.verdict,
                "sentence": ratio.sentence,
            },
            "motion": motion,
            "segments": pieces,
            "plateaus": [asdict(plateau) for plateau in self.plateaus],
            "commensurate": [asdict(one) for one in self.commensurate],
            "aliased": [asdict(one) for one in self.aliased],
            "spectrum": [asdict(line) for line in self.spectrum],
            "lines": [asdict(line) for line in self.lines],
            "support": asdict(self.support),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        from .wording import inspection_text

        return inspection_text(self)


@one_blas_thread
def inspect_log(log: EncoderLog, pair: TwoShafts | None = None) -> Inspection:
    """Look at a log from all sides; raises nothing a validated log could cause.

    **Arguments**
    - `pair`: its fit orders and tooth counts decide which orders may alias; the default orders
      without tooth mesh where absent.
    """
    segments = assigned_segments(log)
    sampling = sampling_of(log.time)
    plateaus = plateaus_of(segments.segments)
    spectrum, lost = order_spectrum(log, segments.segments)
    slip = find_slip(log, segments)
    slipped = () if slip is None else (slip.sentence,)
    return Inspection(
        log.source,
        log.sha256,
        log.zero,
        _columns(log),
        sampling,
        seen_ratio(log),
        segments,
        plateaus,
        commensurate(log, segments.segments),
        aliased(plateaus, sampling.rate_hz, _fit_orders(log, pair)),
        spectrum,
        support_of(log, segments.segments),
        (*log.notes, *slipped, *segments.notes, *lost),
        blind_lines(log, segments.segments),
    )


def _fit_orders(log: EncoderLog, pair: TwoShafts | None) -> dict[str, tuple[float, list[int]]]:
    fit = FitOptions() if pair is None else pair.fit
    teeth = None if pair is None else pair.driving.teeth
    orders = {
        "driving": (1.0, list(fit.driving_orders)),
        "driven": (float(log.ratio), list(fit.driven_orders)),
    }
    if teeth is not None:
        orders["mesh"] = (float(teeth), list(range(1, fit.mesh_orders + 1)))
    return orders


def _columns(log: EncoderLog) -> tuple[ColumnReport, ...]:
    names = log.place.columns
    reports = []
    if "time" in names:
        low, high = float(log.time[0]), float(log.time[-1])
        reports.append(ColumnReport("time", names["time"], "s", low, high))
    reports.append(_channel("driving", names.get("driving", "driving"), log.driving))
    if log.driven is not None:
        reports.append(_channel("driven", names.get("driven", "driven"), log.driven))
    others = {
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
    return tuple(reports)


def _channel(role: str, name: str, channel: Channel) -> ColumnReport:
    return ColumnReport(
        role,
        name,
        channel.unit,
        float(channel.reading.min()),
        float(channel.reading.max()),
        channel.resolution / ARCSEC or None,
        channel.turns,
        channel.modulus,
        channel.wraps,
    )
