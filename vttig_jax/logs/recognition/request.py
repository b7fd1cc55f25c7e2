"""Statements of a user on a drive and its log that replace a pair file: ratio, counts, units."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from ...base.errors import PairError, UsageError
from ...base.units import ANGLE_UNITS
from ...pair.schema import (
    DriveTable,
    Encoder,
    GearTable,
    LogLayout,
    PairSpec,
    as_fraction,
    as_ratio,
)
from ..readers.column_names import ANGLES, TIME_UNITS, unit_spelt

SHAFTS = ("driving", "driven")
UNITS = {
    **dict.fromkeys(SHAFTS, ANGLES),
    "transmission_error": tuple(ANGLE_UNITS),
    "time": tuple(TIME_UNITS),
}
"""Role → units that the option `--unit` accepts for it."""


SIDEREAL = "sidereal"
"""Word for the speed of a driven shaft that follows the stars."""

SIDEREAL_DAY_S = 86164.0905
"""Mean sidereal day in s, in which a telescope that follows the stars turns once."""


@dataclass(frozen=True)
class DriveRequest:
    """Statements about a drive and its log that replace a pair file.

    **Arguments**
    - `ratio`: "64:23", driving turns to driven turns; "9/16" or a number is driven over driving
      speed.
    - `teeth`: "45/80", teeth of the driving and of the driven gear.
    - `counts`: counts per revolution of the driving and of the driven encoder.
    - `units`: role → unit of a column whose name contains no unit.
    - `inverted`: shafts whose encoder counts backwards ("driving", "driven").
    - `driving_rpm`: constant speed in rpm of a driving shaft without an encoder; "sidereal" if the
      driven shaft turns once per sidereal day.
    - `driving_scale`, `driven_scale`: factor of a column, such as "757/3" for a motor column that
      is divided by the ratio already.
    """

    ratio: str | None = None
    teeth: str | None = None
    counts: tuple[int, int] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    inverted: tuple[str, ...] = ()
    driving_rpm: str | None = None
    driving_scale: str | None = None
    driven_scale: str | None = None

    @property
    def names_a_drive(self) -> bool:
        """Whether the ratio of the drive is stated."""
        return self.ratio is not None or self.teeth is not None

    @property
    def states_something(self) -> bool:
        """Whether anything at all is stated."""
        return self != DriveRequest()

    @property
    def speed_ratio(self) -> Fraction:
        """Ratio i of the driven to the driving speed.

        **Raises** `UsageError` without a positive ratio.
        """
        try:
            if self.ratio is not None:
                return as_ratio(self.ratio, "")
            return _teeth_ratio(str(self.teeth))
        except PairError as error:
            option = "--teeth" if self.ratio is None else "--ratio"
            raise UsageError(f"{option} {error.message}") from None

    @property
    def rpm(self) -> str | None:
        """Constant speed of the driving shaft in rpm, as text; None without `driving_rpm`."""
        if self.driving_rpm != SIDEREAL:
            return self.driving_rpm
        return f"{60 / SIDEREAL_DAY_S / float(self.speed_ratio):.15g}"

    @property
    def layout(self) -> LogLayout:
        """Layout of the log as far as it is stated."""
        return LogLayout(
            driving_rpm=self.rpm,
            driving_scale=self.driving_scale or 1,
            driven_scale=self.driven_scale or 1,
        )

    @property
    def says_which_shaft(self) -> bool:
        """Whether each number of the ratio belongs to a known shaft.

        It is true for turns such as "64:23", for teeth such as "45/80" and for equal speeds. It is
        false for other ratios of speeds such as "9/16" or 0.5625.
        """
        return self.teeth is not None or ":" in str(self.ratio) or self.speed_ratio == 1

    @property
    def is_bare(self) -> bool:
        """Whether the ratio is a number alone, such as 225, which may be meant as 225:1."""
        return not self.says_which_shaft and "/" not in str(self.ratio)

    def spec(self) -> PairSpec:
        """Return the pair file equivalent to the statements on the drive, without a log layout.

        **Raises** `UsageError` without a ratio and for what `check` refuses.
        """
        self.check()
        if not self.names_a_drive:
            raise UsageError(
                "the ratio of the drive is missing; give --ratio 64:23 (driving turns to driven"
                " turns), --teeth 45/80 or --pair PAIR.toml; `vttig inspect LOG` measures the ratio"
                " if the column names or --column say which shaft is which."
            )
        ratio = self.teeth if self.ratio is None else self.ratio
        gears = [
            GearTable(
                encoder=Encoder(
                    counts_per_rev=None if self.counts is None else self.counts[k],
                    sign=-1 if shaft in self.inverted else 1,
                )
            )
            for k, shaft in enumerate(SHAFTS)
        ]
        drive = DriveTable(ratio=str(ratio).replace(" ", ""))
        return PairSpec(drive=drive, driving=gears[0], driven=gears[1])

    def with_driven_inverted(self) -> "DriveRequest":
        """Return the request with the direction of the driven encoder reversed."""
        others = tuple(shaft for shaft in self.inverted if shaft != "driven")
        return replace(self, inverted=others if "driven" in self.inverted else (*others, "driven"))

    def check(self) -> None:
        """Raise `UsageError` for statements that are invalid or exclude each other."""
        if self.ratio is not None and self.teeth is not None:
            raise UsageError("--ratio and --teeth both state the ratio; give one of them.")
        if self.names_a_drive:
            _ = self.speed_ratio
        for shaft in self.inverted:
            if shaft not in SHAFTS:
                raise UsageError(f"--invert {shaft!r} must be driving or driven.")
        for name in ("driving_rpm", "driving_scale", "driven_scale"):
            try:
                if (value := getattr(self, name)) not in (None, SIDEREAL):
                    as_fraction(value, "")
            except PairError as error:
                raise UsageError(f"--{name.replace('_', '-')} {error.message}") from None


def counts_of(text: str) -> tuple[int, int]:
    """Return the counts per revolution of both shafts from "A,B" or, if they are equal, from "A".

    **Raises** `UsageError` for anything but one or two whole numbers from 1.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 2 or not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        raise UsageError(
            f"--counts {text!r} must be the counts per revolution of the driving and of the driven"
            " encoder, for example 90000,90000."
        )
    return int(parts[0]), int(parts[-1])


