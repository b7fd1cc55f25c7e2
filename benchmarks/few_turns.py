"""Do intervals hold on two to five turns, where noise remembers up to half a turn?

    python -m benchmarks.few_turns [--rigs 60] [--turns 2,3,5] [--seed 0] [--only drive]

Rigs with known truth run back and forth at two speeds, or one way from rest to rest. The noise is a
sum of white noise and of Ornstein–Uhlenbeck noise with a memory of 0.06, 0.25 or 0.5 turns of the
driving shaft. The ratio of a drive is up to 0.3 % off, that of a gear pair is exact. Half of the
rigs have one order above the first; all other higher orders are absent. Every claim of the fit is
held against the truth: a determined number by its interval, an amplitude that is not significant by
[0, upper95]. The width is stated over that of an oracle, which is told the noise, the terms of the
rig, delay and slope among them, and the linear relation. A phantom is a significant order that the
rig does not have, not even within one cycle over the log; a blow-up is a significant amplitude that
exceeds the truth by more than five standard deviations of the noise.
Writes results/few_turns.json.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter
from scipy.stats import binomtest

import vttig_jax
from vttig_jax.base.errors import LogError, NoAnswerError
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.pair.gear_pair import Drive, Eccentricities, Gear, GearPair

from .environment import write

RATE_HZ = 500.0
MEMORIES = (0.06, 0.25, 0.5)  # turns of the driving shaft
DRIVES = ("17/33", "3/8", "33/17", "12/5")
PAIRS = ((60, 35), (45, 80), (35, 60), (70, 30))
NOISE = {"drive": 0.03 * DEG, "pair": 0.003 * DEG}
"""Standard deviation of the noise with memory, rad; white noise has a fifth of it a sample."""

PRESENT = 5.0  # amplitude of the order above the first, in standard deviations of the noise
BLOW_UP = 5.0  # excess of an amplitude, in standard deviations of the noise
Rows = Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Log of a rig with its truths.

    **Arguments**
    - `pair`, `log`: gear pair or drive, and its log.
    - `truth`: name of a parameter → value; "gap" is that over the covered angles, degrees.
    - `oracle`: name → standard error of the oracle in the same unit.
    - `order`: (shaft, order) of the order above the first, None for none.
    - `amplitudes`: (shaft, order) → amplitude of the orders that the rig has, larger flank, rad.
    - `noise`: standard deviation of the noise that remembers, rad.
    """

    pair: Drive | GearPair
    log: EncoderLog
    truth: dict[str, float]
    oracle: dict[str, float]
    order: tuple[str, int] | None
    amplitudes: dict[tuple[str, float], float]
    noise: float


@dataclass
class Tally:
    """Counts of one case: claims and widths by name, and what must not happen."""

    held: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    widths: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    asked: int = 0
    refused: int = 0
    phantoms: int = 0
    blow_ups: int = 0
    present: int = 0
    seen: int = 0

    def record(self) -> dict[str, Any]:
        """Counts and shares for the JSON file."""
        every = [hit for hits in self.held.values() for hit in hits]
        interval = binomtest(sum(every), max(len(every), 1)).proportion_ci(0.95, "exact")
        widths = [one for several in self.widths.values() for one in several]
        return {
            "rigs": self.asked,
            "refused": self.refused,
            "claims": len(every),
            "held": sum(every) / max(len(every), 1),
            "held_low95": float(interval.low),
            "held_high95": float(interval.high),
            "by_name": {name: [sum(hits), len(hits)] for name, hits in self.held.items()},
            "width_over_oracle": float(np.median(widths)) if widths else None,
            "width_by_name": {name: float(np.median(w)) for name, w in self.widths.items()},
            "phantoms": self.phantoms,
            "blow_ups": self.blow_ups,
            "orders_present": self.present,
            "orders_found": self.seen,
        }


def motion(turns: float, *, both_ways: bool) -> tuple[Rows, Rows]:
    """Return times in s and driving angles in rad; `turns` are covered by each flank."""
    knots = [0, 0.4, 0.7, 5.3, 5.6, 6.0] + ([6.2, 6.5, 11.3, 11.6, 12.0] if both_ways else [])
    speeds = [0, 0, 1, 1, 0, 0] + ([0, -1, -1, 0, 0] if both_ways else [])
    time = np.arange(0, knots[-1], 1 / RATE_HZ)
    speed = np.interp(time, knots, speeds) * np.where((time % 5.8) > 2.9, 0.6, 1.0)
    speed = np.convolve(speed, np.ones(100) / 100, "same")
    angle = np.cumsum(speed)
    return time, angle * turns * REV / np.ptp(angle)


