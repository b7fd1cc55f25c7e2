"""What a report reads from a run folder: the fit, its map, its draws and the files beside them."""

import io
import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..base.errors import NoAnswerError, VttigError
from ..base.files.limits import read_regular
from ..identify.accuracy import Accuracy
from ..runs.map_table import RunTable, run_table
from ..runs.run import Run
from ..runs.run_file import REPORT, SWEEP

_MOST_ROWS = 100_000  # of a map that is computed for a report; chosen value
_TEXTS = (".csv", ".json", ".h", ".comp", ".xml", ".toml")


@dataclass(frozen=True)
class RunContent:
    """A run folder as a report shows it; no file outside the folder is read."""

    run: Run

    def data(self, name: str) -> bytes | None:
        """Return the content of a file of the folder; None if it is missing or lies elsewhere."""
        path, folder = (self.run.folder / name).resolve(), self.run.folder.resolve()
        return read_regular(path) if path.is_file() and path.is_relative_to(folder) else None

    def _object(self, name: str) -> dict[str, Any]:
        """Return the object of a JSON file of this run; {} without the file or of another run."""
        try:
            found = json.loads(self.data(name) or b"{}")
            return found if found.get("run") == self.run.record.digest else {}
        except (ValueError, AttributeError):
            return {}

    @cached_property
    def posterior(self) -> dict[str, Any]:
        """The object of schema `vttig.posterior/1` that `vttig sample` wrote, or {}."""
        return self._object(REPORT)

    @cached_property
    def map(self) -> RunTable | str:
        """The backlash map with its bands if draws gave them; otherwise why there is none."""
        from pyarrow import ArrowInvalid, csv

        record, data = self._object("map.json"), self.data("map.csv")
        try:
            if "smallest_gap" in record and data is not None:
                read = csv.read_csv(io.BytesIO(data))  # empty cells become NaN
                columns = {k: read[k].cast("float64").to_numpy() for k in read.column_names}
                return RunTable(record, columns)
            turns = float(self.run.fit.pair.hunting_turns)
            step_deg = max(1.0, turns * 360.0 / _MOST_ROWS)
            return run_table(self.run.fit, "backlash", step_deg, turns)
        except VttigError as error:
            return error.message
        except ArrowInvalid as error:
            return f"map.csv is damaged ({error}); write it again with `vttig sample`."

    @property
    def accuracy(self) -> Accuracy | None:
        """Accuracy in the terms of standards; None if the run does not tell it."""
        try:
            return self.run.fit.accuracy
        except NoAnswerError:
            return None

    @cached_property
    def sweep(self) -> str:
        """Report of the sweep in the folder, or ""."""
        return "" if self.data(SWEEP) is None else str(self.run.sweep)

    @cached_property
    def files(self) -> dict[str, bytes]:
        """Name → content of the texts that a report hands on: fit, map, tables of controllers."""
        others = {REPORT, *(log.name for log in self.run.logs)}
        names = sorted(path.name for path in self.run.folder.iterdir() if path.suffix in _TEXTS)
        found = {name: self.data(name) for name in names if name not in others}
        return {name: data for name, data in found.items() if data is not None}
