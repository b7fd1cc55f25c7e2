"""Which column of a table has which role, in which unit: from statements, names and motion."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property
from itertools import combinations, permutations
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Real

from ...base.errors import LogError, VttigError
from ...base.units import ANGLE_UNITS, LENGTH_UNITS, REV
from ...pair.schema import GearTable, PairSpec, UnitTable, as_fraction
from ..channel.unwrap import complete
from ..readers.column_names import (
    ANGLES,
    DIRECTION,
    ROLES,
    ROW,
    ROW_INDEX,
    SHAFT_UNITS,
    TURNING,
    Column,
    default_column,
    fold,
    index_of,
    inputs_and_outputs,
    is_error,
    is_setpoint_first,
    is_transmission_error,
    name_and_unit,
    read_name,
    scale_of,
    unit_of,
    words_of,
)
from ..readers.table import Table
from ..readers.times import EPOCHS, epoch_unit
from ..slope import APART, MOST_ROWS, TOLERANCE, ratio_option, slope
from ..source import SKIP, Source, refuse_values
from .candidates import (
    EQUAL,
    HINTS,
    MOST_LISTED,
    Candidate,
    Guess,
    Question,
    ask,
    have_slope,
    is_copy,
    is_speed_of,
    listed_facts,
    turns_of,
)
from .request import SHAFTS, Statement, in_words

DAYS = ((36_526, 73_051), (730_486, 767_011))
"""Ranges of day numbers from 2000 to 2100, as Excel (since 1900) and MATLAB (since the year 0)
count days."""

SHORT_S = 1e-4
"""Time stamps with a smaller median step than this may be days instead of seconds (chosen)."""

_ONE_CLOCK = 0.1
"""Stamps of two columns belong to one clock if their difference changes by at most this fraction of
the median step (chosen)."""

_COUNTS = "--counts A,B with the counts per revolution of the driving and of the driven encoder"


@dataclass(frozen=True)
class Roles:
    """Columns of a table by their roles.

    - `statement`: what the user states. - `columns`: role → column.
    - `guesses`: what was recognised without a statement. - `questions`: what stays open.
    - `names`: role → name of its column, or `#number` if another column has the same name.
    - `units`: role → unit that is stated or recognised beside the column name.
    """

    statement: Statement
    columns: Mapping[str, Column]
    guesses: tuple[Guess, ...]
    questions: tuple[VttigError, ...]
    names: Mapping[str, str]
    units: Mapping[str, str]

    @property
    def spec(self) -> PairSpec | None:
        """Content of the pair file that states all this; None if a pair file was given."""
        if self.statement.drive is None:
            return None
        driving, driven = (GearTable(encoder=one) for one in self.statement.encoders)
        return PairSpec(
            drive=self.statement.drive,
            driving=driving,
            driven=driven,
            log=msgspec.structs.replace(self.statement.layout, **self.names),
            unit=msgspec.structs.replace(UnitTable(), **self.units),
        )


def assign(table: Table, statement: Statement) -> Roles:
    """Return the columns of a table by their roles: stated, with known names, or recognised.

    A column is taken if the statement names it, then if it has a name that this package writes,
    such as `driving_deg`, then by the words in its name, and then by the ratio. Questions that stay
    open are in the result.

    **Raises** `LogError` for a stated name that no column or several columns have, and for
    statements that contradict each other or the names.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.readers.table import Table
    >>> from vttig_jax.logs.recognition.assign import assign
    >>> from vttig_jax.logs.recognition.request import DriveRequest
    >>> t = np.arange(0, 9, 0.1)
    >>> x = 360 * t * (9 - t)
    >>> table = Table(("clock_s", "motor_deg", "load_deg"), (t, x, x / 2), "log")
    >>> roles = assign(table, DriveRequest(ratio="2:1").statement())
    >>> print(*roles.guesses, len(roles.questions), sep="\\n")
    driving: column `motor_deg`, by its name; --column driving=NAME changes it
    driven: column `load_deg`, by its name; --column driven=NAME changes it
    time: column `clock_s`, by its name; --column time=NAME changes it
    0

    ```
    """
    return Search(table, statement).result()


@dataclass
class Search:
    """Search for the columns of all roles in one table.

    `roles` is role → index of its column, or `ROW_INDEX`; `units` is role → unit that is not in the
    column name.
    """

    table: Table
    statement: Statement
    roles: dict[str, int] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    asked: list[VttigError] = field(default_factory=list)

    def __post_init__(self) -> None:
        unit, self.shaft_units = self.statement.unit, ANGLES
        if self.statement.layout.lead_mm is not None:
            self.shaft_units = SHAFT_UNITS
        self.units = {r: u for r in unit.__struct_fields__ if (u := getattr(unit, r)) is not None}
        self.source, self.timed = self.table.source, self.statement.layout.sample_rate_hz is None
        self.clocked = self.statement.layout.driving_rpm is not None

    def result(self) -> Roles:
        """Find the columns of all roles.

        A question does not stop the search for columns that are independent of it, so that a log
        with an open question has the same time column as without it.
        """
        self._take_stated()
        self._take_defaults()
        self._find_named_shafts()
        shafts_open = bool(self.asked)
        if self.timed and "time" not in self.roles and not self.table.clocks:
            with self._asking():
                self._find_time()
        known = self.statement.ratio is not None
        if self.missing and not shafts_open and (not self.asked or not known):
            with self._asking():
                self._find_by_ratio()
        if self.timed and "time" in self.roles:
            with self._asking():
                self._find_time_unit()
        self._turn_errors()
        for check in (self._check_names, self._check_units, self._check_values):
            with self._asking():
                check()
        text = self.statement.two_readings
        if text and "/" not in text and "transmission_error" in self.roles:
            # A curve with a ratio such as 225 does not show which shaft turns faster.
            self.asked.append(self._two_readings("bare-ratio"))
        return Roles(
            self.statement,
            {} if self.asked else self._columns(),
            tuple(self.guesses),
            tuple(self.asked),
            {role: self.name_of(index) for role, index in self.roles.items()},
            dict(self.units),
        )

    @property
    def shafts(self) -> dict[str, Candidate]:
        """Role → column of the shafts that have one."""
        return {role: self.candidate(self.roles[role]) for role in SHAFTS if role in self.roles}

    @property
    def missing(self) -> list[str]:
        """Shafts whose column is still searched; a clock or an error may stand in its place."""
        replaced = {"driving": self.clocked, "driven": "transmission_error" in self.roles}
        return [role for role in SHAFTS if role not in self.roles and not replaced[role]]

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Collect a question that the body raises."""
        try:
            yield
        except VttigError as error:
            self.asked.append(error)

    def _have_asked(self, *slugs: str) -> bool:
        return any(getattr(one, "slug", "") in slugs for one in self.asked)

    def _take_stated(self) -> None:
        """Assign roles to the columns that the statement names."""
        layout, names, own = self.statement.layout, self.table.names, self.table.own
        if layout.driven is not None and layout.transmission_error is not None:
            raise LogError(
                "columns for `driven` and `transmission_error` are both named; keep one of them.",
                where=self.source,
            )
        if self.clocked and layout.driving is not None:
            raise LogError(
                "a driving column and `driving_rpm` are both given; keep one of them.",
                where=self.source,
            )
        for role in ROLES:
            name = getattr(layout, role)
            if name is not None and (role != "time" or self.timed):
                index = ROW_INDEX if name == ROW else index_of(name, role, names, self.source)
                self.roles[role] = index
                computed = self.table.computed[index - own] if index >= own else None
                if computed is not None and computed.unit is not None:
                    self.units.setdefault(role, computed.unit)

    def _take_defaults(self) -> None:
        """Assign roles to the columns with names that this package writes, such as driving_deg."""
        second = {"driven", "transmission_error"}
        for role in ("time", *SHAFTS, "transmission_error"):
            taken = role in self.roles or (role in second and second & set(self.roles))
            unused = (role == "time" and not self.timed) or (role == "driving" and self.clocked)
            if taken or unused:
                continue
            try:
                index = default_column(role, self.table.names, self.source)
            except LogError as error:
                index = None
                if role != "time":  # the time is searched next to the shafts
                    self.asked = self.asked or [error]
            free = index not in self.roles.values()
            if index is not None and (free or self.statement.in_file):
                self.roles[role] = index
        if "direction" not in self.roles:
            named = [k for k, n in enumerate(self.table.names) if DIRECTION & {*words_of(n)}]
            found = [k for k in range(self.table.own) if self.table.first_way(k)] or named
            said = [c for c in map(self.candidate, found) if c.is_sign and c in self.free()]
            if len(said) > 1:
                self.asked.append(self._several("direction", said))
            elif said:
                self._take("direction", said[0], "by-words")

    def _several(self, role: str, columns: Sequence[Candidate]) -> Question:
        """Return the question for several columns of a role."""
        options = [f"--column {role}='{one.name}'" for one in columns[:4]]
        return self._ask("several-columns", role=role, columns=columns, options=options)

    def _find_named_shafts(self) -> None:
        """Assign the shafts by the column names."""
        for role in self.missing:
            with self._asking():
                found = self._by_name(role, self._beside(role))
                if found is not None:
                    self._take(role, found, "by-name")
        said = [o for o in self.free() if o.turns and is_transmission_error(o.name, self.source)]
        if "driven" in self.missing and len(said) == 1:
            self._take("transmission_error", said[0], "by-name")

    def _by_name(self, role: str, candidates: Sequence[Candidate]) -> Candidate | None:
        """Return the column whose name contains a role, or None if there is no such name.

        Words such as `joint` say the driven shaft beside a column that is the driving one.

        **Raises** `Question` for several such columns, or if the only one is a setpoint.
        """
        possible = [one for one in candidates if one.reading.is_angle]
        named = [one for one in possible if one.reading.role == role]
        if len(named) > 1:
            named = [one for one in named if one.turns] or named
        if len(named) == 2 and all(one.has_levels for one in named):
            return None  # two channels of one encoder, which are counted
        if len(named) > 1:
            raise self._several(role, named)
        if not named and role == "driven" and "driving" in self.roles:
            sides = [one for one in possible if one.reading.output_side and one.turns]
            return sides[0] if len(sides) == 1 and not sides[0].reading.setpoint else None
        if named and named[0].reading.setpoint:
            raise self._only_a_setpoint(role, named)
        return named[0] if named else None

    def _find_time(self) -> None:
        """Assign the time to one of the columns without another role.

        It is the only column of dates, or with a name for time or a unit of time. Without such a
        column it is the only one whose values always grow, are evenly spaced and are not row
        numbers, or the only one with a name for time, whose stamps are then wrong. Columns of the
        same stamps count as one.
        """
        candidates = self._beside("time")
        named = [one for one in candidates if one.dated or one.says_time]
        rising = [one for one in candidates if one.can_be_time]
        wrong = [one for one in candidates if one.reading.role == "time"]
        first = named[0].values if named else None
        for one in named[1:]:
            values = one.values
            same = values is not None and first is not None and np.array_equal(values, first)
            if not same or one.reading.unit != named[0].reading.unit:
                raise self._several("time", named)
        if len(named) > 1:
            self._take("time", named[0], "same-stamps", other=named[1].name)
        elif named:
            self._take("time", named[0], "only-dates" if named[0].dated else "by-name")
        elif len(rising) == 1 and rising[0].is_even:
            self._take("time", rising[0], "grows-evenly")
        elif len(wrong) == 1:
            self._take("time", wrong[0], "by-name")
        elif self.table.first_way(self.roles.get("direction", ROW_INDEX)):
            self._take_standstill()
        else:
            growing = [one for one in candidates if one.rises]
            seen = f"; columns that only grow are {listed_facts(growing)}" if growing else ""
            raise self._ask("no-time", role="time", columns=growing, seen=seen)

    def _take_standstill(self) -> None:
        """Take a table that says how its places were approached, and no time, as one without."""
        layout = msgspec.structs.replace(self.statement.layout, sample_rate_hz=1.0)
        self.statement, self.timed = replace(self.statement, layout=layout), False
        self.guesses.append(Guess.of("standstill", "time", "--sample-rate HZ"))

    def _turn_errors(self) -> None:
        """Take errors that are the setpoint minus the measured angle with the other sign."""
        index = self.roles.get("transmission_error", ROW_INDEX)
        driving, driven = self.statement.encoders
        own = 0 <= index < self.table.own and is_setpoint_first(self.table.names[index])
        if own and self.statement.drive is not None and driven.sign > 0:
            encoders = driving, msgspec.structs.replace(driven, sign=-1)
            self.statement = replace(self.statement, encoders=encoders)
            name = self.table.names[index]
            option = f"--column 'transmission_error=1*{name}'"
            self.guesses.append(Guess.of("setpoint-first", "transmission_error", option, name=name))

    def _find_by_ratio(self) -> None:
        """Assign the missing shafts to the only columns that have the given ratio.

        **Raises** `Question` if no assignment or several have it, for columns without a unit, and
        for shafts whose readings have opposite directions.
        """
        free, ratio, fixed, missing = self.free(), self.statement.ratio, self.shafts, self.missing
        if "transmission_error" in self.roles:
            angles = [one for one in free if one.turns and one.reading.unit in ANGLES] or free
            option, told = self._driving_option(angles)
            seen = f"; there are {listed_facts(free)}" * bool(free) + told
            raise self._ask(
                "driving-open", role="driving", columns=angles, options=[option], seen=seen
            )
        if not self._ratio_decides:
            raise self._shafts_open([one for one in free if one.reading.is_angle])
        if lacking := [one.index for one in fixed.values() if one.values is None]:
            self.table.columns(lacking)  # raises for the field without a number
        turning = [one for one in free if one.turns and one.reading.is_angle]
        listed = [*turning, *(one for one in free if one.is_constant)]
        possible = [one for one in turning if one.reading.role is None]
        # A second column with the name of a known shaft, such as `Input 2` beside `Input 1`.
        possible += [o for o in turning if o.reading.role in fixed and not o.reading.setpoint]
        if len(possible) < len(missing):
            for one in free:  # raises for a field without number in a column that may be a shaft
                angle = one.values is None and one.reading.is_angle and not one.dated
                if angle and self.table.starts_with_a_number(one.index):
                    self.table.columns([one.index])
            raise self._shafts_open(listed)
        angles = [one for one in possible if one.reading.unit is not None]
        lacks = "driven" in missing and "time" not in self.roles and len(angles) < len(missing)
        if lacks and self._error_columns():
            raise self._shafts_open(listed)
        signs, unknown = self.fitting_pairs(fixed, possible)
        if unknown and not signs and not all(one.has_levels for _, one in unknown):
            raise self._no_unit(unknown)
        if not signs:
            raise self._shafts_open(listed, possible)
        pairs = list(signs)
        if ratio == 1:  # at another ratio two shafts of a simulation may be as exact as a copy
            pairs = [pair for pair in pairs if not is_copy(*pair)] or pairs
        measured = [pair for pair in pairs if not any(one.reading.setpoint for one in pair)]
        pairs = measured or pairs
        if len(pairs) > 1:
            # On a linear axis `axis` says no side.
            linear = self.statement.layout.lead_mm is not None
            sided = [pair for pair in pairs if pair[1].reading.output_side and not linear]
            if len(sided) != 1:
                columns = list({one.index: one for pair in pairs for one in pair}.values())
                drivers = [a.name for a, b in pairs if b is pairs[0][1]]
                words = {"first": pairs[0][0].name, "second": pairs[0][1].name, "mean": ""}
                words["pairs"] = ", or ".join(f"`{a.name}` drives `{b.name}`" for a, b in pairs[:4])
                if len(drivers) == len(pairs) == 2:
                    words["mean"] = self._hint("mean", sum="+".join(drivers))
                raise self._ask("several-pairs", columns=columns, number=len(pairs), **words)
            pairs = sided
        if signs[pairs[0]] < 0:
            invert = self._hint("invert")
            raise self._ask("opposite-directions", columns=pairs[0], options=[invert])
        if self.statement.two_readings:
            raise self._two_readings("ratio-of-two-readings")
        driven, rest = pairs[0][1], [one for one in turning if one not in pairs[0]]
        errors = self._error_columns()
        if "driven" in missing and len(errors) == 1 and is_copy(*pairs[0]):
            option = f"--column driving='{pairs[0][0].name}' " * ("driving" in missing)
            option += f"--column transmission_error='{errors[0].name}'"
            about = {"role": "driven", "columns": [*pairs[0], *errors], "options": [option]}
            raise self._ask("computed-beside-error", **about)
        rest += errors
        if "driven" in missing and driven.reading.setpoint and rest:
            raise self._only_a_setpoint("driven", [driven, *rest])
        for role, one in zip(SHAFTS, pairs[0], strict=True):
            if role in missing:
                self._take(role, one, "by-name" if one.reading.output_side else "by-ratio")

    def _only_a_setpoint(self, role: str, columns: Sequence[Candidate]) -> Question:
        """Return the question for a planned angle; other columns may be the errors from it."""
        words = {"setpoint": columns[0].reading.setpoint, "error": ""}
        for one in columns[1:]:
            words["error"] += self._hint("error", name=one.name)
        return self._ask("only-a-setpoint", role=role, columns=columns, **words)

    def _two_readings(self, slug: str) -> Question:
        text, ratio = self.statement.two_readings, self.statement.ratio
        assert ratio is not None  # it is the one with two readings
        above, _, below = text.replace(" ", "").partition("/")
        words = {"one": f"{below or 1}:{above}", "other_ratio": f"{above}:{below or 1}"}
        words |= {"turns": in_words(ratio), "inverse": in_words(1 / ratio)}
        return self._ask(slug, where="", text=text, **words)

    @property
    def _ratio_decides(self) -> bool:
        """Whether a ratio is given, and the shaft that is not searched has a column."""
        return self.statement.ratio is not None and not (self.clocked and self.missing)

    def _shafts_open(
        self, candidates: Sequence[Candidate], turning: Sequence[Candidate] = ()
    ) -> Question:
        """Return the question for shafts that neither the names nor the ratio determine.

        Columns whose names have a unit of angles are listed first, and constant columns and those
        of other quantities as left out. `turning` are columns that do not have the given ratio.
        """
        missing, given = self.missing, self._ratio_decides
        still = [one for one in candidates if one.is_constant and one.reading.is_angle]
        moving = [one for one in candidates if not one.is_constant]
        moving.sort(key=lambda one: bool(one.reading.setpoint))
        moving.sort(key=lambda one: (not one.reading.is_angle, one.reading.unit is None))
        others = [o for o in self.free() if (o.turns or o.has_levels) and o.reading.other]
        errors = self._error_columns()
        side = {"driving": 0, "driven": 2}
        channels = [one for one in moving + others if one.has_levels]
        volts = [one for one in others if one.is_voltage]
        if channels and len({*channels, *volts}) == 2 * len(missing):  # levels, and sines in volts
            channels = list(dict.fromkeys([*channels, *volts]))
        channels.sort(key=lambda one: side.get(str(one.reading.role), 1))
        levels = [one.name for one in channels]
        counted = list(zip(missing, levels[::2], levels[1::2], strict=False))
        options, told = " ".join(f"--column {role}=NAME" for role in missing), ""
        if len(errors) == 1 and "driven" in missing and "time" not in self.roles:
            angles = [one for one in moving if one.reading.unit in ANGLES]
            option, told = self._driving_option(angles)
            options = f"{option} " * ("driving" in missing)
            options += f"--column transmission_error='{errors[0].name}'"
        if len(counted) == len(missing):  # channels with two levels
            options = " ".join(f"--quadrature {role}='{a},{b}'" for role, a, b in counted)
            options += " --counts A,B" * (not self.statement.counted)
        volts = volts * (not moving and not levels)
        if len(volts) >= len(missing):  # analogue outputs of encoders
            options += " --counts A,B" * (not self.statement.counted)
        lengths = [one for one in others if one.reading.other in LENGTH_UNITS]
        if lengths and not moving and given:
            if len(missing) == len(lengths) == 1:
                options = f"--column {missing[0]}='{lengths[0].name}'"
            options += " --lead-mm MM"
        if not given:
            why = "and without a ratio the motion says nothing"
            # `answer_to` takes what follows the last ", or ", which is the option for columns.
            stated = "--ratio A:B (driving turns to driven turns) or --teeth Z1/Z2, or "
            options = stated * (not self.clocked) + options
        elif volts or levels:
            why = "and volts and levels are no angles"
        elif lengths and not moving:
            why = "and a length is an angle only with its lead"
        elif not moving:
            why = "and no other column holds numbers that change"
        else:
            assert self.statement.ratio is not None
            why = f"and no columns turn as given ({in_words(self.statement.ratio)})"
        seen = f"; there are {listed_facts(moving)}" if moving else ""
        if turning:
            pairs = self._turning_together(turning)
            shown = [f"{said} where `{a.name}` drives `{b.name}`" for said, _, a, b in pairs[:4]]
            seen = f"; the log shows {', or '.join(shown)}" * bool(shown) + seen
            if len(pairs) == 1 and pairs[0][1]:
                named = zip(SHAFTS, pairs[0][2:], strict=True)
                named = [f"--column {r}='{one.name}'" for r, one in named if r in missing]
                options = " ".join([*named, pairs[0][1]])
        if len(moving) == 1 and len(missing) == 2 and not errors:
            alone = moving[0].name
            timed = "time" in self.roles and len(self.table.names) == 2
            seen += self._hint("one-channel" if timed else "row-number", alone=alone, row=ROW)
        left = [one.facts for one in still]
        if not given or not turning:  # their names say another quantity
            left += [f"`{one.name}` ({one.reading.other})" for one in others]
        seen += f"; left out: {', '.join(left[:MOST_LISTED])}" * bool(left)
        if len(levels) > 1:
            seen += "; channels with two levels are counted with --quadrature ROLE='A,B'"
        for one in (one for one in moving if self.statement.counted and one.span):
            seen += f"; `{one.name}` jumps over {one.span:.3g}: --counts gives a turn"
        for one in errors if "driven" in missing else ():
            said = f"transmission_error='{one.name}'" in options
            seen += told if said else self._hint("error", name=one.name)
        seen += self._hint("volts") * bool(volts)
        seen += "; a linear axis needs --lead-mm, its travel in mm in one turn" * bool(lengths)
        about = {"role": missing[0], "columns": moving, "options": [options]}
        return self._ask("shafts-open", roles=" and ".join(missing), why=why, seen=seen, **about)

    def _driving_option(self, angles: Sequence[Candidate]) -> tuple[str, str]:
        """Return the option for the positions beside an error, and what the question adds.

        Positions over which the driven shaft would turn less than half a turn, and the driving one
        at least nine tenths if they are those of the driven shaft, are taken for those of it.
        """
        spans = [one.travel * ANGLE_UNITS.get(one.reading.unit or "", 0) for one in angles]
        # Reversal values beside the positions are small.
        angles = [one for one, span in zip(angles, spans, strict=True) if span >= max(spans) / 100]
        ratio, scaled = self.statement.ratio, self.statement.layout.driving_scale != 1
        scale = "I with I:1" if ratio is None else str(1 / ratio)
        option, told = "--column driving=NAME", self._hint("positions", scale=scale)
        if len(angles) == 1:
            option = f"--column driving='{angles[0].name}'"
            turn = None if ratio is None or scaled else self.per_turn(angles[0], "driving")
            turns = 0.0 if turn is None else angles[0].travel / abs(turn)
            if ratio is not None and 0.9 * ratio < turns < 0.5 / ratio:
                return f"{option} --driving-scale {scale}", self._hint("positions-of-driving")
        return option, told * (not scaled)

    def _error_columns(self) -> list[Candidate]:
        """Return the columns without a role whose names say an angular error."""
        units = (*ANGLE_UNITS, *LENGTH_UNITS)
        said = [one for one in self.free() if one.turns and is_error(one.name)]
        return [o for o in said if name_and_unit(o.name, units, self.source)[1] is not None]

    def _turning_together(
        self, free: Sequence[Candidate]
    ) -> list[tuple[str, str, Candidate, Candidate]]:
        """Return the pairs of columns that turn together, driving and driven, behind two options.

        The first one states the ratio that they show. The second one keeps the given ratio where
        both are angles of the driven shaft, and is "" elsewhere. If no shaft has a column, the
        faster column drives, and a setpoint drives what follows.
        """
        fixed, pairs = self.shafts, combinations(free, 2)
        if fixed:
            pairs = ((fixed.get("driving", one), fixed.get("driven", one)) for one in free)
        given, seen = self.statement.ratio, []
        for first, second in pairs:
            found = self.slope(first, second)
            alike = found is not None and abs(abs(found[0]) - 1) < TOLERANCE
            swaps = second.reading.setpoint if alike else found is not None and abs(found[0]) > 1
            if swaps and not fixed:
                first, second = second, first
                found = self.slope(first, second)
            if not found or (abs(abs(found[0]) - 1) < EQUAL and is_copy(first, second)):
                continue
            option, scale = f"--ratio {ratio_option(abs(found[0]), found[1])}", ""
            if given and given != 1 and alike:
                scale = f"--driving-scale {1 / given}"
                option += f" (or {scale}, for turns of the driven shaft)"
                scale += " --invert driven" * (found[0] < 0)
            lengths = [one.reading.unit in LENGTH_UNITS for one in (first, second)]
            if sum(lengths) == 1 and given is not None:
                share = abs(found[0]) / float(given)
                lead = (self.statement.layout.lead_mm or 0.0) * share ** (2 * lengths[1] - 1)
                option += f", or --lead-mm {lead:.4g},"
            seen.append((option, scale, first, second))
        return seen

    def slope(self, first: Candidate, second: Candidate) -> tuple[float, float] | None:
        """Return the slope of `second` over `first` in turns, and its standard error.

        It is None if the columns do not turn together, and for unknown units and counts.
        """
        try:
            sizes = [self.per_turn(one, r) for one, r in ((first, "driving"), (second, "driven"))]
        except VttigError:
            return None
        both = self.turns(first, second, sizes)
        if both is None:
            return None
        x, y = (REV * angle for angle in both)
        if min(float(np.ptp(x)), float(np.ptp(y))) == 0:
            return None
        value, std = slope(x, y)
        apart = float(np.std(y - value * x)) > APART * float(np.ptp(y))
        return None if apart or value == 0 else (value, std)

    def _find_time_unit(self) -> None:
        """Set the unit of time stamps if neither the name nor the statement has it.

        **Raises** `Question` for whole numbers that are no stamps since an epoch, and for numbers
        that may be days; a pair file that does not state the unit says seconds.
        """
        one, option = self.candidate(self.roles["time"]), "--unit time=UNIT"
        if one.index == ROW_INDEX and "time" not in self.units:
            self.guesses.append(Guess.of("seconds", "time", option, name=one.name))
        if one.index == ROW_INDEX or one.dated:
            return
        if one.values is None:
            raise self._unreadable(one)
        if "time" in self.units or one.reading.unit is not None or not one.rows:
            return
        if unit := epoch_unit(one.values):
            self.units["time"] = unit
            self.guesses.append(Guess.of("epoch", "time", option, unit=unit, since=EPOCHS[unit][2]))
            return
        if not self.statement.in_file:
            about = {"role": "time", "columns": [one], "options": [option]}
            if np.all(one.values == np.rint(one.values)):
                raise self._ask("no-time-unit", **about)
            short = one.rows > 1 and float(np.median(np.abs(one.steps))) < SHORT_S
            if short and any(first <= one.values[0] <= last for first, last in DAYS):
                raise self._ask("days-or-seconds", **about)
        self.units["time"] = "s"
        self.guesses.append(Guess.of("seconds", "time", option, name=one.name))

    def _unreadable(self, one: Candidate) -> Question:
        """Return the question for the time if its stamps are neither numbers nor dates."""
        try:
            self.table.columns([one.index])
        except LogError as error:
            if error.where == self.source or SKIP in error.message:
                raise  # not a stamp, but the marks of all numbers, or a gap
            fault = error.message.split("; ")[0].rstrip(".")
            return ask("unreadable-time", error.where, role="time", columns=[one], fault=fault)
        raise AssertionError(f"column {one.name} holds numbers only")

    def _check_names(self) -> None:
        """Compare the columns that names make the shafts with the motion of all columns.

        **Raises** `Question` if a named column without a unit is the speed of another column, if
        another column holds nearly the same angle, as a setpoint and a measured angle do, or if the
        named columns do not turn as given although two other columns do. Columns that the user
        stated for both shafts are taken.
        """
        named = self.shafts
        if len(named) < len(SHAFTS):
            return
        guessed = {one.role for one in self.guesses} & named.keys()
        if self.statement.in_file and not guessed:
            return
        others = [one for one in self.free() if one.turns and one.reading.is_angle]
        for role in (role for role in SHAFTS if role in guessed):
            one = named[role]
            for other in others:
                if one.reading.unit is None and is_speed_of(one, other):
                    raise self._ask("named-speed", role=role, columns=[one, other])
            twin = next((other for other in others if self._is_twin(one, other, role)), None)
            if twin is not None:
                raise self._ask("twin-columns", role=role, columns=[one, twin])
        ratio, measured = self.statement.ratio, [o for o in others if not o.reading.setpoint]
        turn = ratio is not None and guessed and all(one.turns for one in named.values())
        if ratio is not None and turn and measured:
            fitting, unknown = self.fitting_pairs(named, ())
            if not fitting and not unknown:
                turning, _ = self.fitting_pairs({}, [*named.values(), *measured])
                for pair in turning:
                    about = {"columns": [*named.values(), *pair], "turns": in_words(ratio)}
                    raise self._ask("names-against-ratio", **about)
        self._refuse_two_clocks(*named.values())

    def _is_twin(self, one: Candidate, other: Candidate, role: str) -> bool:
        """Return whether two columns hold nearly the same angle, but not one reading twice."""
        if other.reading.setpoint or not one.turns or is_copy(one, other):
            return False
        try:
            sizes = [self.per_turn(column, role) for column in (one, other)]
        except LogError:  # counts per revolution are missing
            return False
        both = self.turns(one, other, sizes)
        return both is not None and have_slope(*both, 1.0) > 0

    def _refuse_two_clocks(self, *shafts: Candidate) -> None:
        """Raise `Question` for a table in which each shaft follows stamps of its own.

        Stamps that differ by a constant are one clock.
        """
        own = [(self.candidates[one.index - 1], one) for one in shafts if one.index > 0]
        own = [(stamps, one) for stamps, one in own if stamps.says_time and stamps.rises]
        if len(own) < 2 or self.roles.get("time") not in [stamps.index for stamps, _ in own]:
            return
        (first, a), (second, b) = own
        if first.rows == second.rows and first.values is not None and second.values is not None:
            apart = np.ptp(first.values.astype(np.float64) - second.values)
            if apart > _ONE_CLOCK * float(np.median(first.steps)):
                raise self._ask("two-clocks", role="time", columns=[first, a, second, b])

    def _check_units(self) -> None:
        """Set the unit "counts" if counts are stated; ask for missing units or counts."""
        counted, unnamed = False, list[tuple[str, Candidate]]()
        for role in (one for one in (*SHAFTS, "transmission_error") if one in self.roles):
            one = self.candidate(self.roles[role])
            unit = self._unit(one, role)
            if unit == "counts" and one.reading.unit is None:
                self.units[role] = unit
            length = name_and_unit(one.name, tuple(LENGTH_UNITS), self.source)[1]
            if self.statement.layout.lead_mm is None and (unit or length) in LENGTH_UNITS:
                raise self._no_lead(role, one)
            if unit is None:
                unnamed.append((role, one))
            if role not in SHAFTS or unit != "counts":
                continue
            counted = True
            if self.statement.counted and one.is_voltage:
                self._check_span(role, one)
            elif not self.statement.counted and not self.statement.in_file:
                raise self._ask("no-counts", role=role, columns=[one], options=[_COUNTS])
        if self.statement.counted and not counted and not self.asked:
            raise ask("unused-counts", "")
        if self._have_asked("no-unit", "scaled-unit"):
            return
        if self.asked and not {*SHAFTS} & {*self.roles, *self.units}:
            free = [one for one in self.free() if one.turns and not one.has_levels]
            turning = [one for one in free if one.reading.is_angle or one.is_voltage]
            if not self.statement.counted and not any(one.reading.unit for one in turning):
                unnamed = [("", one) for one in turning]
        volts = all(one.is_voltage for _, one in unnamed) and self._have_asked("shafts-open")
        if unnamed and not volts:
            raise self._no_unit(unnamed)

    def _check_values(self) -> None:
        """Raise `LogError` for a field without a number in a column with a role."""
        for role, index in self.roles.items() if not self._have_asked("unreadable-time") else ():
            if index == ROW_INDEX or index in self.table.clocks or self.table.is_dated(index):
                continue
            values = self.candidates[index].values
            if values is None:
                (values,) = self.table.columns([index])
            if not self.statement.layout.leaves_out_rows:
                name = self.table.names[index]
                refuse_values(role, values, Source(self.source, {role: name}, self.table.line_of))

    def _check_span(self, role: str, one: Candidate) -> None:
        """Raise `Question` for volts that jump over another span than --counts says."""
        counts, span = self.statement.encoders[SHAFTS.index(role)].counts_per_rev or 0, one.span
        near = 0.05 * span + 2 * float(np.median(np.abs(one.steps)))
        if span and abs(counts - span) > near:
            turn = Fraction(f"{span:.2g}")
            tenfold = f"--column {role}='{turn.denominator}*{one.name}' and " * (
                turn.denominator > 1
            )
            option = f"{tenfold}--counts with {turn.numerator} for {role}"
            about = {"role": role, "columns": [one], "options": [option]}
            raise self._ask("wrong-span", **about, span=span, counts=counts)

    def _unit(self, one: Candidate, role: str) -> str | None:
        """Return the unit of a column in the role of a shaft; stated counts are the last resort."""
        written = one.reading.unit if one.reading.unit in SHAFT_UNITS else None
        stated = {self.statement.unit.driving, self.statement.unit.driven}
        counted = self.statement.counted and role in SHAFTS and "counts" not in stated
        return written or self.units.get(role) or ("counts" if counted else None)

    def _no_unit(self, unnamed: Sequence[tuple[str, Candidate]]) -> Question:
        """Return the question for roles and their columns without a unit; a role may be ""."""
        in_file, columns = self.statement.in_file, list(dict.fromkeys(one for _, one in unnamed))
        (role, one), roles = unnamed[0], {role for role, _ in unnamed}
        scale = next(filter(None, (scale_of(one.name) for one in columns)), "")
        if len(roles) > 1 and not scale:
            role = ""
        where = f"{self.source}: column `{one.name}`" if in_file and role else self.source
        slug = "scaled-unit" if scale else "no-unit"
        if all(one.is_voltage for one in columns) and not in_file:
            return ask("volts-a-turn", where, role=role, columns=columns, options=["--counts A,B"])
        option = " ".join(f"--unit {one}=UNIT" for one in ([role] if role else SHAFTS))
        lengths = ", and mm or um on this axis" * (self.statement.layout.lead_mm is not None)
        words = {"option": option, "lengths": lengths, "counts": _COUNTS}
        told = self._hint(slug, role=role or "driving", **words)
        return ask(slug, where, role=role, columns=columns, options=[told], scale=scale)

    def _no_lead(self, role: str, one: Candidate) -> Question:
        return self._ask("no-lead", role=role, columns=[one], options=[self._hint("no-lead")])

    def _hint(self, slug: str, **words: str) -> str:
        """Return a text of `HINTS`, that for a pair file if it states the drive."""
        in_file = HINTS.get(f"{slug}-in-file") if self.statement.in_file else None
        return (in_file or HINTS[slug]).format(**words)

    def _columns(self) -> dict[str, Column]:
        """Return role → column with its unit.

        **Raises** `LogError` for a column with two roles, and for units that are missing, wrong or
        contradict each other.
        """
        columns: dict[str, Column] = {}
        for role in (role for role in ROLES if role in self.roles):
            index = self.roles[role]
            name = ROW if index == ROW_INDEX else self.table.names[index]
            place = f"{self.source}: column `{name}`"
            stated = self.units.get(role)
            unit = unit_of(role, name, stated, place)
            word = self.table.first_way(index)
            columns[role] = Column(role, index, name, word if fold(word) in TURNING else unit)
            twice = "".join(r for r, one in columns.items() if one.index == index and r != role)
            if twice:
                raise LogError(
                    f"this column is `{twice}` and `{role}` at once; name another column with"
                    f" --column {role}=NAME.",
                    where=place,
                )
        return columns

    def _ask(self, slug: str, **about: Any) -> Question:
        """Return a question about this table."""
        return ask(slug, about.pop("where", self.source), **about)

    def _take(self, role: str, one: Candidate, slug: str, **words: str) -> None:
        self.roles[role] = one.index
        option = f"--column {role}=NAME"
        self.guesses.append(Guess.of(slug, role, option, name=one.name, **words))

    def free(self) -> list[Candidate]:
        """Return the columns without a role that are not time stamps of another column."""
        taken = {*self.roles.values(), *self.table.clocks.values()}
        taken |= {k for one in self.table.computed for k in one.of}
        return [one for one in self.candidates if one.index not in taken]

    def _beside(self, role: str) -> list[Candidate]:
        """Return the columns without a role among which the column of `role` is searched.

        The group of a column is the part of its name before the last slash: `2` for `2/motor`. Only
        the group of the columns with a role is searched if groups are numbered, which are sections
        of a text with one log each, or if `role` is the time. If no name in this group fits the
        role, all columns without a role are returned.
        """
        free = self.free()
        taken = [self.table.names[k] for k in self.roles.values() if k != ROW_INDEX]
        groups = {name.rpartition("/")[0] for name in taken}
        if role != "time" and not all(group.isdigit() for group in groups):
            return free
        near = [one for one in free if {one.name.rpartition("/")[0]} == groups]
        named = any(one.reading.role == role or (role == "time" and one.dated) for one in near)
        return near if named else free

    def candidate(self, index: int) -> Candidate:
        """Return a column, or the row numbers as a column."""
        if index == ROW_INDEX:
            size = max((len(one) for one in self.numeric().values()), default=0)
            return Candidate(ROW_INDEX, ROW, read_name(ROW, ""), lambda _: np.arange(size))
        return self.candidates[index]

    def name_of(self, index: int) -> str:
        """Return the name of a column, or `#number` if another column has the same name."""
        names = self.table.names
        if index == ROW_INDEX:
            return ROW
        return names[index] if names.count(names[index]) == 1 else f"#{index + 1}"

    @cached_property
    def numeric(self) -> Callable[[], dict[int, Real[np.ndarray, " _"]]]:
        """Function that returns index → values of the columns that hold only numbers."""
        table, skips = self.table, self.statement.layout.missing == "skip"
        return cache(lambda: complete(table.numeric()) if skips else table.numeric())

    @cached_property
    def candidates(self) -> list[Candidate]:
        """All columns; their values are read when one of them is looked at."""
        names, units = self.table.names, self.shaft_units
        pairs = inputs_and_outputs(names)
        numeric = self.numeric  # no reference to the search, which would keep all values alive

        def read(index: int) -> Real[np.ndarray, " n"] | None:
            return numeric().get(index)

        found = []
        for k, name in enumerate(names):
            reading = read_name(name, f"{self.source}: column `{name}`", units)
            if reading.role is None and k in pairs:
                reading = replace(reading, role=pairs[k])
            found.append(Candidate(k, name, reading, read, self.table.is_dated(k)))
        if not self.statement.counted or any(one.reading.unit == "counts" for one in found):
            return found
        # Volts of an analogue encoder have their counts a turn.
        angle = lambda one: replace(one, reading=replace(one.reading, other=""))  # noqa: E731
        return [angle(one) if one.is_voltage else one for one in found]

    def per_turn(self, one: Candidate, role: str) -> float | None:
        """Return the readings per revolution of a column in a role, or None without a unit.

        The number is divided by the stated scale, and negative for an inverted encoder.
        """
        unit = self._unit(one, role)
        if unit is None:
            return None
        encoder = self.statement.encoders[SHAFTS.index(role)]
        scale = float(as_fraction(getattr(self.statement.layout, f"{role}_scale"), ""))
        radians = self.statement.radians(role, unit)
        if radians is None:
            if unit != "counts":
                raise self._no_lead(role, one)
            raise self._ask("no-counts", role=role, columns=[one], options=[_COUNTS])
        turn = encoder.counts_per_rev if unit == "counts" else REV / radians
        assert turn is not None  # `radians` is known
        return encoder.sign * turn / scale

    def turns(
        self, first: Candidate, second: Candidate, sizes: Sequence[float | None]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None:
        """Return two columns in revolutions, thinned; None without a common time or a unit.

        If the columns have different time stamps, each reading of `first` is paired with the next
        reading of `second` at the same or a later time. `sizes` are their readings per revolution.
        """
        x, y = first.values, second.values
        assert x is not None and y is not None  # only columns of numbers are compared
        stamps = [self.table.clocks.get(one.index) for one in (first, second)]
        if None not in stamps and stamps[0] != stamps[1]:
            a, b = self.table.columns([k for k in stamps if k is not None])
            inside = (a >= b[0]) & (a <= b[-1])
            x, y = x[inside], y[np.searchsorted(b, a[inside])]
        rows = min(len(x), len(y))
        if rows < 2 or None in sizes:
            return None
        thin = slice(None, None, max(1, rows // MOST_ROWS))
        x, y = (turns_of(one[:rows], size)[thin] for one, size in zip((x, y), sizes, strict=True))
        return x, y

    def fitting_pairs(
        self, fixed: dict[str, Candidate], free: Sequence[Candidate]
    ) -> tuple[dict[tuple[Candidate, Candidate], int], list[tuple[str, Candidate]]]:
        """Return the pairs (driving, driven) of columns with the given ratio, and their signs.

        `fixed` is role → column of known shafts, `free` are the columns for the others. The second
        result has a role and its column for every pair without a unit. If no pair has the ratio
        within `TOLERANCE`, those have it whose slope is as uncertain as it is off, as over less
        than a turn. At the ratio 1 a pair fits in both orders if it fits in one.
        """
        missing, ratio = [role for role in SHAFTS if role not in fixed], self.statement.ratio
        assert ratio is not None  # without it no pair fits
        unknown: list[tuple[str, Candidate]] = []
        moving: dict[tuple[Candidate, Candidate], tuple[np.ndarray, np.ndarray]] = {}
        for chosen in permutations(free, len(missing)):
            roles = {**fixed, **dict(zip(missing, chosen, strict=True))}
            sizes = {role: self.per_turn(one, role) for role, one in roles.items()}
            lacking = [role for role, size in sizes.items() if size is None]
            if lacking:
                unknown += [(role, roles[role]) for role in lacking]
                continue
            pair = roles["driving"], roles["driven"]
            both = self.turns(*pair, [sizes["driving"], sizes["driven"]])
            if both is not None:  # the two channels have a common time
                moving[pair] = both
        found: dict[tuple[Candidate, Candidate], int] = {}
        for surely in (True, False):
            for pair, both in moving.items():
                sign = have_slope(*both, float(ratio), surely=surely)
                if not sign and ratio == 1:
                    sign = have_slope(both[1], both[0], 1.0, surely=surely)
                if sign:
                    found[pair] = sign
            if found:
                break
        return found, unknown
