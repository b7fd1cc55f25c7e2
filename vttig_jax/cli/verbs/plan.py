"""`vttig plan`: predict the standard errors of a planned run before anything is measured."""

from pathlib import Path
from typing import Any, Literal, get_args

import click

from ...base.errors import UsageError
from ...logs.recognition.request import DriveRequest
from ..drive_options import pair_option, ratio_options
from ..fit_options import DelayParam
from ..options import POSITIVE, Finite, arguments_as_options, verb
from ..output import Output

DirectionName = Literal["both", "forward", "backward"]
NOT_NEGATIVE = Finite(min=0)


class Named(click.ParamType):
    """Option type of the form NAME=NUMBER."""

    name = "name=number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        """Return the name and the finite number, or report a usage error."""
        if isinstance(value, tuple):
            return value
        name, equals, number = value.partition("=")
        if not (name and equals):
            self.fail(f"{value!r} is not of the form name=number.", param, ctx)
        return name, Finite().convert(number, param, ctx)


@verb(
    "plan",
    example="""
vttig plan --ratio 64:23 --turns 21 --rate-hz 2000 --noise-std-deg 0.002
vttig plan --pair pair.toml --turns 21 --rate-hz 1987 --noise-std-deg 0.002
vttig plan --pair pair.toml --turns 21 --noise-std-deg 0.002 --speed-rpm 20 --speed-rpm 60
vttig plan --pair pair.toml --noise-std-deg 0.002 --want driving_eccentricity_mm=0.0001
""",
    groups={
        "The drive": ("ratio", "teeth", "counts", "pair"),
        "The run": ("turns", "speeds_rpm", "directions", "passes", "rate_hz", "dwell_s", "ramp_s"),
        "The noise": ("noise_std_deg", "noise_correlation_s", "white_std_deg"),
        "The fit": ("want", "assume", "perfect_encoders", "delay"),
    },
)
@pair_option
@ratio_options
@click.option(
    "--turns",
    type=POSITIVE,
    help="Of the driving shaft in every pass, ramps included; with --want the most to be spent,"
    " 1000 by default.",
)
@click.option(
    "--speed-rpm",
    "speeds_rpm",
    type=POSITIVE,
    multiple=True,
    help="Of the driving shaft, 60 by default; repeat it for passes at several speeds in one"
    " recording, which tell a delay.",
)
@click.option("--directions", type=click.Choice(get_args(DirectionName)), default="both")
@click.option("--passes", type=click.IntRange(min=1), help="At every speed; 2 for both directions.")
@click.option("--rate-hz", type=POSITIVE, help="Of sampling; that of the pair file by default.")
@click.option("--dwell-s", type=NOT_NEGATIVE, default=2.0, help="Standstill after every pass.")
@click.option("--ramp-s", type=NOT_NEGATIVE, default=0.5, help="From standstill to speed.")
@click.option(
    "--noise-std-deg",
    type=Finite(min=0, max=360),
    required=True,
    help="Noise of one sample of the transmission error, as `vttig fit -v` prints it for a log;"
    " counting is added from the pair.",
)
@click.option("--noise-correlation-s", type=NOT_NEGATIVE, default=0.0, help="Its memory.")
@click.option("--white-std-deg", type=NOT_NEGATIVE, default=0.0, help="White noise beside it.")
@click.option(
    "--assume",
    type=Named(),
    multiple=True,
    help="Amplitude or phase to expect, such as driving_eccentricity_mm=0.03; decides what a phase"
    " costs.",
)
@click.option("--perfect-encoders", is_flag=True, help="Fit no encoder eccentricity.")
@click.option(
    "--delay",
    type=DelayParam(("auto", "off")),
    metavar="auto|off|SECONDS",
    default="auto",
    help="As in `vttig fit`: fitted (auto, the default), taken as zero, or known in seconds.",
)
@click.option(
    "--want",
    type=Named(),
    multiple=True,
    help="Standard error to reach, such as driving_eccentricity_mm=0.0001; repeatable. Finds the"
    " fewest turns.",
)
def command(
    output: Output,
    pair: Path | None,
    drive: DriveRequest,
    turns: float | None,
    rate_hz: float | None,
    want: tuple[tuple[str, float], ...],
    **options: Any,
) -> None:
    """Say how well a fit of a run would know every parameter, before the run is made.

    The standard errors follow from the motion, the sampling and the noise that are assumed, by the
    model of `vttig fit`. With --want the shortest run is looked for.
    """
    from ...pair.gear_pair import pair_from_spec
    from ...runs.stated_drive import spec_of_file

    rig = pair_from_spec(drive.spec() if pair is None else spec_of_file(pair, drive))
    rate_hz = rate_hz or rig.log.sample_rate_hz
    if rate_hz is None:
        unless = "" if pair is None else ", and the pair file has no sample_rate_hz"
        raise UsageError(f"--rate-hz is missing{unless}.")
    if turns is None and not want:
        raise UsageError("--turns is missing; give it, or what to reach with --want.")
    wanted = _once("--want", want)
    with arguments_as_options(_OPTIONS):
        found = _planned(rig, turns, wanted, _keywords(rate_hz, **options))
    output.emit(found.to_json(), found)


def _planned(rig: Any, turns: float | None, wanted: dict[str, float], keywords: dict) -> Any:
    from ...posterior.planning.plan import MOST_TURNS, plan, shortest_run

    if wanted:
        return shortest_run(rig, wanted, most_turns=turns or MOST_TURNS, **keywords)
    assert turns is not None  # checked by the caller
    return plan(rig, turns=turns, **keywords)


def _keywords(
    rate_hz: float,
    *,
    speeds_rpm: tuple[float, ...],
    noise_std_deg: float,
    noise_correlation_s: float,
    white_std_deg: float,
    assume: tuple[tuple[str, float], ...],
    perfect_encoders: bool,
    **same: Any,
) -> dict[str, Any]:
    """Return the keyword arguments of `plan` from the options of the command.

    `same` holds the options whose names and values are passed on unchanged.
    """
    from ...posterior.planning.noise import PlannedNoise

    if noise_correlation_s and not noise_std_deg:
        raise UsageError(
            "--noise-correlation-s is the memory of --noise-std-deg, which is 0; give it a size."
        )
    return {
        "rate_hz": rate_hz,
        "speed_rpm": speeds_rpm or (60.0,),
        "noise": PlannedNoise(noise_std_deg, noise_correlation_s, white_std_deg),
        "assumed": _once("--assume", assume),
        "perfect_encoders": perfect_encoders,
        **same,
    }


def _once(option: str, pairs: tuple[tuple[str, float], ...]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, number in pairs:
        if name in found:
            raise UsageError(f"{option} {name} is given twice; give it once.")
        found[name] = number
    return found


_OPTIONS = {
    "speed_rpm": "--speed-rpm",
    "target": "--want",
    "assumed": "--assume",
    "noise": "--noise-std-deg",
}
"""Argument of a function → option, for options whose name is not the argument with dashes."""
