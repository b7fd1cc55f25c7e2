"""Statements of a user on a drive and its log: by options, by a pair file, or by both."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import msgspec
from msgspec import Meta

from ...base.errors import PairError, UsageError
from ...base.files.limits import STDIN, kept_bytes
from ...base.units import REV, radians_of
from ...pair.pair_file import PAIR_FILE, check_rows
from ...pair.schema import (
    DriveTable,
    Encoder,
    GearTable,
    HarmonicOrders,
    LogLayout,
    PairSpec,
    Positive,
    UnitTable,
    as_fraction,
    as_ratio,
)
from ..readers.column_names import ROLES, unit_spelt, units_of

SHAFTS = ("driving", "driven")
UNITS = {role: units_of(role) for role in (*SHAFTS, "command", "transmission_error", "time")}
"""Role → units that the option `--unit` accepts for it."""


SIDEREAL = "sidereal"
"""Word for the speed of a driven shaft that follows the stars."""

SIDEREAL_DAY_S = 86164.0905
"""Mean sidereal day in s, in which a telescope that follows the stars turns once."""


@runtime_checkable
class Shaft(Protocol):
    """Shaft with its encoder and the tooth count of its gear, or None without a gear."""

    @property
    def teeth(self) -> int | None: ...  # noqa: D102

    @property
    def encoder(self) -> Encoder: ...  # noqa: D102


@runtime_checkable
class TwoShafts(Protocol):
    """Pair file, `GearPair` or `Drive`: ratio, shafts, and the layout and units of a log."""

    @property
    def ratio(self) -> Fraction: ...  # noqa: D102

    @property
    def driving(self) -> Shaft: ...  # noqa: D102

    @property
    def driven(self) -> Shaft: ...  # noqa: D102

    @property
    def log(self) -> LogLayout: ...  # noqa: D102

    @property
    def unit(self) -> UnitTable: ...  # noqa: D102

    @property
    def fit(self) -> HarmonicOrders: ...  # noqa: D102


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
            driving, slash, driven = str(self.teeth).replace(" ", "").partition("/")
            if slash and driving.isdigit() and driven.isdigit() and int(driving) and int(driven):
                return as_ratio(f"{driving}/{driven}", "")
            message = "must be the teeth of the driving and driven gear, as in 45/80."
            raise PairError(f"{str(self.teeth)!r} {message}")
        except PairError as error:
            option = "--teeth" if self.ratio is None else "--ratio"
            raise UsageError(f"{option} {error.message}") from None

    @property
    def encoders(self) -> tuple[Encoder, ...]:
        """Encoders of the driving and of the driven shaft."""
        counts = self.counts or (None, None)
        return tuple(
            Encoder(counts_per_rev=count, sign=-1 if shaft in self.inverted else 1)
            for shaft, count in zip(SHAFTS, counts, strict=True)
        )

    @property
    def layout(self) -> LogLayout:
        """Layout of the log as far as it is stated."""
        rpm = self.driving_rpm
        if rpm == SIDEREAL and self.names_a_drive:
            rpm = f"{60 / SIDEREAL_DAY_S / float(self.speed_ratio):.15g}"
        driving, driven = self.driving_scale or 1, self.driven_scale or 1
        return LogLayout(driving_rpm=rpm, driving_scale=driving, driven_scale=driven)

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
        gears = [GearTable(encoder=encoder) for encoder in self.encoders]
        drive = DriveTable(ratio=str(ratio).replace(" ", ""))
        return PairSpec(drive=drive, driving=gears[0], driven=gears[1])

    def statement(self, reading: "ReadingOptions | None" = None) -> "Statement":
        """Return what these statements and the options for reading a log say about it.

        **Raises** `UsageError` for what `check` refuses and for contradictory options.
        """
        self.check()
        named = self.names_a_drive
        # Turns such as "64:23" and teeth say which number belongs to which shaft.
        sure = self.teeth is not None or ":" in str(self.ratio) or (named and self.speed_ratio == 1)
        return Statement(
            layout=stated_layout(self.layout, reading),
            unit=msgspec.structs.replace(UnitTable(), **self.units),
            encoders=self.encoders,
            ratio=self.speed_ratio if named else None,
            two_readings=str(self.ratio) if named and not sure else "",
            drive=self.spec().drive if named else None,
        )

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


@dataclass(frozen=True)
class Statement:
    """What a user states about a log; options and a pair file state the same things.

    **Arguments**
    - `layout`: names of the columns, format of the text, zero, scales, and speed of a clock.
    - `unit`: units of columns whose names contain no unit.
    - `encoders`: encoders of the driving and of the driven shaft.
    - `ratio`: ratio i of driven to driving speed, or None.
    - `two_readings`: the ratio as it is written if it has two readings, such as "9/16", else "".
    - `drive`: table [drive] of the equivalent pair file; None if a pair file states the drive,
      whose words are then in the cures of questions, or if nothing does.
    - `in_file`: whether a pair file makes these statements.
    """

    layout: LogLayout
    unit: UnitTable
    encoders: tuple[Encoder, ...]
    ratio: Fraction | None = None
    two_readings: str = ""
    drive: DriveTable | None = None
    in_file: bool = False

    @classmethod
    def of(cls, pair: TwoShafts, reading: "ReadingOptions | None" = None) -> "Statement":
        """Return what a pair file and the options for reading a log say; options have priority.

        **Raises** `UsageError` for contradictory options.
        """
        return cls(
            layout=stated_layout(pair.log, reading),
            unit=pair.unit,
            encoders=(pair.driving.encoder, pair.driven.encoder),
            ratio=pair.ratio,
            in_file=True,
        )

    @property
    def counted(self) -> bool:
        """Whether options state counts, so that columns without a unit are in counts."""
        return not self.in_file and self.encoders[0].counts_per_rev is not None

    def radians(self, role: str, unit: str) -> float | None:
        """Return the angle in rad of a reading 1 of a shaft in `unit`, without sign and scale.

        It is None if counts per revolution or the lead of the screw are missing.
        """
        counts = self.encoders[SHAFTS.index(role)].counts_per_rev
        return radians_of(unit, counts, self.layout.lead_mm)


class ReadingOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options for reading a log, with the names that `run.toml` uses; they win over `[log]`.

    `columns` are texts ROLE=NAME, `decimal` is the decimal mark, `sample_rate` (Hz) replaces a time
    column; `start`, `stop`, `cut`, `missing` and `lead_mm` are those of `LogLayout`.
    """

    columns: tuple[str, ...] = ()
    decimal: Annotated[str, Meta(pattern="^[.,]$")] | None = None
    sample_rate: Positive | None = None
    start: str | float | None = msgspec.field(default=None, name="from")
    stop: str | float | None = msgspec.field(default=None, name="to")
    cut: tuple[str, ...] = ()
    missing: Literal["skip"] | None = None
    lead_mm: Positive | None = None

    @classmethod
    def of(
        cls,
        columns: Mapping[str, str] | None = None,
        sample_rate_hz: float | None = None,
        cut: str | Sequence[str] = (),
        **others: Any,
    ) -> "ReadingOptions":
        """Return the options that keyword arguments of `read_log` state."""
        texts = tuple(f"{role}={name}" for role, name in (columns or {}).items())
        parts = (cut,) if isinstance(cut, str) else tuple(cut)
        own: dict[str, Any] = {"sample_rate": sample_rate_hz, **others}
        plain: dict[str, Any] = {n: float(v) if isinstance(v, float) else v for n, v in own.items()}
        return cls(columns=texts, cut=parts, **plain)

    def keywords(self) -> dict[str, Any]:
        """Return these options as keyword arguments of `read_log`."""
        own = msgspec.structs.asdict(self)
        rate = own.pop("sample_rate")
        return own | {"columns": roles_of(self.columns), "sample_rate_hz": rate}


