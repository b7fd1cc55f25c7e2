"""Options that say what the axis of a control is."""

from collections.abc import Callable

import click

from .options import Finite, gathered

AXIS = ("shaft", "zero_deg", "reversed", "travel_deg", "place_known")
"""Fields of `AxisSetting`, which are the names of these parameters."""

_OF_THE_AXIS = (
    click.option(
        "--axis",
        "shaft",
        type=click.Choice(("driven", "driving")),
        default="driven",
        help="Shaft that the axis is.",
    ),
    click.option(
        "--axis-zero-deg",
        "zero_deg",
        type=Finite(),
        default=0.0,
        help="Position of the axis where its shaft has the angle zero in the fit.",
    ),
    click.option("--reversed", is_flag=True, help="The axis counts against the fit."),
    click.option(
        "--travel",
        "travel_deg",
        nargs=2,
        type=Finite(),
        metavar="FROM TO",
        help="First and last position of the table, °; one turn of the axis by default.",
    ),
    click.option(
        "--place-unknown",
        "place_known",
        is_flag=True,
        flag_value=False,
        default=True,
        help="Homing does not tell the turn within the hunting period; the table is the mean of all"
        " turns.",
    ),
)


def axis_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the options of an axis; the verb receives `axis`, the keywords of `AxisSetting`."""

    return gathered(function, _OF_THE_AXIS, "axis", AXIS, dict)
