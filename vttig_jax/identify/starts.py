"""Start angles of logs without a common zero: where the orders of both logs coincide."""

from collections.abc import Sequence

import numpy as np

from ..base.units import DEG, REV
from ..logs.channel.channel import Channel
from ..logs.encoder_log import EncoderLog
from ..model.mixed_fit import MixedFit
from ..model.parameters import SHAFTS, TOLD
from .orders import order_rows
from .records import LogRecord, LogStart

_ANGLES = np.linspace(0.0, REV, 1441)[:-1]
_UNIFORM = REV / np.sqrt(12.0)


def log_records(
    core: MixedFit, logs: Sequence[EncoderLog], *, one_zero: bool
) -> tuple[LogRecord, ...]:
    """Return the record of every log."""
    found = []
    for number, (log, rows) in enumerate(zip(logs, core.rows, strict=True)):
        size = rows.samples.shape[1]
        used = {side: size * int(np.sum(rows.flank * side < 0)) for side in (1, -1)}
        total = sum(used.values())
        found.append(
            LogRecord(
                source=log.source,
                sha256=log.sha256,
                zero=log.zero,
                start=LogStart(0.0, 0.0, 0.0, 0.0)
                if one_zero or not number
                else _start(core, number),
                zero_readings={
                    shaft: None if channel is None else _zero_reading(channel, log.zero)
                    for shaft, channel in (("driving", log.driving), ("driven", log.driven))
                },
                samples={
                    "read": len(log),
                    "used": total,
                    "forward": used[1],
                    "backward": used[-1],
                    "masked": len(log) - total,
                },
            )
        )
    return tuple(found)


def _zero_reading(channel: Channel, zero: str) -> int | float:
    return channel.origin if zero == "start" else channel.reading[0].item()


def _start(core: MixedFit, log: int) -> LogStart:
    """Return the start angles of a log relative to the first one.

    Order k has the coefficient z₁ in the first log and z₂ = z₁ exp(−j k a) in one that starts at
    the angle a. Their joint likelihood over a tells the start, if it is narrow.
    """
    told: list[float | None] = []
    for shaft in SHAFTS:
        height = np.zeros(len(_ANGLES))
        for wave in core.waves:
            if wave.shaft != shaft:
                continue
            for side in core.scope.flanks:
                rows = np.concatenate([order_rows(core, wave, side, k) for k in (0, log)])
                mean, covariance, _ = core.posterior.told(rows, moved=True)
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
        if std > TOLD * _UNIFORM:
            told += [None, None]
        else:
            told += [mean_angle / DEG % 360, max(std, _ANGLES[1] / 2) / DEG]
    return LogStart(*told)
