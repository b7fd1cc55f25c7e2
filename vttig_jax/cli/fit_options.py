"""What `vttig fit` models: the options of `identify.fit`, checked before anything is read."""

import math
from collections.abc import Callable
from typing import Any, Literal, get_args

import click

from .options import POSITIVE

LONGEST_DELAY_S = 1.0
HIGHEST_DRIFT = 6
DelayWord = Literal["auto", "free", "off"]
LossName = Literal["auto", "square", "huber", "bisquare"]
RegressorName = Literal["torque", "acceleration", "speed"]
FlankName = Literal["A", "B"]
NoiseKind = Literal["ar", "white", "ou"]
NoiseIn = Literal["time", "angle"]
NoiseOf = Literal["rig", "plateau"]


class DelayParam(click.ParamType):
    """`auto`, `free`, `off`, or seconds."""

    name = "delay"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> DelayWord | float:
        """The word, or the number, or a usage error."""
        if value in get_args(DelayWord):
            return value
        try:
            seconds = float(value)
        except ValueError:
            seconds = math.nan
        if not abs(seconds) <= LONGEST_DELAY_S:
            self.fail(
                f"{value!r} is neither {', '.join(get_args(DelayWord))} nor a number of seconds"
                f" within ±{LONGEST_DELAY_S:g}.",
                param,
                ctx,
            )
        return seconds


def _choice(names: Any) -> click.Choice:
    return click.Choice(get_args(names))


_OPTIONS = (
    click.option("--flank", type=_choice(FlankName), help="Use one flank only."),
    click.option("--perfect-encoders", is_flag=True, help="Fit no encoder eccentricity."),
    click.option(
        "--perfect-gears",
        is_flag=True,
        help="Fit no gear eccentricity: first orders are those of the encoders.",
    ),
    click.option(
        "--delay",
        type=DelayParam(),
        default="auto",
        metavar="auto|free|off|SECONDS",
        help="Delay of the driven channel: fitted where the logs show one (auto, the default),"
        " fitted in any case, taken as zero, or given.",
    ),
    click.option(
        "--loss",
        type=_choice(LossName),
        default="auto",
        help="Least squares or a robust loss; auto, the default, takes squares unless there are"
        " outliers, and then bisquare.",
    ),
    click.option(
        "--regressor",
        "regressors",
        type=_choice(RegressorName),
        multiple=True,
        help="Fit a term proportional to this too; repeatable. A torque column is tried unasked.",
    ),
    click.option("--free-ratio", is_flag=True, help="Fit the ratio too, beside the given one."),
    click.option(
        "--drift-order",
        type=click.IntRange(0, HIGHEST_DRIFT),
        help="Highest power of time; by default 0, 1 or 2, whichever the logs ask for.",
    ),
    click.option(
        "--drift-knots",
        type=POSITIVE,
        metavar="SECONDS",
        help="In place of powers: a cubic spline with knots this far apart.",
    ),
    click.option(
        "--same-zero/--own-zero",
        default=None,
        help="Do the angles of several logs count from the same zero? By default they do where the"
        ' pair file says zero = "reading".',
    ),
    click.option(
        "--noise",
        type=_choice(NoiseKind),
        default="ar",
        help="Autoregressive (the default); Ornstein–Uhlenbeck, for samples at unequal times; or"
        " white, which real noise never is.",
    ),
    click.option(
        "--noise-in",
        type=_choice(NoiseIn),
        default="time",
        help="Is the noise stationary in time (the default) or in driving angle?",
    ),
    click.option(
        "--noise-of",
        type=_choice(NoiseOf),
        default="rig",
        help="One noise for the rig (the default), or one for every speed plateau.",
    ),
    click.option(
        "--use-readings",
        is_flag=True,
        help="Let the --backlash-readings join the fit instead of only checking it.",
    ),
)


def model_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a verb one option a keyword of `identify.fit`."""
    for option in reversed(_OPTIONS):
        function = option(function)
    return function
