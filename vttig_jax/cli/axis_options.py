"""Options that say what the axis of a control is."""

from typing import Annotated, Literal, NamedTuple

from .options import Gathered, Real, declared


class AxisOptions(NamedTuple):
    """Options of an axis, which are keywords of `AxisSetting`."""

    shaft: Annotated[Literal["driven", "driving"], "--axis", "Shaft that the axis is."] = "driven"
    zero_deg: Annotated[
        Real,
        "--axis-zero-deg",
        "Position of the axis where its shaft has the angle zero in the fit.",
    ] = 0.0
    reversed: Annotated[bool, "The axis counts against the fit."] = False
    travel_deg: Annotated[
        tuple[Real, Real] | None,
        "--travel",
        {"metavar": "FROM TO"},
        "First and last position of the table, °; one turn of the axis by default.",
    ] = None
    place_known: Annotated[
        bool,
        "--place-unknown",
        {"flag_value": False},
        "Homing does not tell the turn within the hunting period; the table is the mean of all"
        " turns.",
    ] = True


AXIS = AxisOptions._fields
Axis = Annotated[AxisOptions, Gathered(declared(AxisOptions), AxisOptions)]
"""Parameter of a verb."""
