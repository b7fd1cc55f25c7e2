"""What a reader should know beside the numbers of a plan."""

from ..identify.delay import Delay
from ..pair.gears import Drive, GearPair
from ..pair.spec import FitOptions
from .planned_counts import frozen_counts
from .planned_noise import PlannedNoise
from .planned_rows import PlannedRows
from .planned_run import PlannedRun


def conditions(
    pair: GearPair | Drive, rows: PlannedRows, delay: Delay, *, split: bool
) -> tuple[str, ...]:
    """What the standard errors take for granted, in the words of a fit."""
    found: tuple[str, ...] = () if isinstance(pair, Drive) or split else ("perfect_encoders",)
    if delay.state == "open" and not delay.forced and len(rows.scope.flanks) == 2:
        found += ("no_delay",)
    return found


def notes(
    pair: GearPair | Drive,
    run: PlannedRun,
    rows: PlannedRows,
    options: FitOptions,
    delay: Delay,
    noise: PlannedNoise,
) -> tuple[str, ...]:
    """Everything that will make the run worse than its numbers, and what was left out."""
    found = [*frozen_counts(pair, run.speeds_rpm, run.rate_hz), *_aliased(pair, run, options)]
    if rows.missed > 0:
        found.append(
            f"{rows.missed} of {run.each * len(run.speeds_rpm)} passes have no steady part that a"
            " fit would use: a speed below 1 % of the fastest counts as standstill, and a flank"
            " that turns less than once is left out"
        )
    if delay.state == "insignificant" and len(rows.scope.flanks) == 2:
        found.append(
            "a delay is taken as zero, and only the ramps that speed up can tell one; a fit that"
            " finds one knows the constant backlash far less well (see --delay free), unless there"
            " is a second speed"
        )
    if noise.std_deg > 0 and noise.correlation_s == 0:
        found.append(
            "noise is taken to be white; that of real rigs remembers, and then tells several times"
            " less: give its correlation time, which `vttig fit` prints for a log of the rig"
        )
    return (*found, *rows.scope.notes)


def _aliased(pair: GearPair | Drive, run: PlannedRun, options: FitOptions) -> list[str]:
    """Orders above half the sampling rate at the fastest speed."""
    turns_a_second = max(run.speeds_rpm) / 60
    teeth = 0 if isinstance(pair, Drive) else pair.driving.teeth
    mesh = tuple(k for k in range(1, options.mesh_orders + 1) if teeth)
    every = {
        "driving": (1.0, options.driving_orders),
        "driven": (float(pair.ratio), options.driven_orders),
        "mesh": (float(teeth), mesh),
    }
    found = []
    for name, (relative, orders) in every.items():
        above = [k for k in orders if k * relative * turns_a_second >= run.rate_hz / 2]
        if above:
            found.append(
                f"{name} orders {', '.join(map(str, above))} lie above half the sampling rate at"
                f" {max(run.speeds_rpm):g} rpm and alias; sample faster or take them out of [fit]"
            )
    return found