def roles_of(columns: Iterable[str]) -> dict[str, str]:
    """Return role → name of the column from texts ROLE=NAME.

    **Raises** `UsageError` for a text of another form, an unknown role, and a role that occurs
    twice.
    """
    named: dict[str, str] = {}
    for text in columns:
        role, equals, name = text.partition("=")
        if not equals or not name or role not in ROLES:
            raise UsageError(
                f"--column {text!r} must be ROLE=NAME with a role of {', '.join(ROLES)}."
            )
        if role in named:
            raise UsageError(f"--column: `{role}` is named twice; keep one of the two.")
        named[role] = name
    return named


def stated_layout(layout: LogLayout, reading: ReadingOptions | None) -> LogLayout:
    """Return a table [log] in which the options for reading a log have replaced its own keys.

    A column `driven` replaces a `transmission_error`, and vice versa; a rate replaces the time.

    **Raises** `UsageError` for invalid or contradictory options.
    """
    if reading is None:
        return layout
    columns, rate = roles_of(reading.columns), reading.sample_rate
    if rate is not None and "time" in columns:
        raise UsageError("a sample rate and a time column are both given; keep the one of the log.")
    changes = {
        name: value
        for name in ("decimal", "start", "stop", "cut", "missing", "lead_mm")
        if (value := getattr(reading, name)) not in (None, ())
    }
    for role, other in (("driven", "transmission_error"), ("transmission_error", "driven")):
        if role in columns:
            changes.setdefault(other, None)
    if rate is not None or "time" in columns:
        changes["sample_rate_hz"] = rate
    stated = msgspec.structs.replace(layout, **{**changes, **columns})
    try:
        layout = PAIR_FILE.convert(msgspec.to_builtins(stated), LogLayout, "log")
        check_rows(layout)
        return layout
    except PairError as error:
        key = error.where.removeprefix("log.").partition("[")[0].removesuffix("_hz")
        raise UsageError(f"--{key.replace('_', '-')}: {error.message}") from None


