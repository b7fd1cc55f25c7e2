"""Lines of a text that is stored as one string; a list of lines would take three times the
memory."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import overload

_HEAD = 1024
"""Number of first lines that are stored as a list, because the search for headers and layouts reads
them often (chosen)."""

_BLOCK = 1 << 20
"""Number of characters that are split into lines at a time (chosen)."""


@dataclass(frozen=True)
class Lines(Sequence[str]):
    """The lines of `text[:stop]`, as `text[:stop].split("\\n")` returns them."""

    text: str
    stop: int

    @classmethod
    def of(cls, text: str) -> "Lines":
        """Return the lines of a whole text."""
        return cls(text, len(text))

    @cached_property
    def _head(self) -> list[str]:
        return list(islice(self._walk(), _HEAD))

    @cached_property
    def _length(self) -> int:
        return self.text.count("\n", 0, self.stop) + 1

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[str]:
        return self._walk()

    @overload
    def __getitem__(self, index: int) -> str: ...

    @overload
    def __getitem__(self, index: slice) -> list[str]: ...

    def __getitem__(self, index: int | slice) -> str | list[str]:
        if isinstance(index, slice):
            start, stop, step = index.indices(len(self))
            kept = self._head if max(start, stop) <= len(self._head) else list(self)
            return kept[start:stop:step]
        if 0 <= index < len(self._head):
            return self._head[index]
        if index >= len(self) or index < -len(self):
            raise IndexError("this text has no such line")
        return next(self.starting_at(index % len(self)))

    def starting_at(self, index: int) -> Iterator[str]:
        """Yield the lines from the line with index `index` (from 0) to the end."""
        return islice(self._walk(), index, None)

    def backwards(self) -> Iterator[str]:
        """Yield the lines from the last one to the first one."""
        stop = self.stop
        while stop >= 0:
            start = self.text.rfind("\n", 0, stop) + 1
            yield self.text[start:stop]
            stop = start - 1

    def before(self, index: int) -> "Lines":
        """Return the lines before the line with index `index` ≥ 1."""
        stop = self.stop
        for _ in range(len(self) - index):
            stop = self.text.rfind("\n", 0, stop)
        return Lines(self.text, stop)

    def without_empty_end(self, marks: str) -> "Lines":
        """Return the lines up to the last line that has a character other than `marks`.

        If lines are omitted, one empty line follows. A text without such a line is returned
        unchanged.
        """
        stop = self.stop
        for line in self.backwards():
            if line.strip(marks):
                return Lines(self.text, min(stop + 1, self.stop))
            stop -= len(line) + 1
        return self

    def start_of(self, index: int) -> int:
        """Return the character position in the text at which the line with index `index` starts."""
        place = 0
        for _ in range(index):
            place = self.text.index("\n", place, self.stop) + 1
        return place

    def have(self, mark: str, first: int = 0) -> bool:
        """Return whether `mark` occurs in the line with index `first` or a later line."""
        return len(self) > first and self.text.find(mark, self.start_of(first), self.stop) >= 0

    def match(self, pattern: re.Pattern[str], first: int) -> bool:
        """Return whether a pattern (flag MULTILINE) matches from the line with index `first` on."""
        if len(self) <= first:
            return False
        return pattern.search(self.text, self.start_of(first), self.stop) is not None

    def blocks(self, first: int, size: int) -> Iterator[str]:
        """Yield blocks of whole lines from the line with index `first` on.

        A block has about `size` characters.
        """
        place = self.start_of(first) if len(self) > first else self.stop
        while place < self.stop:
            end = self.text.rfind("\n", place, min(place + size, self.stop)) + 1
            if not end:
                end = self.text.find("\n", place, self.stop) + 1
            if not end or self.stop - place <= size:
                end = self.stop
            yield self.text[place:end]
            place = end

    def _walk(self) -> Iterator[str]:
        """Yield all lines without their line ends."""
        for block in self.blocks(0, _BLOCK):
            lines = block.split("\n")
            yield from lines[:-1]
            if not block.endswith("\n"):
                yield lines[-1]
        if not self.stop or self.text[self.stop - 1] == "\n":
            yield ""
