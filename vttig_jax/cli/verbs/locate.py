"""`vttig locate`: find the turn within the hunting period from one reading of each shaft."""

import math
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from ...base.errors import NoAnswerError, UsageError
from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG
from ...pair.schema import Flank
from ...runs.run import Run, shaft_readings
from ..options import ConstantBacklash, Finite, Parsed, Positive, RunPath, verb
from ..output import Output

if TYPE_CHECKING:
    from ...kinematics.turn_location import Located
    from ...pair.gear_pair import ShaftReading


_LARGEST_DEG, _LARGEST_COUNT = 1e9, 2**53
"""Largest readings in degrees and in counts; a larger float does not resolve an angle in a turn."""


class Reading(NamedTuple):
    """Encoder reading as the user wrote it: its value, and the step of its last digit.

    The step is 0.1 for 123.4.
    """

    value: float
    step: float


def _written(text: str) -> Reading:
    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        raise ValueError(f"{text!r} is not a number.") from None
    if not number.is_finite() or not math.isfinite(float(number)):
        raise ValueError(f"{text!r} is not a finite number.")
    if abs(number) > _LARGEST_DEG:
        raise ValueError(f"{text!r} is no reading; it is at most {_LARGEST_DEG:g}°.")
    exponent = number.as_tuple().exponent
    assert isinstance(exponent, int)  # true for a finite number
    return Reading(float(number), 10.0 ** min(exponent, 0))


WRITTEN = Parsed("number", _written)


@verb(
    "locate",
    example="""
vttig locate run --driving-deg 304.97 --driven-deg 126.51
vttig locate run --driving-counts 76243 --driven-counts 31627 --flank A
""",
)
def command(
    output: Output,
    *,
    run_folder: RunPath,
    driving_deg: Annotated[Reading | None, WRITTEN, "Reading of the driving encoder, degrees."],
    driven_deg: Annotated[Reading | None, WRITTEN, "Reading of the driven encoder, degrees."],
    driving_counts: Annotated[int | None, "The same in counts, where the pair file has them."],
    driven_counts: Annotated[int | None, "The same in counts, where the pair file has them."],
    reading_std_arcsec: Annotated[
        Positive | None,
        "Standard deviation of either reading, beside the residual of the fit; by default that of"
        " rounding to the last digit given.",
    ],
    flank: Annotated[
        Flank | None,
        "The flank that carries; by default the driven shaft may lie anywhere in the gap.",
    ],
    certainty: Annotated[
        float,
        Finite(min=0, max=1, max_open=True),
        "Probability the turn must have; 0.999 by default.",
    ] = 0.999,
    constant_backlash_deg: ConstantBacklash,
) -> None:
    """Find the position of both shafts within the hunting period of the fit in RUN.

    The readings are those of the encoders of the log, in degrees of the shaft or in counts; they
    may exceed one turn. RUN states whether the angles of the fit start at the reading zero or at
    the first sample of its log. The command prints the turn with its probability, the angle in the
    hunting period, the backlash at this angle and the axial displacement that closes it. The exit
    code is 4 if the turn is not certain.
    """
    given = {"driving": (driving_deg, driving_counts), "driven": (driven_deg, driven_counts)}
    for shaft, (degrees, counts) in given.items():
        if (degrees is None) == (counts is None):
            raise UsageError(f"give one of --{shaft}-deg and --{shaft}-counts.")
    from ...identify.backlash import contact_map
    from ...kinematics.turn_location import locate
    from ...pair.gear_pair import GearPair

    opened = Run(run_folder)
    run, pair, fit = opened.record, opened.pair, opened.fit
    grid, contact = contact_map(fit, constant_backlash_deg=constant_backlash_deg)
    (driving, driving_std), (driven, driven_std) = (
        _angle(shaft, how, *given[shaft])
        for shaft, how in zip(given, shaft_readings(run, fit), strict=True)
    )
    if reading_std_arcsec is not None:
        driving_std = driven_std = reading_std_arcsec * ARCSEC
    std = math.hypot(fit.residual_rms_deg * DEG, float(pair.ratio) * driving_std, driven_std)
    found = locate(driving, driven, pair.ratio, contact, std_rad=std, flank=flank)
    _require_certain(found, certainty, flank, fit.source)
    backlash = float(grid.at(found.driving_rad))
    millimetres = axial = None
    if isinstance(grid.pair, GearPair):
        millimetres = backlash * float(grid.pair.reference_radii[1])
        if thinning := float(grid.pair.thinning):
            axial = millimetres / thinning
    runner_up = {"turn": found.runner_up, "probability": found.runner_up_probability}
    record = {
        "schema": "vttig.locate/1",
        "pair": fit.pair.name,
        "source": fit.source,
        "conditional_on": list(fit.conditional_on),
        "zero": fit.zero,
        "hunting_turns": found.hunting_turns,
        "turn": found.turn,
        "driving_deg": found.driving_rad / DEG,
        "probability": found.probability,
        "certainty": certainty,
        "runner_up": None if found.runner_up is None else runner_up,
        "flank": flank,
        "std_arcsec": found.std_rad / ARCSEC,
        "misfit_arcsec": found.misfit_rad / ARCSEC,
        "backlash_deg": backlash / DEG,
        "backlash_mm": millimetres,
        "axial_mm": axial,
    }
    output.emit(record, _text(found, record))


