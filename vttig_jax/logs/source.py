"""Position of a value in a log for error messages: file, line and column, or array and sample."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Source:
    """Origin of a log, from which error messages take the position of a value.

    **Arguments**
    - `name`: file name as given by the user, or "arrays".
    - `columns`: role ("driving", …) → name of its column.
    - `line_of`: function from row to line number; without it messages give the number of the
      sample, counted from 0.
    - `kind`: noun for a channel in messages, "column" or "argument".
    """

    name: str
    columns: Mapping[str, str] = field(default_factory=dict)
    line_of: Callable[[int], int] | None = None
    kind: str = "column"

    def at(self, role: str = "", row: int | None = None) -> str:
        """Return the position as text: "log.csv: line 7, column `driving_counts`"."""
        parts = []
        if row is not None:
            parts.append(f"line {self.line_of(row)}" if self.line_of else f"sample {row}")
        if role:
            parts.append(f"{self.kind} `{self.columns.get(role, role)}`")
        return ": ".join(filter(None, (self.name, ", ".join(parts))))
