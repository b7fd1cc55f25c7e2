"""All questions about a log at once, with the command that answers them."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec

from ...base.errors import VttigError
from ..readers.open_table import open_table
from .assign import Roles, assign
from .candidates import Question
from .request import SHAFTS, DriveRequest, ReadingOptions


def answer_to(
    question: VttigError, request: DriveRequest, reading: ReadingOptions
) -> tuple[str, DriveRequest, ReadingOptions] | None:
    """Return the option that answers a question, and the statements with an assumed answer.

    It is None if no option with one placeholder does, such as `--sample-rate HZ`.
    """
    if not isinstance(question, Question):
        skips = "--missing skip" in question.message
        skipping = msgspec.structs.replace(reading, missing="skip")
        return ("--missing skip", request, skipping) if skips else None
    slug, role, columns = question.slug, question.role, question.columns
    units, changes = {}, {}
    match slug:
        case "no-time":
            option, changes = "--sample-rate HZ", {"sample_rate": 1.0}
        case "no-lead":
            gauge = role == "transmission_error"  # beside positions that are angles
            option = "--radius-mm MM" if gauge else "--lead-mm MM"
            changes = {"lead_mm": 1.0}
        case "no-time-unit" | "days-or-seconds":
            counted = "sample" in columns[0].lower()
            option, units = "--sample-rate HZ" if counted else "--unit time=UNIT", {"time": "s"}
        case "no-unit" | "scaled-unit":
            units = dict.fromkeys([role] if role else SHAFTS, "deg")
            option = " ".join(f"--unit {one}=UNIT" for one in units)
        case "no-counts" | "volts-a-turn":
            option, request = "--counts A,B", replace(request, counts=(1000, 1000))
        case "opposite-directions":
            option, request = "--invert driven", request.with_driven_inverted()
        case "several-columns" | "several-pairs" | "only-a-setpoint" | "driving-open":
            roles = (role,) if role else SHAFTS
            named = (f"{one}={name}" for one, name in zip(roles, columns, strict=False))
            option = " ".join(f"--column {one}=NAME" for one in roles)
            option = question.options[0] if slug == "driving-open" else option
            changes = {"columns": (*reading.columns, *named)}
        case "shafts-open" | "computed-beside-error":
            option = question.options[0].rpartition(", or ")[2]
        case _:
            return None
    request = replace(request, units={**request.units, **units})
    return option, request, msgspec.structs.replace(reading, **changes)


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
            follows = answer is None and key[0] != "ratio-of-two-readings"
            follows |= (
                key[0] == "shafts-open" and re.search("UNIT|A,B", "".join(options)) is not None
            )
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
    first = questions[0]
    said = (str(one).removeprefix(f"{where}: ").removesuffix(".") for one in questions)
    reasons = list(dict.fromkeys(said))
    if len(reasons) > 1:
        numbered = "; ".join(f"({k}) {reason}" for k, reason in enumerate(reasons, 1))
        first.where, first.message = where, f"{len(reasons)} things are in the way: {numbered}."
    if command:
        first.message = f"{first.message.removesuffix('.')}; in one command: {command}."
    return first
