"""Table of the fits of many logs: one row per log, with parameters or with a code and a reason."""

from collections import Counter
from collections.abc import Mapping, Sequence
from csv import writer
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files.atomic_write import os_errors_as_input_errors, replace_file
from ...base.files.text_tables import key_values, text_table
from ...base.results import TextResult
from ...base.shown_text import csv_cell

Row = dict[str, Any]
Columns = dict[str, np.ndarray]
"""Name of a column → its values, one per log; a missing number is NaN."""

WORDS = ("log", "code", "reason", "flanks", "conditional_on", "undetermined")
"""Columns of text."""

NUMBERS = ("samples_used", "noise_order", "noise_std_deg")
"""Columns of numbers that are no parameters."""

PARTS = ("", "_std", "_low95", "_high95")
"""Endings of the names of the four columns of a parameter: value, std, bounds of the interval."""

OK = "ok"
"""Code of a log that was fitted."""

_QUOTED = 5
"""Largest number of logs that the report names for each code; chosen value."""


@dataclass(frozen=True, eq=False)
class FitTable(TextResult):
    """Fits of many logs of rigs of one design.

    **Arguments**
    - `columns`: `log`, `code` ("ok" for a fitted log), `reason`, `flanks`, the assumptions of the
      row as in `Fit.conditional_on`, the names of the `undetermined` parameters, `samples_used`,
      order and standard deviation of the noise, and for every parameter of `vttig_jax.fit` its
      value and the columns `_std`, `_low95`, `_high95`.
    - `pair`: name of the pair. - `settings`: settings of all fits.
    - `path`: file of the table, None without one.
    """

    columns: Columns
    pair: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.columns["log"])

    @property
    def is_fitted(self) -> np.ndarray:
        """Mask of the logs that were fitted."""
        return self.columns["code"] == OK

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(name for name in self.columns if f"{name}_std" in self.columns)

    @property
    def failures(self) -> tuple[tuple[str, str, str], ...]:
        """Log, code and reason of every log that was not fitted."""
        names = ("log", "code", "reason")
        rows = zip(*(self.columns[name][~self.is_fitted].tolist() for name in names), strict=True)
        return tuple(rows)

    def to_csv(self, path: str | Path | None = None) -> str:
        """Return the table as CSV text, and write it to `path` if it is given.

        A missing number is an empty cell; all other numbers have full precision. Text is written so
        that no spreadsheet takes it for a formula; see `csv_cell`.
        """
        text = StringIO()
        out = writer(text, lineterminator="\n")
        out.writerow(self.columns)
        lists = [[_cell(value) for value in column.tolist()] for column in self.columns.values()]
        out.writerows(zip(*lists, strict=True))
        if path is not None:
            _write(Path(path), text.getvalue().encode("utf-8"))
        return text.getvalue()

    def to_parquet(self, path: str | Path) -> None:
        """Write the table to `path` as Parquet; a missing number is null."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = {name: pa.array(one, from_pandas=True) for name, one in self.columns.items()}
        buffer = BytesIO()
        pq.write_table(pa.table(table), buffer)
        _write(Path(path), buffer.getvalue())

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.fit-many/1`."""
        return {
            "schema": "vttig.fit-many/1",
            "pair": self.pair,
            "logs": len(self),
            "fitted": int(self.is_fitted.sum()),
            "codes": self._counts(),
            "failed": [
                dict(zip(("log", "code", "reason"), row, strict=True)) for row in self.failures
            ],
            "parameters": {name: self._spread(name) for name in self.parameters},
            "settings": dict(self.settings),
            "table": None if self.path is None else self.path.name,
        }

    def __str__(self) -> str:
        fitted = int(self.is_fitted.sum())
        head = [("logs", f"{len(self)}, {fitted} fitted")]
        if self.path is not None:
            head.append(("table", str(self.path)))
        rows = []
        for name in self.parameters:
            spread = self._spread(name)
            if spread["logs"]:
                numbers = (spread[key] for key in ("median", "low", "high", "median_std"))
                rows.append((name, spread["logs"], *(f"{number:.5g}" for number in numbers)))
        headers = ("parameter", "logs", "median", "lowest", "highest", "median std")
        parts = [key_values(head, title=self.pair or "fits of many logs")]
        if rows:
            parts.append(text_table(rows, headers, align="lrrrrr"))
        assumed = Counter(text for text in self.columns["conditional_on"].tolist() if text)
        parts += [f"{count} conditional on {text}" for text, count in assumed.most_common()]
        for code, count in self._counts().items():
            named = [(log, reason) for log, own, reason in self.failures if own == code]
            parts += [f"{log}: {reason}" for log, reason in named[:_QUOTED]]
            if count > _QUOTED and code != OK:
                where = "in the table" if self.path is None else f"in {self.path.name}"
                parts.append(f"… and {count - _QUOTED} more of code {code} {where}")
        return "\n\n".join(parts)

    def _counts(self) -> dict[str, int]:
        return dict(Counter(self.columns["code"].tolist()).most_common())

    def _spread(self, name: str) -> dict[str, Any]:
        """Return statistics of a parameter over the logs that have a value of it.

        They are the number of these logs, the median, minimum and maximum of the values, and the
        median standard error.
        """
        values = self.columns[name]
        known = ~np.isnan(values)
        if not known.any():
            return {"logs": 0, "median": None, "low": None, "high": None, "median_std": None}
        std = self.columns[f"{name}_std"][known]
        return {
            "logs": int(known.sum()),
            "median": float(np.median(values[known])),
            "low": float(values[known].min()),
            "high": float(values[known].max()),
            "median_std": float(np.median(std)),
        }


def table_of(rows: Sequence[Mapping[str, Any]], parameters: Sequence[str]) -> Columns:
    """Return the columns of a table from its rows.

    A row may lack cells: a missing text becomes "", and a missing number becomes NaN.
    """
    numbers = [*NUMBERS, *(name + part for name in parameters for part in PARTS)]
    words = {name: np.array([str(row.get(name, "")) for row in rows], str) for name in WORDS}
    cells = {name: np.array([row.get(name) for row in rows], np.float64) for name in numbers}
    return words | cells


def _cell(value: Any) -> Any:
    """Return a value as a cell of CSV: "" for NaN, and no decimals for whole numbers."""
    if isinstance(value, str):
        return csv_cell(value)
    if isinstance(value, float):
        if np.isnan(value):
            return ""
        return int(value) if value.is_integer() else value
    return value


def _write(path: Path, data: bytes) -> None:
    with os_errors_as_input_errors(path):
        replace_file(path, data)
