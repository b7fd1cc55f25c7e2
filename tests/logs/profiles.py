"""Motions and gear pairs made in NumPy for the tests of the logs; angles in degrees."""

import numpy as np

from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segments
from vttig_jax.pair.pair_file import parse_pair_spec
from vttig_jax.pair.schema import PairSpec

DEG = np.pi / 180


def spec(**log) -> PairSpec:
    """45/80 teeth, 90 000 counts on both shafts; `log` fills [log], `unit` fills [unit]."""
    unit = log.pop("unit", {})
    encoder = {"counts_per_rev": 90_000}
    encoders = [{**encoder, **log.pop(f"{shaft}_encoder", {})} for shaft in ("driving", "driven")]
    return parse_pair_spec(
        {
            "pair": {"module_mm": 2.0, "pressure_angle_deg": 20.0},
            "driving": {"teeth": 45, "encoder": encoders[0]},
            "driven": {"teeth": log.pop("driven_teeth", 80), "encoder": encoders[1]},
            "log": log,
            "unit": unit,
        }
    )


def played(lower: np.ndarray, gap: float | np.ndarray, start: float = 0.0) -> np.ndarray:
    """The driven angle by the play operator: it stays until `lower` or `lower` + `gap` moves it.

    It begins `start` above `lower`.
    """
    return _between(lower, lower + gap, lower[0] + start)


def _between(low: np.ndarray, high: np.ndarray, here: float) -> np.ndarray:
    driven = np.empty_like(low)
    for k, bounds in enumerate(zip(low, high, strict=True)):
        here = driven[k] = min(max(here, bounds[0]), bounds[1])
    return driven


def drive(ratio: str, **log) -> PairSpec:
    """A drive without gear geometry."""
    return parse_pair_spec({"drive": {"ratio": ratio}, "log": log})


def trapezoid(
    rate=1987.0, rpm=60.0, reversal=7560.0, ramp=0.5, dwell=2.0, passes=2, ripple=0.001, order=6
):
    """Time in s, driving angle in degrees and its steady mask: to and fro with ramps and dwell."""
    speed = 6 * rpm
    length = reversal / speed + ramp
    time = np.arange(int(passes * (length + dwell) * rate)) / rate
    index, inside = time // (length + dwell), np.minimum(time % (length + dwell), length)
    up, down = np.minimum(inside, ramp), np.minimum(length - inside, ramp)
    travelled = speed * (up**2 / (2 * ramp) + np.clip(inside - ramp, 0, length - 2 * ramp))
    travelled += np.where(inside > length - ramp, speed * (ramp**2 - down**2) / (2 * ramp), 0)
    angle = np.where(index % 2 == 0, travelled, reversal - travelled)
    angle += ripple / order / DEG * np.sin(order * angle * DEG)
    steady = (inside > ramp) & (inside < length - ramp)
    return time, angle, steady


def geared(angle, ratio=45 / 80, gap=0.04, first=0.02, driven=0.015, noise=0.0, seed=0):
    """Driven angle in degrees of a pair with play, and the sense whose flank is certain (±1, 0).

    On flank A TE = `first` sin(φ₁ + 0.3) + `driven` sin(φ₂ − 0.3), on B the signs of 0.3 change and
    `gap` is added.
    """

    def error(shift):
        wheel = ratio * angle * DEG
        return first * np.sin(angle * DEG + shift) + driven * np.sin(wheel - shift)

    low, high = ratio * angle + error(0.3), ratio * angle + error(-0.3) + gap
    reached = _between(low, high, low[0])
    flank = np.where(reached <= low, 1, np.where(reached >= high, -1, 0))
    return reached + noise * np.random.default_rng(seed).standard_normal(len(angle)), flank


def counts(angle, per_rev=90_000):
    """Whole counts passed at an angle in degrees."""
    return np.floor(angle * (per_rev / 360)).astype(np.int64)


def of_counts(time, driving, driven=None, pair=None, **columns) -> EncoderLog:
    """A log of the counts passed at angles in degrees; without a driven angle there is no error."""
    driven = 0.5625 * driving if driven is None else driven
    return EncoderLog.from_arrays(
        time, counts(driving), counts(driven), pair=pair or spec(), **columns
    )


def of_degrees(time, driving, driven, pair=None, **columns) -> EncoderLog:
    """A log of angles in degrees."""
    return EncoderLog.from_arrays(time, driving, driven, pair=pair or spec(), unit="deg", **columns)


def flanks(found: Segments) -> np.ndarray:
    """The flank of every sample: 1 on A, −1 on B, 0 where it is not certain."""
    state = np.zeros(found.read, int)
    for one in found.segments:
        assert not state[one.start : one.stop].any()
        state[one.start : one.stop] = 1 if one.flank == "A" else -1
    return state


def late(time, angle, seed=0, share=0.1):
    """`angle` with a share of readings 3 to 11 ms late, and which they are."""
    generator = np.random.default_rng(seed)
    which = generator.random(len(time)) < share
    back = np.interp(time - generator.uniform(0.003, 0.011, len(time)), time, angle)
    return np.where(which, back, angle), which