def counts_of(text: str) -> tuple[int, int]:
    """Return the counts per revolution of both shafts from "A,B" or, if they are equal, from "A".

    **Raises** `UsageError` for anything but one or two whole numbers from 1.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 2 or not all(part.isascii() and part.isdigit() and int(part) for part in parts):
        volts = "; for 3.3 V a turn write --counts 33,33 and --column 'driving=10*NAME'"
        raise UsageError(
            f"--counts {text!r} must be the counts per revolution of the driving and of the driven"
            f" encoder, for example 90000,90000{volts if '.' in text else ''}."
        )
    return int(parts[0]), int(parts[-1])


def units_of_options(texts: Iterable[str]) -> dict[str, str]:
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


def fit_command(
    path: str | Path,
    request: DriveRequest,
    columns: Mapping[str, str],
    reading: ReadingOptions = ReadingOptions(),
    asked: Sequence[str] = (),
) -> str:
    """Return a command that the user can copy and that names every column.

    `path` is the log, `columns` is role → name of its column, and `asked` are options at the end,
    with capitals in place of what only the user knows.

    **Example**
    ```python
    >>> from vttig_jax.logs.recognition.request import DriveRequest, fit_command
    >>> print(fit_command("log.csv", DriveRequest(ratio="16:9"), {"driving": "motor angle"}))
    vttig fit log.csv --ratio 16:9 --column 'driving=motor angle'

    ```
    """
    log = str(STDIN) if kept_bytes(path) is not None else str(path)
    log = f"./{log}" if log.startswith("-") and log != str(STDIN) else log  # it is no option
    rate = None if reading.sample_rate is None else f"{reading.sample_rate:.12g}"
    lead = radius = None
    if reading.lead_mm is not None:  # as --radius-mm if that has fewer digits
        lead, radius = f"{reading.lead_mm:.12g}", f"{reading.lead_mm / REV:.9g}"
        lead, radius = (None, radius) if len(radius) < len(lead) else (lead, None)
    options: list[tuple[str, Any]] = [
        ("--ratio", request.ratio if request.names_a_drive else "A:B"),
        ("--teeth", request.teeth),
        ("--counts", request.counts and ",".join(map(str, request.counts))),
        *(("--unit", f"{role}={unit}") for role, unit in request.units.items()),
        *(("--invert", shaft) for shaft in request.inverted),
        ("--driving-rpm", request.driving_rpm),
        ("--driving-scale", request.driving_scale),
        ("--driven-scale", request.driven_scale),
        *(("--column", f"{role}={name}") for role, name in columns.items()),
        ("--decimal", reading.decimal),
        ("--sample-rate", rate),
        ("--from", reading.start),
        ("--to", reading.stop),
        *(("--cut", part) for part in reading.cut),
        ("--missing", reading.missing),
        ("--lead-mm", lead),
        ("--radius-mm", radius),
    ]
    words = [word for option in options if option[1] is not None for word in option]
    return " ".join([shlex.join(["vttig", "fit", log, *map(str, words)]), *asked])


MOST_TURNS = 10_000
"""Largest number of turns in a sentence. For a larger number, the sentence gives the turns of the
driven shaft for one turn of the driving shaft (chosen)."""


def in_words(ratio: Fraction) -> str:
    """Return a ratio of driven to driving speed as a sentence about turns."""
    driving, driven = ratio.denominator, ratio.numerator
    if max(driving, driven) > MOST_TURNS:
        return f"the driving shaft turns once while the driven shaft turns {float(ratio):.9g} times"
    once = ("once" if count == 1 else f"{count} times" for count in (driving, driven))
    return "the driving shaft turns {} while the driven shaft turns {}".format(*once)
