"""Does a fit say so when an order is missing from its model?

    python -m benchmarks.residual_check [--rigs 200] [--turns 7] [--seed 0]

Every rig is logged through the exact kinematics with noise and counts and fitted by
`vttig_jax.fit` with first orders and tooth mesh. An order that the fit does not model stands out by
10 of the standard errors that it has in a fit that models it, on one flank or on both with a phase
each. Flagged is what the fit itself tells: a line at the right cycles, or the Ljung–Box sentence.
What the fit does not flag is searched again in two other ways, and so are all logs without a
missing order. Writes results/residual_check.json.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from scipy.stats import binomtest

import vttig_jax
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig.imperfections import EncoderError, Noise, OrderError, Shaft
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_pair
from vttig_jax.rig.synthetic import SyntheticRig

from .environment import write

Case = Literal["none", "one_flank", "both_flanks"]
"""Where the missing order is; on both flanks it has a phase on each."""

Place = tuple[Shaft, int]

PLACES: tuple[Place, ...] = tuple(
    (shaft, order) for shaft in ("driving", "driven") for order in range(2, 6)
)
"""Orders that may be missing."""

HEIGHT = 10.0
"""Standard errors."""

MODELLED = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=1)
_REFERENCES = 2


@dataclass(frozen=True)
class Seen:
    """What one fit says.

    **Arguments**
    - `line`, `any_line`: a line at the right cycles, or anywhere.
    - `ljung_box`: the sentence on the residual's memory.
    - `apart_deg`: phase on flank B less phase on flank A.
    """

    case: Case
    shaft: str
    order: int
    line: bool
    any_line: bool
    ljung_box: bool
    apart_deg: float | None

    @property
    def flagged(self) -> bool:
        """A line at the right cycles, or the sentence on the residual's memory."""
        return self.line or self.ljung_box


def random_rig(generator: np.random.Generator, turns: float) -> SyntheticRig:
    """Eccentricities flat in a disc of 0.03 mm, encoder errors in one of 18″, mesh of 0.003°."""
    sizes, phases = np.sqrt(generator.uniform(size=4)), generator.uniform(0, 360, 6)
    first, second = (
        EncoderError(18.0 * float(size), float(phase))
        for size, phase in zip(sizes[2:], phases[2:4], strict=True)
    )
    return SyntheticRig(
        pair=paper_pair(),
        eccentricities=Eccentricities(
            0.03 * float(sizes[0]),
            float(phases[0]),
            0.03 * float(sizes[1]),
            float(phases[1]),
            float(generator.uniform(0.065, 0.12)),
        ),
        motion=PassMotion(reversal_deg=360.0 * turns, dwell_s=0.3),
        orders=(
            OrderError("mesh", 1, "A", 0.003, float(phases[4])),
            OrderError("mesh", 1, "B", 0.003, float(phases[5])),
        ),
        driving_encoder=first,
        driven_encoder=second,
        noise=Noise(0.002, 0.00475),
    )


def missing(
    shaft: Shaft, order: int, case: Case, amplitude_deg: float, generator: np.random.Generator
) -> tuple[OrderError, ...]:
    """The order that the fit leaves out."""
    first, second = (float(phase) for phase in generator.uniform(0, 360, 2))
    side = "A" if generator.random() < 0.5 else "B"
    phases = {
        "none": {},
        "one_flank": {side: first},
        "both_flanks": {"A": first, "B": second},
    }
    return tuple(
        OrderError(shaft, order, flank, amplitude_deg, phase)
        for flank, phase in phases[case].items()
    )


@cache
def standard_error_deg(shaft: Shaft, order: int, turns: float) -> float:
    """Standard error of the amplitude of this order on one flank where it is fitted, rms."""
    options = HarmonicOrders(
        driving_orders=(1, order) if shaft == "driving" else (1,),
        driven_orders=(1, order) if shaft == "driven" else (1,),
        mesh_orders=1,
    )
    std = []
    for seed in range(_REFERENCES):
        generator = np.random.default_rng([seed, order, turns_key(turns)])
        rig = random_rig(generator, turns)
        rig = with_orders(rig, missing(shaft, order, "both_flanks", 0.001, generator))
        found = fit(rig.log(seed), rig.pair, orders=options)
        std += [o.std_arcsec for o in found.orders if (o.shaft, o.order) == (shaft, order)]
    return float(np.sqrt(np.mean(np.square(std)))) * ARCSEC / DEG


