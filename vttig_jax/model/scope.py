"""What the logs of a fit cover: flanks, angles, turns and speeds that its numbers refer to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.units import DEG, REV
from ..logs.motion.segments import HIGHEST, tells_first_order
from ..pair.schema import Flank
from .rows import SHAFTS, Rows, S, Shafts, Wave


@dataclass(frozen=True, eq=False)
class Scope:
    """Flanks, angles, turns and speeds of a fit.

    **Arguments**
    - `flanks`: flanks with rows. - `ratio`: i.
    - `nominal`: slope and level (rad) of the driven over the driving angle of the first log, where
      the harmonics of the driven shaft are taken.
    - `levels`: value that was subtracted from the transmission error of each log, rad.
    - `turns`: shaft → turns on the flank that covers less, in the log that covers most.
    - `covered`: middle of every degree of φ₁ that both flanks covered, rad; of one flank, its own.
    - `speeds`: mean |ω₁| of the rows on each of `flanks`, rad/s.
    """

    flanks: tuple[Flank, ...]
    ratio: float
    nominal: tuple[float, float]
    levels: tuple[float, ...]
    turns: dict[str, float]
    covered: Float[np.ndarray, " cells"]
    speeds: tuple[float, ...]


def scope_of(shafts: Sequence[Shafts], rows: Sequence[Rows], waves: Sequence[Wave]) -> Scope:
    """Return the scope of logs with their rows.

    A part of a turn over which both flanks tell the first order from the others counts as a turn.

    The covered angles are those of the first log and of all logs that have its zero: a start angle
    does not tell the whole turns, and so not where the driven shaft stood.
    """
    flanks: tuple[Flank, ...] = tuple(
        flank for flank in S if any(flank in one.flanks for one in rows)
    )
    on: dict[Flank, set[int]] = {flank: set() for flank in flanks}
    turns = 0.0
    for one in shafts:
        travel: dict[Flank, list[float]] = {flank: [] for flank in flanks}
        for start, stop, flank in one.runs:
            angle = one.driving[start:stop]
            if flank in on:
                travel[flank] += [angle.min(), angle.max()]
                if not any(one.start.spread):
                    on[flank].update(np.unique(np.floor(angle / DEG).astype(int)).tolist())
        spans = [np.ptp(ends) for ends in travel.values() if ends]
        turns = max(turns, float(min(filter(None, spans), default=0.0)) / REV)
    ratio = shafts[0].ratio
    found = {"driving": turns, "driven": turns * abs(ratio)}
    # A shaft that turns may have orders that the model does not have; a table tells few anyway, and
    # its two first orders are in the model together, whose spread says how alike they are.
    still = all(one.still for one in shafts)
    others = [w for w in waves if w.shaft in SHAFTS and not (still and w.is_first)]
    own = [1.0] if still else np.arange(1.0, HIGHEST + 1).tolist()
    for shaft, gain in (("driving", 1.0), ("driven", abs(ratio))):
        orders = sorted({*own, *(float(f"{w.cycles(ratio) / gain:.9g}") for w in others)})
        on_flanks = [
            gain * np.concatenate([one.angle[one.flank == flank] for one in rows])
            for flank in flanks
        ]
        if found[shaft] < 1 and all(tells_first_order(angle, orders) for angle in on_flanks):
            found[shaft] = 1.0
    speed = np.concatenate([one.speed for one in rows])
    of_row = np.concatenate([one.flank for one in rows])
    return Scope(
        flanks=flanks,
        ratio=ratio,
        nominal=shafts[0].nominal,
        levels=tuple(one.level for one in shafts),
        turns=found,
        covered=(np.array(sorted(set.intersection(*on.values())), float) + 0.5) * DEG,
        speeds=tuple(float(speed[of_row == flank].mean()) for flank in flanks),
    )
