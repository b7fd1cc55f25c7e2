"""Options that replace a pair file: what a user states about a drive and its log.

Every command (verb) that reads logs has all of these options. A command without a log has only the
options of the drive: ratio, teeth and counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import click

from ..base.errors import PairError, UsageError
from ..base.logger import LOGGER
from ..logs.recognition.request import (
    UNITS,
    DriveRequest,
    ReadingOptions,
    counts_of,
    units_of_options,
)
from ..runs.stated_drive import write_pair
from .options import READING, Gathered, declared
from .output import Output

if TYPE_CHECKING:
    from ..logs.recognition.candidates import Guess
    from ..pair.gear_pair import GearPair
    from ..pair.schema import PairSpec


_SCALE = "Factor of the {} column, such as 757/3 for a column that is divided by the ratio already."


def _units(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Return the units that complete the value of `--unit`."""
    role, equals, _rest = incomplete.partition("=")
    known = UNITS.get(role, ()) if equals else UNITS["driving"]
    return [
        text for one in known if (text := f"{role}={one}" if equals else one).startswith(incomplete)
    ]


@dataclass(frozen=True)
class DriveOptions:
    """What the user says of a drive and its logs: by a pair file, or by options in its place.

    **Arguments**
    - `pair`: path of the pair file, or None. - `request`: statements about the drive and the log.
    - `reading`: options for reading the log.
    - `write_pair`: path to which the equivalent pair file is written, or None.
    - `explain_columns`: whether the command only prints how the columns are read.
    """

    pair: Path | None
    request: DriveRequest
    reading: ReadingOptions
    write_pair: Path | None
    explain_columns: bool

    def only_explains(
        self, output: Output, logs: Sequence[Path], spec: "PairSpec", guesses: "Sequence[Guess]"
    ) -> bool:
        """With `--explain-columns`, print how the columns of a log are read, and return True.

        Without it, print the `guesses` to stderr, unless `-q` is given, write the requested pair
        file with the content `spec`, and return False.

        **Raises** `UsageError` for several logs.
        """
        if not self.explain_columns:
            for guess in guesses:
                output.narrate(str(guess))
            if self.write_pair is not None:
                write_pair(self.write_pair, spec)
                LOGGER.info("written to %s", self.write_pair)
            return False
        from ..logs.preview import preview_log

        first, *others = logs
        if others:
            raise UsageError("--explain-columns explains one log; name one.")
        report = preview_log(first, spec=spec, reading=self.reading)
        report = replace(report, notes=(*map(str, guesses), *report.notes))
        output.emit(report.to_json(), report)
        return True


PairFile = Annotated[
    Path | None,
    "--pair",
    "TOML file of the gear pair, in place of --ratio or --teeth and the options below them.",
]
"""Parameter of a verb without a log. It excludes the options that describe the drive."""


class _OfDrive(NamedTuple):
    pair: PairFile
    ratio: Annotated[
        str | None,
        {"metavar": "A:B"},
        "Driving turns to driven turns, such as 64:23; 9/16 is driven over driving speed.",
    ]
    teeth: Annotated[str | None, {"metavar": "Z1/Z2"}, "Teeth of the driving and the driven gear."]
    counts: Annotated[
        str | None,
        {
            "metavar": "N,N",
            "callback": lambda _, __, text: None if text is None else counts_of(text),
        },
        "Counts per revolution of the driving and the driven encoder.",
    ]
    units: Annotated[
        tuple[str, ...],
        "--unit",
        {
            "metavar": "[ROLE=]UNIT",
            "callback": lambda _, __, texts: units_of_options(texts),
            "shell_complete": _units,
        },
        "Unit of columns whose names say none: deg, rad, rev, counts, or arcsec, arcmin, mdeg,"
        " mrad, urad and gon, of both shafts, or of one role, such as time=ms; may be repeated.",
    ]
    inverted: Annotated[
        tuple[Literal["driving", "driven"], ...], "--invert", "This encoder counts backwards."
    ]
    driving_rpm: Annotated[
        str | None,
        {"metavar": "RPM"},
        "Speed of a driving shaft that a clock turns and that has no encoder, such as 60/479;"
        " sidereal for the worm of a telescope mount, whose driven shaft follows the stars.",
    ]
    driving_scale: Annotated[str | None, {"metavar": "NUMBER"}, _SCALE.format("driving")]
    driven_scale: Annotated[str | None, {"metavar": "NUMBER"}, _SCALE.format("driven")]
    write_pair: Annotated[
        Path | None, "Write the pair file that says the same as the options and the log."
    ]
    explain_columns: Annotated[
        bool, "Print how the columns of the log are read, and do nothing else."
    ]


def _drive(
    pair: Path | None, write_pair: Path | None, explain_columns: bool, **stated: Any
) -> DriveOptions:
    read = {option.name: stated.pop(option.name) for option in READING.options}
    request, reading = DriveRequest(**stated), READING.make(**read)
    return DriveOptions(pair, request, reading, write_pair, explain_columns)


_DRIVE = declared(_OfDrive)
_RATIO = [option for option in _DRIVE if option.name in ("ratio", "teeth", "counts")]

Ratio = Annotated[DriveRequest, Gathered(_RATIO, DriveRequest)]
"""Parameter of a verb without a log: what its options say of the drive."""

Drive = Annotated[DriveOptions, Gathered([*_DRIVE, *READING.options], _drive)]
"""Parameter of a verb that reads logs: all that is said of them, and of their drive."""

GROUPS = {
    "The drive": ("ratio", "teeth", "counts", "inverted", "driving_rpm", "pair", "write_pair"),
    "The log": (
        "units",
        "driving_scale",
        "driven_scale",
        "quadrature",
        "explain_columns",
        *ReadingOptions.__struct_fields__,
    ),
}
"""Title in the help → parameters, for every verb that reads logs."""


def gears_of(spec: "PairSpec", path: Path, lack: str) -> "GearPair":
    """Return the gears of a pair file; a drive without gears has `lack`, which is an error."""
    from ..pair.gear_pair import GearPair, pair_from_spec

    pair = pair_from_spec(spec)
    if not isinstance(pair, GearPair):
        raise PairError(
            f"a drive without gears has {lack}; give [pair] and both tooth counts.",
            where=f"{path}: drive",
        )
    return pair