def memory(rng: np.random.Generator, count: int, correlation: float, std: float) -> Rows:
    """Ornstein–Uhlenbeck noise from its stationary start; `correlation` is in samples."""
    rho = np.exp(-1 / correlation)
    steps = rng.normal(size=count) * std
    steps[1:] *= np.sqrt(1 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], steps))


def sines(angle: Rows) -> Float[np.ndarray, "n 2"]:
    """Sine and cosine columns: (x, y) of amplitude and phase is a sin(angle + phase)."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def design(pair: Drive | GearPair, curve: tuple[Rows, Rows, Rows], *, both_ways: bool):
    """Return parameter names and the columns of the oracle.

    `curve` holds the driving angle, its speed in rad/s, and the flank, 1 for B and 0 for A.
    """
    angle, speed, side = curve
    ratio = float(pair.ratio)
    shafts = {"driving": sines(angle), "driven": sines(ratio * angle)}
    names, columns = ["offset"], [np.ones_like(angle)]
    if both_ways:
        names, columns = [*names, "gap", "delay"], [*columns, side, -ratio * speed]
    if isinstance(pair, Drive):
        names, columns = [*names, "slope"], [*columns, ratio * angle]
        for kind, weight in {"": 1.0, "_difference": side - 0.5}.items():
            if kind == "" or both_ways:
                for shaft, pairs in shafts.items():
                    names += [f"{shaft}_x{kind}", f"{shaft}_y{kind}"]
                    columns += list(pairs.T * weight)
        return names, np.stack(columns, axis=1)
    unit = 1e-3
    for shaft in shafts:
        for axis, phase in (("x", 0.0), ("y", 90.0)):
            given = {f"{shaft}_mm": unit, f"{shaft}_phase_deg": phase}
            model = exact_model(pair, Eccentricities(**_ECCENTRICITIES | given))
            flat = exact_model(pair, Eccentricities(**_ECCENTRICITIES))
            columns.append(_te(model, angle, side) / unit - _te(flat, angle, side) / unit)
            names.append(f"{shaft}_{axis}")
    if both_ways:
        for shaft, gain in (("driving", -ratio), ("driven", 1.0)):
            columns += list(gain * shafts[shaft].T)
            names += [f"{shaft}_encoder_x", f"{shaft}_encoder_y"]
    return names, np.stack(columns, axis=1)


_ECCENTRICITIES: dict[str, Any] = {
    "driving_mm": 0.0,
    "driving_phase_deg": 0.0,
    "driven_mm": 0.0,
    "driven_phase_deg": 0.0,
    "constant_backlash_deg": 0.0,
}


def _te(model, angle: Rows, side: Rows) -> Rows:
    return np.where(
        side > 0,
        np.asarray(model.transmission_error(angle, "B")),
        np.asarray(model.transmission_error(angle, "A")),
    )


def drawn(kind: str, turns: float, rng: np.random.Generator, *, both_ways: bool) -> Rig:
    """Draw a rig and its log."""
    noise, remembered = NOISE[kind], float(rng.choice(MEMORIES))
    time, angle = motion(turns, both_ways=both_ways)
    side = (np.gradient(angle) < -1e-9).astype(float)
    if both_ways:
        side[time > 6.0] = 1.0
    pair = _pair(kind, rng)
    ratio = float(pair.ratio)
    speed = np.gradient(angle, time)
    names, columns = design(pair, (angle, speed, side), both_ways=both_ways)
    value = dict.fromkeys(names, 0.0)
    sizes = {"drive": 10 * noise, "encoder": 18 * ARCSEC, "pair": 0.03}
    polar = {"drive": ("", "_difference"), "pair": ("", "_encoder")}[kind]
    for shaft in ("driving", "driven"):
        for part in polar:
            if f"{shaft}_x{part}" not in value and f"{shaft}{part}_x" not in value:
                continue
            size = sizes["encoder" if part == "_encoder" else kind]
            length = rng.uniform(0, size) * (0.3 if part == "_difference" else 1.0)
            phase = rng.uniform(0, REV)
            for axis, share in (("x", np.cos(phase)), ("y", np.sin(phase))):
                place = f"{shaft}_{axis}{part}" if kind == "drive" else f"{shaft}{part}_{axis}"
                value[place] = length * share
    if both_ways:
        value["gap"] = rng.uniform(5, 12) * noise
    if kind == "drive":
        value["slope"] = rng.uniform(-0.003, 0.003)
    error = columns @ np.array([value[name] for name in names])
    order = _extra(pair, turns, rng)
    amplitudes: dict[tuple[str, float], float] = {}
    if order is not None:
        shaft_angle = angle * (ratio if order[0] == "driven" else 1.0)
        error = error + PRESENT * noise * np.sin(order[1] * shaft_angle + rng.uniform(0, REV))
        amplitudes[order] = PRESENT * noise
    a_turn = (5.8 if both_ways else 5.0) / turns * RATE_HZ
    white = noise / 5
    error = error + memory(rng, len(time), remembered * a_turn, noise)
    error = error + rng.normal(size=len(time)) * white
    driven = ratio * angle + error
    log = EncoderLog.from_arrays(time, angle / DEG, driven / DEG, pair=pair, unit="deg")
    moving = np.abs(np.gradient(angle)) > 0.3 * np.abs(np.gradient(angle)).max()
    oracle = _oracle(
        (time, angle, speed, side),
        common=_common(log),
        moving=moving,
        pair=pair,
        noise=(remembered * a_turn / RATE_HZ, noise, white),
        value=value,
        both_ways=both_ways,
    )
    truth = oracle[0] | _first_orders(pair, value, both_ways, amplitudes)
    return Rig(pair, log, truth, oracle[1], order, amplitudes, noise)


def _pair(kind: str, rng: np.random.Generator) -> Drive | GearPair:
    if kind == "drive":
        return Drive(Fraction(str(rng.choice(DRIVES))), name="drive")
    driving, driven = PAIRS[rng.integers(len(PAIRS))]
    return GearPair(
        Gear(driving, 3.0, 3.0, 20.0),
        Gear(driven, 3.0, 3.0, 20.0),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=float(driving + driven) + 0.12,
        name="pair",
    )


def _extra(pair: Drive | GearPair, turns: float, rng) -> tuple[str, int] | None:
    """Draw the order above the first, one that is two cycles from every first order."""
    ratio = float(pair.ratio)
    choices = [
        (shaft, order)
        for shaft, cycles in (("driving", 1.0), ("driven", ratio))
        for order in range(2, 7)
        if min(abs(order * cycles - 1), abs(order * cycles - ratio)) * turns > 2
        and order * cycles < 6
    ]
    if rng.random() < 0.5 or not choices:
        return None
    return choices[rng.integers(len(choices))]


def _oracle(curve, *, common, moving, pair, noise, value, both_ways):
    """Return truths and standard errors of generalised least squares with the true covariance."""
    time, angle, speed, side = curve
    size = 20  # samples a row
    blocks = [k for k in range(0, len(time) - size, size) if moving[k : k + size].all()]
    mean = lambda v: np.array([v[k : k + size].mean(axis=0) for k in blocks])  # noqa: E731
    names, columns = design(pair, (angle, speed, side), both_ways=both_ways)
    t, x = mean(time), mean(columns)
    correlation_s, std, white = noise
    covariance = std**2 * np.exp(-np.abs(np.subtract.outer(t, t)) / correlation_s)
    covariance += np.eye(len(t)) * white**2 / size
    p = np.linalg.inv(x.T @ np.linalg.solve(covariance, x))
    truth, std_of = {}, {}
    truth_vector = np.array([value[name] for name in names])
    if both_ways:
        both = [
            design(pair, (common, 0 * common, 0 * common + s), both_ways=True)[1] for s in (0, 1)
        ]
        functional = (both[1] - both[0]).mean(axis=0)
        truth["gap"] = float(functional @ truth_vector) / DEG
        std_of["gap"] = float(np.sqrt(functional @ p @ functional)) / DEG
        place = names.index("gap")
        truth["constant_backlash_deg"] = value["gap"] / DEG
        std_of["constant_backlash_deg"] = float(np.sqrt(p[place, place])) / DEG
    for name, (first, second, scale) in _polar_names(pair, both_ways).items():
        at = [names.index(first), names.index(second)]
        offset = truth_vector[at]
        truth[name] = float(np.hypot(*offset)) / scale
        along = offset / np.hypot(*offset)
        std_of[name] = float(np.sqrt(along @ p[np.ix_(at, at)] @ along)) / scale
    return truth, std_of


def _common(log: EncoderLog) -> Rows:
    """Return the driving angles that the segments of both flanks cover, as the fit counts them."""
    cells: dict[str, list[Rows]] = {"A": [np.zeros(0)], "B": [np.zeros(0)]}
    for segment in assigned_segments(log).segments:
        angle = log.driving_angle[segment.start : segment.stop] / DEG
        cells[segment.flank].append(np.arange(np.floor(angle.min()), np.ceil(angle.max())))
    forth, back = (np.concatenate(own) for own in cells.values())
    return (np.intersect1d(forth, back) + 0.5) * DEG


def _polar_names(pair: Drive | GearPair, both_ways: bool) -> dict[str, tuple[str, str, float]]:
    """Return parameter → its two Cartesian columns, and internal units per unit."""
    found: dict[str, tuple[str, str, float]] = {}
    for shaft in ("driving", "driven"):
        if isinstance(pair, Drive):
            found[f"{shaft}_amplitude_arcsec"] = (f"{shaft}_x", f"{shaft}_y", ARCSEC)
            continue
        found[f"{shaft}_eccentricity_mm"] = (f"{shaft}_x", f"{shaft}_y", 1.0)
        if both_ways:
            sources = (f"{shaft}_encoder_x", f"{shaft}_encoder_y")
            found[f"{shaft}_encoder_arcsec"] = (*sources, ARCSEC)
    return found


def _first_orders(pair, value, both_ways, amplitudes) -> dict[str, float]:
    """Enter bounds of the first orders of the flanks into `amplitudes`; return no truths."""
    for shaft in ("driving", "driven"):
        parts = [v for k, v in value.items() if k.startswith(f"{shaft}_")]
        gain = 1.0 if isinstance(pair, Drive) else 3 / 70.0  # rad/mm, at most
        amplitudes[shaft, 1] = gain * float(np.linalg.norm(parts)) * 1.5
    return {}


def judge(rig: Rig, tally: Tally) -> None:
    """Fit the log and count."""
    tally.asked += 1
    try:
        fit = vttig_jax.fit(rig.log, rig.pair)
    except (NoAnswerError, LogError):
        tally.refused += 1
        return
    claims = {name: (p.value, p.low95, p.high95) for name, p in fit.parameters.items()}
    found = fit.checks.gap_over_angles_covered
    if found is not None:
        claims["gap"] = (found.value, found.low95, found.high95)
    for name, truth in rig.truth.items():
        value, low, high = claims.get(name, (None, None, None))
        if value is None or low is None or high is None:
            continue
        tally.held[name].append(low <= truth <= high)
        if value > 0 and low > 0:
            tally.widths[name].append((high - low) / (2 * 1.96 * rig.oracle[name]))
    higher = [o for o in fit.orders if o.significant and o.order > 1]
    tally.phantoms += sum(not _stands_for(o, rig) for o in higher)
    excess = [
        o.amplitude_arcsec * ARCSEC - rig.amplitudes.get((o.shaft, o.order), 0.0)
        for o in fit.orders
        if o.significant and not _stands_for(o, rig)
    ]
    tally.blow_ups += max(excess, default=0.0) > BLOW_UP * rig.noise
    if rig.order is not None:
        tally.present += 1
        tally.seen += any(_stands_for(o, rig) for o in higher)


def _stands_for(order: Any, rig: Rig) -> bool:
    """Whether an order is that of the rig, or less than one cycle over the log from it."""
    if rig.order is None:
        return False
    ratio, turns = float(rig.pair.ratio), float(np.ptp(rig.log.driving_angle)) / REV
    cycles = [
        k * (ratio if s == "driven" else 1.0) for s, k in ((order.shaft, order.order), rig.order)
    ]
    return order.shaft != "mesh" and abs(cycles[0] - cycles[1]) * turns < 1


def cases(turns: Sequence[float], only: str) -> Iterator[tuple[str, str, float, bool]]:
    """Yield name, kind, turns and whether the rig runs both ways."""
    for kind in ("drive", "pair"):
        for both_ways in (True, False):
            for count in turns:
                name = f"{kind}, {'both ways' if both_ways else 'one way'}, {count:g} turns"
                if only in name:
                    yield name, kind, count, both_ways


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=60)
    parser.add_argument("--turns", default="2,3,5")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of the name of the cases to run")
    parser.add_argument("--out", default="few_turns.json", help="file in results/")
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    found: dict[str, Any] = {}
    turns = [float(part) for part in chosen.turns.split(",")]
    for name, kind, count, both_ways in cases(turns, chosen.only):
        tally = Tally()
        for rig in range(chosen.rigs):
            rng = np.random.default_rng([chosen.seed, rig, *name.encode()])
            judge(drawn(kind, count, rng, both_ways=both_ways), tally)
        found[name] = tally.record()
        write(chosen.out, {"options": vars(chosen), "cases": found})
        print(name, found[name], flush=True)


if __name__ == "__main__":
    main()
