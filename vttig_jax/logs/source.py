"""Where a number came from, for messages: file, line and column, or array and sample."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Source:
    """Origin of a log.

    **Arguments**
    - `name`: the file as the user wrote it, or "arrays".
    - `columns`: role ("driving", …) to the name of its column.
    - `line_of`: line number of a row; without it rows are called samples, counted from 0.
    - `kind`: what a channel is called, "column" or "argument".
    """

    name: str
    columns: Mapping[str, str] = field(default_factory=dict)
    line_of: Callable[[int], int] | None = None
    kind: str = "column"

    def at(self, role: str = "", row: int | None = None) -> str:
        """The place as text: "log.csv: line 7, column `driving_counts`"."""
        parts = []
        if row is not None:
            parts.append(f"line {self.line_of(row)}" if self.line_of else f"sample {row}")
        if role:
            parts.append(f"{self.kind} `{self.columns.get(role, role)}`")
        return ": ".join(filter(None, (self.name, ", ".join(parts))))
