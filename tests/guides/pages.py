"""The fenced blocks of the README and of the pages in `docs/`, and the commands in them."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Fence:
    """A fenced block: language ("" for what a command prints), text, and its line in the page."""

    language: str
    text: str
    line: int


def pages() -> list[str]:
    """Return the README and the pages of `docs/`, by their paths in the repository."""
    docs = REPOSITORY / "docs"
    return ["README.md", *sorted(f"docs/{path.name}" for path in docs.glob("*.md"))]


def text_of(page: str) -> str:
    """Return the text of a page."""
    return (REPOSITORY / page).read_text(encoding="utf-8")


def fences(text: str) -> list[Fence]:
    """Return the fenced blocks of a text in their order."""
    return [
        Fence(found[1], found[2], text.count("\n", 0, found.start()) + 1)
        for found in _FENCE.finditer(text)
    ]


def commands(fence: Fence) -> Iterator[list[str]]:
    """Yield the words of every command in a block, without comments.

    A line that ends with a backslash goes on in the next one, and `&&` starts a new command.
    """
    for line in fence.text.replace("\\\n", " ").splitlines():
        words: list[str] = []
        for word in shlex.split(line, comments=True):
            if word == "&&":
                yield words
                words = []
            else:
                words.append(word)
        if words:
            yield words