def turns_key(turns: float) -> int:
    """Of a random generator."""
    return round(1000 * turns)


def with_orders(rig: SyntheticRig, orders: tuple[OrderError, ...]) -> SyntheticRig:
    """The rig with more orders."""
    return replace(rig, orders=rig.orders + orders)


def cycles_of(shaft: str, order: int) -> float:
    """Cycles per driving revolution."""
    return order * (1.0 if shaft == "driving" else float(paper_pair().ratio))


def seen(result: Fit, case: Case, orders: Sequence[OrderError], place: Place, turns: float) -> Seen:
    """What the fit tells its user."""
    wanted = cycles_of(*place)
    lines = [line.cycles_per_rev for line in result.checks.lines]
    white = result.checks.whiteness

    def right(found: Sequence[float]) -> bool:
        near = [abs(cycles - wanted) * turns < 1 for cycles in found]
        return bool(near) if case == "none" else any(near)

    memory = white is not None and white.widening > 1
    phases = [order.phase_deg for order in orders]
    return Seen(
        case=case,
        shaft=place[0],
        order=place[1],
        line=right(lines),
        any_line=bool(lines),
        ljung_box=memory,
        apart_deg=(phases[1] - phases[0]) % 360.0 if len(phases) == 2 else None,
    )


def one_rig(number: int, turns: float, seed: int, cases: Sequence[Case]) -> list[Seen]:
    """One rig with one missing order in every case; the same log noise in all."""
    generator = np.random.default_rng([seed, number, 7])
    rig = random_rig(generator, turns)
    place = PLACES[number % len(PLACES)]
    amplitude = HEIGHT * standard_error_deg(*place, turns)
    found = []
    for case in cases:
        orders = missing(*place, case, amplitude, generator)
        log = with_orders(rig, orders).log(seed + number)
        result = fit(log, rig.pair, orders=MODELLED)
        found.append(seen(result, case, orders, place, turns))
    return found


def share(hits: Sequence[bool]) -> dict[str, float]:
    """Share with its 95 % interval of Clopper and Pearson."""
    count = sum(hits)
    interval = binomtest(count, len(hits)).proportion_ci(0.95, method="exact")
    return {
        "hits": count,
        "logs": len(hits),
        "share": count / len(hits),
        "low95": float(interval.low),
        "high95": float(interval.high),
    }


WAYS = ("flagged", "line", "ljung_box", "any_line")


def table(found: Sequence[Seen]) -> dict[str, Any]:
    """Shares of every case, all orders together and one by one."""
    record: dict[str, Any] = {}
    for case in get_args(Case):
        own = [one for one in found if one.case == case]
        if not own:
            continue
        record[case] = {way: share([getattr(one, way) for one in own]) for way in WAYS}
        if case != "none":
            record[case]["by_order"] = {
                f"{shaft} {order}": {
                    way: f"{sum(getattr(one, way) for one in group)}/{len(group)}" for way in WAYS
                }
                for shaft, order in PLACES
                if (group := [one for one in own if (one.shaft, one.order) == (shaft, order)])
            }
    return record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--turns", type=float, default=7.0)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    found: list[Seen] = []
    for number in range(chosen.rigs):
        found += one_rig(number, chosen.turns, chosen.seed, get_args(Case))
        if number % 20 == 19 or number + 1 == chosen.rigs:
            errors = {
                f"{shaft} {order}": 3600 * standard_error_deg(shaft, order, chosen.turns)
                for shaft, order in PLACES[: number + 1]
            }
            cases = table(found)
            write(
                "residual_check.json",
                {
                    "options": vars(chosen),
                    "standard_errors_arcsec": errors,
                    "cases": cases,
                    "logs": [asdict(one) for one in found],
                },
            )
            shares = {
                case: {way: round(own[way]["share"], 3) for way in WAYS}
                for case, own in cases.items()
            }
            print(number + 1, shares, flush=True)


if __name__ == "__main__":
    main()
