"""Tables of the pair file as written by the user, with validated values; imports no jax.

`PairSpec` represents the TOML file of a rig, with one `msgspec` struct for each table. Unknown
keys, wrong types and impossible values raise a `PairError` whose `where` names the file and key.
"""

import math
import re
from fractions import Fraction
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta

from ..base.errors import PairError
from ..base.files.toml_io import Table

Written = str | float | int
Positive = Annotated[float, Meta(gt=0, le=1e9)]  # all limits are chosen; 1e9 excludes infinity
Angle = Annotated[float, Meta(gt=0, lt=45)]
Helix = Annotated[float, Meta(gt=-45, lt=45)]
Depth = Annotated[float, Meta(gt=0, le=5)]
Thinning = Annotated[float, Meta(ge=0, le=1e9)]
Shift = Annotated[float, Meta(ge=-5, le=5)]
Crowning = Annotated[float, Meta(ge=0, le=1e6)]
HIGHEST_ORDER = 1000
"""Highest harmonic order that a pair file may state (chosen)."""

Order = Annotated[float, Meta(gt=0, le=HIGHEST_ORDER)]
Length = Literal["mm", "um", "inch"]
Turned = Literal["deg", "rad", "rev", "arcsec", "urad", "arcmin", "mdeg", "mrad", "gon", "mgon"]
AngleUnit = Literal[Length, Turned, "counts"]
TimeUnit = Literal["s", "ms", "us", "ns", "100ns", "d", "min", "h"]

Flank = Literal["A", "B"]  # in contact: A in forward motion of the driving gear, B in backward
FLANKS: tuple[Flank, Flank] = get_args(Flank)


class Encoder(Table, frozen=True):
    """Encoder on one shaft; a counter wraps to zero at `modulus` counts.

    `sign` is −1 if the counts decrease while the angle φ of the shaft increases.
    """

    counts_per_rev: Annotated[int, Meta(ge=1)] | None = None
    accuracy_arcsec: Positive | None = None
    modulus: Annotated[int, Meta(ge=2)] | None = None
    sign: Literal[1, -1] = 1


class StatedTable(Table, frozen=True):
    """Table `stated` of a gear: nominal or measured lengths in mm.

    The span and the dimension over balls apply to the middle of the face.
    """

    tooth_thickness_thin_mm: Positive | None = None
    tooth_thickness_thick_mm: Positive | None = None
    tip_diameter_mm: Positive | None = None
    root_diameter_mm: Positive | None = None
    span_mm: Positive | None = None
    span_teeth: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    over_balls_mm: Positive | None = None
    ball_diameter_mm: Positive | None = None


class GearTable(Table, frozen=True):
    """Table `[driving]` or `[driven]`: one gear."""

    teeth: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    face_width_mm: Positive | None = None
    helix_angle_deg: Helix | None = None
    helix_left_deg: Helix | None = None
    helix_right_deg: Helix | None = None
    profile_shift: Shift = 0.0
    crowning_um: Crowning = 0.0
    tooth_thinning_mm: Thinning = 0.0
    stated: StatedTable | None = None
    encoder: Encoder = Encoder()

    @property
    def helix_deg(self) -> tuple[float, float]:
        """Helix angles of the left and the right flank in degrees."""
        both = self.helix_angle_deg or 0.0
        left = both if self.helix_left_deg is None else self.helix_left_deg
        right = both if self.helix_right_deg is None else self.helix_right_deg
        return left, right


class RackTable(Table, frozen=True):
    """Table `[rack]`: basic rack of both gears, in normal modules if `normal_module_mm` is given.

    Otherwise the unit of all depths is the transverse module.
    """

    addendum: Depth = 1.0
    clearance: Annotated[float, Meta(ge=0, le=2)] = 0.25
    tip_radius: Annotated[float, Meta(ge=0, le=2)] | None = None


class PairTable(Table, frozen=True):
    """Table `[pair]`: data of both gears; `diametral_pitch` is transverse, teeth per inch."""

    module_mm: Positive | None = None
    normal_module_mm: Positive | None = None
    diametral_pitch: Positive | None = None
    pressure_angle_deg: Angle | None = None
    normal_pressure_angle_deg: Angle | None = None
    centre_distance_mm: Positive | None = None


class DriveTable(Table, frozen=True):
    """Table `[drive]`: a two-shaft drive with only a ratio.

    `"9/16"` is driven over driving speed, and `"16:9"` is driving turns to driven turns.
    """

    ratio: str | float


class LogLayout(Table, frozen=True):
    """Table `[log]`: columns of the channels, their scales, the rows and the format of the text.

    - `from`, `to`, `cut`: rows that are read, by the time in s or the turns (`3rev`) of the driving
      shaft since the first sample; a cut `18:21` is left out. - `missing`: "skip" leaves out rows
      without a number. - `lead_mm`: travel of a shaft in mm or µm in one turn.
    """

    time: str | None = None
    sample_rate_hz: Positive | None = None
    driving_rpm: str | float | None = None
    driving_increments: bool = False
    driven_increments: bool = False
    driving: str | None = None
    driven: str | None = None
    transmission_error: str | None = None
    zero: Literal["start", "reading"] = "start"
    driving_scale: str | float | int = 1
    driven_scale: str | float | int = 1
    direction: str | None = None
    axial_mm: str | None = None
    torque: str | None = None
    speed: str | None = None
    acceleration: str | None = None
    command: str | None = None
    decimal: Literal[".", ","] | None = None
    delimiter: str | None = None
    encoding: str | None = None
    start: str | float | None = msgspec.field(default=None, name="from")
    stop: str | float | None = msgspec.field(default=None, name="to")
    cut: tuple[str, ...] = ()
    missing: Literal["skip"] | None = None
    lead_mm: Positive | None = None

    @property
    def leaves_out_rows(self) -> bool:
        """Whether rows of the log may be left out."""
        return (self.start, self.stop, self.missing, self.cut) != (None, None, None, ())