def units_of_options(texts: tuple[str, ...]) -> dict[str, str]:
    """Return role → unit from texts of the form UNIT (for both shafts) or ROLE=UNIT.

    **Raises** `UsageError` for unknown roles and units and for a role that has two units.
    """
    units: dict[str, str] = {}
    for text in texts:
        left, equals, right = text.partition("=")
        role, unit = (left.strip(), unit_spelt(right)) if equals else ("", unit_spelt(left))
        if equals and role not in UNITS:
            raise UsageError(f"--unit {text!r}: {role!r} is none of {', '.join(UNITS)}.")
        roles = (role,) if equals else SHAFTS
        known = UNITS[roles[0]]
        if unit not in known:
            raise UsageError(f"--unit {text!r}: {unit!r} is no unit; use {', '.join(known)}.")
        for one in roles:
            if units.setdefault(one, unit) != unit:
                raise UsageError(f"--unit states {units[one]} and {unit} for {one}; give one.")
    return units


MOST_TURNS = 10_000
"""Largest number of turns in a sentence. For a larger number, the sentence gives the turns of the
driven shaft for one turn of the driving shaft (chosen)."""


def in_words(ratio: Fraction) -> str:
    """Return a ratio of driven to driving speed as a sentence about turns."""
    driving, driven = ratio.denominator, ratio.numerator
    if max(driving, driven) > MOST_TURNS:
        return f"the driving shaft turns once while the driven shaft turns {float(ratio):.9g} times"
    return (
        f"the driving shaft turns {_times(driving)} while the driven shaft turns {_times(driven)}"
    )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _teeth_ratio(text: str) -> Fraction:
    driving, slash, driven = text.replace(" ", "").partition("/")
    if not (slash and driving.isdigit() and driven.isdigit() and int(driving) and int(driven)):
        raise PairError(f"{text!r} must be the teeth of the driving and driven gear, as in 45/80.")
    return as_ratio(f"{driving}/{driven}", "")
