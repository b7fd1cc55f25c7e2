"""Recognition of a log without a pair file: which column has which role, in which unit."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from ...base.errors import LogError, UsageError, VttigError
from ...base.units import ANGLE_UNITS, REV
from ...pair.schema import PairSpec, UnitTable, as_fraction
from ..readers.column_names import ROW, default_column, index_of
from ..readers.delimited import TextTable
from ..readers.nested import NestedTable, has_clocks
from ..readers.open_table import open_table
from . import question
from .candidates import Candidate, first_fault, read_values
from .name_check import check_names
from .name_words import inputs_and_outputs, read_name
from .question import Guess
from .request import SHAFTS, DriveRequest
from .shafts import Scale, by_name, by_ratio
from .time_column import refuse_two_clocks, time_column, time_unit

FURTHER = ("direction", "axial_mm", "torque", "speed", "acceleration")
"""Roles whose columns are read only if an option names the column."""


@dataclass(frozen=True)
class Recognition:
    """Result of `recognise`.

    - `spec`: content of a pair file that is equivalent to the options and the recognised columns.
    - `guesses`: what was recognised without a statement of the user.
    - `columns`: role → name of its column.
    """

    spec: PairSpec
    guesses: tuple[Guess, ...]
    columns: Mapping[str, str]


def recognise(
    path: str | Path,
    request: DriveRequest,
    *,
    columns: Mapping[str, str],
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> Recognition:
    """Recognise the columns of a log from their names and from the given ratio.

    **Arguments**
    - `request`: ratio, counts per revolution and units as the user stated them.
    - `columns`, `decimal`, `sample_rate_hz`: as in `read_log`.

    **Raises** `LogError` or `UsageError` if the log can be read in two ways; the message names the
    option that decides.
    """
    request.check()
    if not request.names_a_drive:
        raise UsageError(
            "the ratio of the drive is missing; give a pair file, or the ratio as driving turns to"
            ' driven turns, such as "64:23".',
            where=str(path),
        )
    table, _, _ = open_table(path, decimal=decimal, requested=columns.values(), headerless=True)
    table, _ = table.complete_rows([])
    search = Search(table, str(path), request, dict(columns))
    search.take_stated(timed=sample_rate_hz is None)
    search.find(timed=sample_rate_hz is None)
    if "transmission_error" in search.roles and request.is_bare:
        raise question.bare_ratio(str(request.ratio), request.speed_ratio)
    return Recognition(search.spec(), tuple(search.guesses), search.column_names)


@contextmanager
def _collected(asked: list[VttigError]) -> Iterator[None]:
    """Append a question that the body raises to `asked`."""
    try:
        yield
    except VttigError as error:
        asked.append(error)


@dataclass
class Search:
    """Search for the columns of all roles in one table.

    `columns` is role → name of the column that an option names. `take_stated` and `find` fill
    `roles` (role → index of its column, None for the row number), `units` (role → unit that is not
    in the column name) and `guesses`.
    """

    table: TextTable | NestedTable
    source: str
    request: DriveRequest
    columns: dict[str, str]
    roles: dict[str, int | None] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    _open: LogError | None = None

    def take_stated(self, *, timed: bool) -> None:
        """Assign roles to columns that options name and to columns with names that vttig writes.

        `timed` is true if the log needs a time column, because no sample rate is given.

        **Raises** `LogError` for a stated name that no column or several columns have. If several
        columns match a name that vttig writes, `find` raises this error later.
        """
        self.units = dict(self.request.units)
        self._take_named()
        self._take_defaults(timed=timed)

    def find(self, *, timed: bool) -> None:
        """Find the columns of the remaining roles; `timed` as in `take_stated`.

        If an error is raised, the roles that were found stay in `roles`.

        **Raises** `LogError` or `UsageError`: the first question, with the option that decides.
        """
        if asked := self.questions(timed=timed):
            raise asked[0]

    def questions(self, *, timed: bool) -> list[VttigError]:
        """Find the columns of the remaining roles, and return the questions that stay open.

        A question does not stop the search for columns that are independent of it, so that a log
        with an open question has the same time column as without it.
        """
        asked: list[VttigError] = [] if self._open is None else [self._open]
        missing = self._find_named_shafts(asked)
        shafts_open = bool(asked)
        if timed and "time" not in self.roles and not has_clocks(self.table):
            with _collected(asked):
                self._find_time()
        if missing and not shafts_open and (not asked or not self.request.names_a_drive):
            with _collected(asked):
                self._find_by_ratio(missing)
        if timed and self.roles.get("time") is not None:
            with _collected(asked):
                self._find_time_unit()
        with _collected(asked):
            self._check_names()
        with _collected(asked):
            self._check_units(complete=not asked)
        return asked

    def assuming(self, columns: Mapping[str, str], request: DriveRequest) -> "Search":
        """Return a new search of the same table in which `columns` and `request` are stated too.

        `take_stated` and `questions` of the new search say whether a command with them is complete.
        """
        trial = replace(
            self,
            request=request,
            columns={**self.columns, **columns},
            roles={},
            guesses=[],
            units={},
            _open=None,
        )
        trial.__dict__["_candidates"] = self._candidates  # the values of a table are read once
        return trial

    @property
    def column_names(self) -> dict[str, str]:
        """Role → name of its column, or `#number` if another column has the same name."""
        return {role: self.name_of(index) for role, index in self.roles.items()}

    def _take_named(self) -> None:
        """Assign roles to the columns that options name."""
        for role, name in self.columns.items():
            row = name == ROW
            self.roles[role] = None if row else index_of(name, role, self.names, self.source)

    def _take_defaults(self, *, timed: bool) -> None:
        """Assign roles to the columns with names that this package writes, such as driving_deg."""
        second = {"driven", "transmission_error"}
        for role in ("time", *SHAFTS, "transmission_error"):
            taken = role in self.roles or (role in second and second & set(self.roles))
            unused = (role == "time" and not timed) or (role == "driving" and self._clocked)
            if taken or unused:
                continue
            try:
                index = default_column(role, self.names, self.source)
            except LogError as error:
                index = None  # `find` looks for the time next to the shafts, or asks
                if role != "time":
                    self._open = self._open or error
            if index is not None and index not in self.roles.values():
                self.roles[role] = index

    def _find_named_shafts(self, asked: list[VttigError]) -> list[str]:
        """Assign the shafts by the column names; return the roles that are still missing.

        Open questions are appended to `asked`.
        """
        missing = [role for role in SHAFTS if role not in self.roles]
        if "transmission_error" in self.roles and "driven" in missing:
            missing.remove("driven")
        if self._clocked and "driving" in missing:
            missing.remove("driving")
        for role in missing:
            with _collected(asked):
                found = by_name(role, self._beside(role), self.source)
                if found is not None:
                    self.roles[role] = found.index
                    self._guess(role, found, "by its name")
        return [role for role in missing if role not in self.roles]

    def _check_names(self) -> None:
        """Ask if the motion contradicts the names of the shafts."""
        named = {r: self.candidate(k) for r, k in self.roles.items() if r in SHAFTS}
        if len(named) == 2:
            guessed, scale = {one.role for one in self.guesses}, Scale(self.per_turn, self.common)
            ratio = self._ratio if self.request.names_a_drive else None
            check_names(named, guessed, self.free(), ratio, scale=scale, source=self.source)
            refuse_two_clocks(self.roles.get("time"), named, self._candidates, self.source)

    def _find_time(self) -> None:
        try:
            found, guess = time_column(self._beside("time"), self.source)
        except LogError as error:
            raise (question.also_no_unit(error) if self._lacks_units else error) from None
        self.roles["time"] = found.index
        self.guesses.append(guess)

    def _find_by_ratio(self, missing: list[str]) -> None:
        if "transmission_error" in self.roles:
            raise question.no_driving(self.free(), self.source)
        if not self.request.names_a_drive or (missing == ["driven"] and self._clocked):
            possible = [one for one in self.free() if one.reading.is_angle]
            others = [one for one in self.free() if one.turns and one.reading.other]
            asked = question.no_fit(
                missing, possible, None, self.source, others, clocked=self._clocked
            )
            raise question.also_no_unit(asked) if self._lacks_units else asked
        fixed = {role: self.candidate(self.roles[role]) for role in SHAFTS if role in self.roles}
        scale = Scale(self.per_turn, self.common)
        found = by_ratio(fixed, self.free(), self._ratio, scale, self.source)
        if not self.request.says_which_shaft:
            raise question.two_readings(str(self.request.ratio), self._ratio)
        for role in missing:
            self.roles[role] = found[role].index
            self._guess(role, found[role], "the only one that has the given ratio")

    def _find_time_unit(self) -> None:
        column = self.candidate(self.roles["time"])
        if column.values is None and not column.dated:
            raise question.unreadable_time(column, first_fault(self.table, column.index))
        unit, guess = time_unit(column, self.units.get("time"), self.source)
        if unit is not None and guess is not None:
            self.units["time"] = unit
            self.guesses.append(guess)

    def _check_units(self, *, complete: bool) -> None:
        """Set the unit "counts" if counts are given; ask for missing units or counts.

        `complete` is true if both shafts are known.
        """
        counted = []
        for role in SHAFTS:
            if role not in self.roles:
                continue
            one = self.candidate(self.roles[role])
            unit = one.reading.unit or self.units.get(role)
            if unit is None and self.request.counts is not None:
                unit = self.units[role] = "counts"
            if unit is None:
                raise question.no_unit(role, one, self.source)
            if unit == "counts":
                counted.append(role)
                if self.request.counts is None:
                    raise question.no_counts(role, one.name, self.source)
        if complete and self.request.counts is not None and not counted:
            raise UsageError("--counts is given, but no column is in counts; leave it out.")

    def spec(self) -> PairSpec:
        """Return the pair file that is equivalent to the request and the found columns."""
        return msgspec.structs.replace(
            self.request.spec(),
            log=msgspec.structs.replace(self.request.layout, **self.column_names),
            unit=msgspec.structs.replace(UnitTable(), **self.units),
        )

    @property
    def names(self) -> Sequence[str]:
        """Names of all columns."""
        return self.table.names

    @property
    def _clocked(self) -> bool:
        """Whether the driving shaft has a given constant speed and therefore needs no column."""
        return self.request.driving_rpm is not None

    @property
    def _lacks_units(self) -> bool:
        """Whether neither an option nor the name of any possible shaft column states a unit."""
        stated = self.request.counts is not None or set(SHAFTS) & set(self.units)
        turning = [one for one in self._candidates if one.turns and one.reading.is_angle]
        return not stated and not any(one.reading.unit for one in turning)

    @property
    def _ratio(self) -> Fraction:
        return self.request.speed_ratio

    def free(self) -> list[Candidate]:
        """Return the columns without a role that are not time stamps of another column."""
        stamps = self.table.clocks.values() if isinstance(self.table, NestedTable) else ()
        taken = {*self.roles.values(), *stamps}
        return [one for one in self._candidates if one.index not in taken]

    def _beside(self, role: str) -> list[Candidate]:
        """Return the columns without a role among which the column of `role` is searched.

        The group of a column is the part of its name before the last slash: `2` for `2/motor`. Only
        the group of the columns with a role is searched if groups are numbered, which are sections
        of a text with one log each, or if `role` is the time. If no name in this group fits the
        role, all columns without a role are returned.
        """
        free = self.free()
        taken = [self.names[k] for k in self.roles.values() if k is not None]
        groups = {name.rpartition("/")[0] for name in taken}
        if role != "time" and not all(group.isdigit() for group in groups):
            return free
        near = [one for one in free if {one.name.rpartition("/")[0]} == groups]
        named = any(one.reading.role == role or (role == "time" and one.dated) for one in near)
        return near if named else free

    def candidate(self, index: int | None) -> Candidate:
        """Return a column with its values; None is the number of the row."""
        if index is None:
            return Candidate(-1, ROW, read_name(ROW, self.source))
        return self._candidates[index]

    def _guess(self, role: str, one: Candidate, why: str) -> None:
        self.guesses.append(Guess(role, f"column `{one.name}`", why, f"--column {role}=NAME"))

    def name_of(self, index: int | None) -> str:
        """Return the name of a column, or `#number` if another column has the same name."""
        if index is None:
            return ROW
        name = self.names[index]
        return name if self.names.count(name) == 1 else f"#{index + 1}"

    @cached_property
    def _candidates(self) -> list[Candidate]:
        """All columns with their values."""
        indices = range(len(self.names))
        values = read_values(self.table, list(indices))
        pairs = inputs_and_outputs(self.names)
        found = []
        for k in indices:
            reading = read_name(self.names[k], f"{self.source}: column `{self.names[k]}`")
            if reading.role is None and k in pairs:
                reading = replace(reading, role=pairs[k])
            dated = k not in values and self.table.is_dated(k)
            found.append(Candidate(k, self.names[k], reading, values.get(k), dated))
        return found

    def per_turn(self, one: Candidate, role: str) -> float | None:
        """Return the readings per revolution of a column in a role, or None without a unit.

        The number is negative for an inverted encoder.
        """
        unit = one.reading.unit or self.request.units.get(role)
        counts = self.request.counts
        if unit is None and counts is not None:
            unit = "counts"
        if unit is None:
            return None
        scale = float(as_fraction(getattr(self.request, f"{role}_scale") or 1, ""))
        sign = (-1.0 if role in self.request.inverted else 1.0) / scale
        if unit != "counts":
            return sign * REV / ANGLE_UNITS[unit]
        if counts is None:
            raise question.no_counts(role, one.name, self.source)
        return sign * counts[SHAFTS.index(role)]

    def common(self, first: Candidate, second: Candidate) -> tuple[np.ndarray, np.ndarray]:
        """Return the readings of two columns at common instants.

        If the columns have different time stamps, each reading of `first` is paired with the next
        reading of `second` at the same or a later time.
        """
        assert first.values is not None and second.values is not None
        table = self.table
        if has_clocks(table) and isinstance(table, NestedTable):
            stamps = [table.clocks[one.index] for one in (first, second)]
            if stamps[0] != stamps[1]:
                a, b = table.columns(stamps)
                inside = (a >= b[0]) & (a <= b[-1])
                return first.values[inside], second.values[np.searchsorted(b, a[inside])]
        size = min(len(first.values), len(second.values))
        return first.values[:size], second.values[:size]