class UnitTable(Table, frozen=True):
    """Table `[unit]`: units of those columns of a log whose names do not state a unit.

    If a name and this table both state a unit, they must agree. If neither states the unit of the
    time, it is s; for angles a unit is required.
    """

    driving: AngleUnit | None = None
    driven: AngleUnit | None = None
    transmission_error: AngleUnit | None = None
    time: TimeUnit | None = None
    command: AngleUnit | None = None


class HarmonicOrders(Table, frozen=True):
    """Table `[fit]`: orders of each shaft and number of tooth-mesh orders in the forward model.

    An order is a positive number of cycles per revolution of its shaft. A non-integer order, such
    as 3.087, describes another shaft whose angle is not logged. Whole numbers become integers.

    **Raises** `ValueError` for an order that is no positive number up to 1000.
    """

    driving_orders: tuple[Order, ...] = tuple(range(1, 9))
    driven_orders: tuple[Order, ...] = tuple(range(1, 9))
    mesh_orders: Annotated[int, Meta(ge=0, le=20)] = 1

    def __post_init__(self):
        for name in ("driving_orders", "driven_orders"):
            orders = tuple(_order(value, name) for value in getattr(self, name))
            msgspec.structs.force_setattr(self, name, orders)


def _order(value: Any, name: str) -> int | float:
    """Return an order, as an integer if it is whole."""
    try:
        order = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError):
        order = math.nan
    if not 0 < order <= HIGHEST_ORDER:
        raise ValueError(
            f"Argument `{name}` must hold positive numbers up to {HIGHEST_ORDER}, but holds"
            f" {value!r}."
        )
    return int(order) if order.is_integer() else order


class PairSpec(Table, frozen=True):
    """Contents of a pair file, with either `pair` and both tooth counts, or `drive`."""

    name: str = ""
    pair: PairTable | None = None
    drive: DriveTable | None = None
    rack: RackTable = RackTable()
    driving: GearTable = GearTable()
    driven: GearTable = GearTable()
    log: LogLayout = LogLayout()
    unit: UnitTable = UnitTable()
    fit: HarmonicOrders = HarmonicOrders()

    @property
    def ratio(self) -> Fraction:
        """Ratio z₁/z₂ of the speed of the driven shaft to that of the driving shaft."""
        if self.drive is not None:
            return as_ratio(self.drive.ratio, "drive.ratio")
        assert self.driving.teeth and self.driven.teeth  # checked by `_check_tables`
        return Fraction(self.driving.teeth, self.driven.teeth)


def as_ratio(value: str | float | int, where: str) -> Fraction:
    """Convert a ratio of driven to driving speed to a positive fraction, or raise `PairError`.

    `"16:9"` states driving turns to driven turns, as on a reducer, and is the ratio `"9/16"`.
    """
    driving, colon, driven = str(value).partition(":")
    turns = colon and "/" not in driving + driven
    return as_fraction(f"{driven}/{driving}" if turns else value, where, value)


def as_fraction(value: Written, where: str, written: Written | None = None) -> Fraction:
    """Convert `"7/1798"`, `"1/7.2976"` or a number to a positive fraction, or raise `PairError`.

    A number is converted by its shortest decimal form, so that 0.1 becomes 1/10. `written` is what
    the user wrote instead of `value`.
    """
    above, slash, below = str(value).replace(" ", "").partition("/")
    try:
        fraction = _decimal(above) / _decimal(below) if slash else _decimal(above)
    except (ValueError, ZeroDivisionError):
        fraction = Fraction(0)
    if not 1e-9 <= fraction <= 1e9:
        raise PairError(
            f"{(written or value)!r} is not a positive ratio; write a number or a quotient such as"
            ' "7/1798", and invert a column that counts backwards.',
            where=where,
        )
    return fraction


_EDGE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(s|rev)?\s*")


def as_edge(value: str | float, where: str) -> tuple[float, str]:
    """Split `12.5`, "12.5s" or "3rev" into a number and its unit, or raise `PairError`."""
    match = _EDGE.fullmatch(str(value))
    if match is None:
        raise PairError(
            f"{value!r} is no place in a log; write seconds such as 12.5, or turns of the driving"
            " shaft such as 3rev, both from the first sample.",
            where=where,
        )
    return float(match[1]), match[2] or "s"


def as_cut(text: str, where: str) -> tuple[float, float, str]:
    """Split "18:21" or "3rev:4rev" into both numbers and their unit, or raise `PairError`."""
    edges = text.split(":")
    found = [as_edge(edge, where) for edge in edges]
    units = {unit for _, unit in found}
    if len(found) != 2 or len(units) != 1 or found[0] >= found[1]:
        raise PairError(f"{text!r} is no cut; write for example 18:21 or 3rev:4rev.", where=where)
    return found[0][0], found[1][0], found[0][1]


def _decimal(text: str) -> Fraction:
    """Return the exact value of a decimal number; 0 if it is not in 1e-9 … 1e12.

    The conversion of numbers with huge exponents would take too long.
    """
    return Fraction(text) if "/" not in text and 1e-9 <= float(text) <= 1e12 else Fraction(0)
