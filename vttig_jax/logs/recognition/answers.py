"""All questions about a log at once, with the command that answers them."""

from dataclasses import replace
from pathlib import Path

import msgspec

from ...base.errors import VttigError
from ..readers.open_table import open_table
from .assign import Roles, assign
from .candidates import Question
from .request import SHAFTS, DriveRequest, ReadingOptions, fit_command, roles_of

Answer = tuple[str, DriveRequest, ReadingOptions]


def answer_to(
    question: VttigError, request: DriveRequest, reading: ReadingOptions
) -> Answer | None:
    """Return the option that answers a question, and the statements with an assumed answer.

    It is None if no option with one placeholder does, such as `--sample-rate HZ`.
    """
    if not isinstance(question, Question):
        skips = "--missing skip" in question.message
        skipping = msgspec.structs.replace(reading, missing="skip")
        return ("--missing skip", request, skipping) if skips else None
    slug, role, columns = question.slug, question.role, question.columns
    match slug:
        case "no-time":
            return "--sample-rate HZ", request, msgspec.structs.replace(reading, sample_rate=1.0)
        case "no-time-unit" | "days-or-seconds":
            units = request.units | {"time": "s"}
            return "--unit time=UNIT", replace(request, units=units), reading
        case "no-unit" | "scaled-unit":
            units = request.units | dict.fromkeys([role] if role else SHAFTS, "deg")
            return f"--unit {role and f'{role}='}UNIT", replace(request, units=units), reading
        case "no-counts":
            return "--counts A,B", replace(request, counts=(1000, 1000)), reading
        case "no-lead":
            return "--lead-mm MM", request, msgspec.structs.replace(reading, lead_mm=1.0)
        case "opposite-directions":
            return "--invert driven", request.with_driven_inverted(), reading
        case "ratio-of-two-readings":
            turns = request.speed_ratio
            stated = replace(request, ratio=f"{turns.denominator}:{turns.numerator}")
            return "--ratio A:B", stated, reading
        case "several-columns" | "several-pairs":
            roles = (role,) if role else SHAFTS
            named = tuple(f"{one}={name}" for one, name in zip(roles, columns, strict=False))
            told = " ".join(f"--column {one}=NAME" for one in roles)
            columns = (*reading.columns, *named)
            return told, request, msgspec.structs.replace(reading, columns=columns)
        case "shafts-open":
            return question.options[0].rpartition(", or ")[2], request, reading
    return None


def all_questions(
    path: str | Path, found: Roles, request: DriveRequest, reading: ReadingOptions
) -> tuple[list[VttigError], list[str]]:
    """Return all that a log asks, and the options that answer it.

    Each question is answered by an assumption and the log is opened again, so that the questions
    behind it are found too. `found` are the columns without any assumption.
    """
    asked: dict[tuple[str, str], VttigError] = {}
    options: list[str] = []
    while True:
        before = len(options)
        for question in found.questions:
            key = getattr(question, "slug", ""), getattr(question, "role", "")
            answer = answer_to(question, request, reading)
            # An assumption may lead to what no option answers, and to a ratio that no columns have.
            follows = answer is None or (key[0] == "shafts-open" and "UNIT" in "".join(options))
            if key in asked or (before and follows):
                continue
            asked[key] = question
            if answer is not None:
                option, request, reading = answer
                options.append(option)
        if len(options) == before:
            return [*asked.values()], options
        try:
            statement = request.statement(reading)
            found = assign(open_table(path, statement.layout), statement)
        except VttigError:  # assumptions that contradict each other
            return [*asked.values()], options


def in_one(questions: list[VttigError], command: str, where: str) -> VttigError:
    """Return one error for all questions; its class, place and slug are those of the first one."""
    questions = list({str(one): one for one in questions}.values())
    first, reasons = questions[0], [one.message.removesuffix(".") for one in questions]
    if len(reasons) > 1:
        places = [one.where.removeprefix(where).removeprefix(": ") for one in questions]
        reasons = [
            f"({number}) {place}{place and ': '}{reason}"
            for number, (place, reason) in enumerate(zip(places, reasons, strict=True), 1)
        ]
        reasons[0] = f"{len(reasons)} things are in the way: {reasons[0]}"
        first.where = where
    first.message = "; ".join([*reasons, *[f"in one command: {command}"] * bool(command)]) + "."
    return first


def command_of(
    path: str | Path, request: DriveRequest, reading: ReadingOptions, options: list[str]
) -> str:
    """Return the command of a fit with the options that a log asks for; "" if there are none."""
    if not request.names_a_drive or "--ratio A:B" in options:
        request = replace(request, ratio="A:B", teeth=None)
    options = [one for one in options if one != "--ratio A:B"]
    command = fit_command(path, request, roles_of(reading.columns), reading)
    return " ".join([command, *options])