def _angle(
    shaft: str, how: "ShaftReading", degrees: Reading | None, counts: int | None
) -> tuple[float, float]:
    """Return the angle of a reading, rad, and the standard deviation of its rounding, rad."""
    if degrees is not None:
        return how.angle_of_deg(degrees.value), degrees.step * DEG / math.sqrt(12)
    assert counts is not None  # checked by `command`
    if how.unit != "counts":
        raise UsageError(
            f"the pair file of this run does not say how many counts make a revolution of the"
            f" {shaft} shaft; give --{shaft}-deg."
        )
    if abs(counts) > _LARGEST_COUNT:
        raise UsageError(
            f"--{shaft}-counts is no reading of an encoder; give the counts of some turns."
        )
    return how.angle(counts), abs(how.radians_per_unit) / math.sqrt(12)


def _require_certain(found: "Located", certainty: float, flank: Flank | None, source: str) -> None:
    if not found.fits:
        raise NoAnswerError(
            f"these readings fit no turn: even at the nearest the driven shaft would stand"
            f" {found.misfit_rad / ARCSEC:.4g}″ off its flank,"
            f" {found.misfit_rad / found.std_rad:.3g} times the"
            f" {found.std_rad / ARCSEC:.3g}″ that readings are taken to be good to; check that both"
            " are of the encoders and zeros of this run and were read at once, or say how good they"
            " are with --reading-std-arcsec.",
            where=source,
        )
    if found.probability < certainty:
        more = ", or say with --flank which flank carries" if flank is None else ""
        raise NoAnswerError(
            f"the turn is not certain: turn {found.turn} has a probability of"
            f" {found.probability:.4g}, turn {found.runner_up} of"
            f" {found.runner_up_probability:.4g}, and --certainty asks for {certainty:g}; read both"
            f" shafts finer than the {found.std_rad / ARCSEC:.3g}″ reckoned with{more}.",
            where=source,
        )


def _text(found: "Located", record: dict[str, Any]) -> str:
    from ...kinematics.turn_location import TITLE

    gap = f"{record['backlash_deg']:.5f}°"
    if record["backlash_mm"] is not None:
        gap += f", {record['backlash_mm']:.5f} mm at the reference circle"
    rows = [*found.rows(), ("backlash there", gap)]
    if record["axial_mm"] is not None:
        rows.append(("axial closing", f"{record['axial_mm']:.4f} mm"))
    zero = "first sample of the log" if record["zero"] == "start" else "reading zero"
    rows.append(("angles from", zero))
    return key_values(rows, title=TITLE)
