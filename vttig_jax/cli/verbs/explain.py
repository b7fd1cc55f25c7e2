"""`vttig explain`: say what a word or a parameter of a report means."""

from typing import Annotated

from ...base.errors import UsageError
from ...report.words import WORDS, meanings
from ..options import Argument, verb
from ..output import Output


@verb(
    "explain",
    example="""
vttig explain constant_backlash_deg
vttig explain
""",
    compiles=False,
)
def command(output: Output, *, name: Annotated[str | None, Argument()]) -> None:
    """Say what NAME means, a word or a parameter of a report; without NAME, all of them.

    The page "How to read a report" of the documentation goes through one report line by line.
    """
    found = dict(WORDS.values()) if name is None else meanings(name)
    if not found:
        raise UsageError(
            f"{name!r} is no word of a report; `vttig explain` without a name lists all."
        )
    words = [{"word": word, "meaning": meaning} for word, meaning in found.items()]
    text = "\n".join(f"{word}: {meaning}" for word, meaning in found.items())
    output.emit({"schema": "vttig.explain/1", "words": words}, text)
