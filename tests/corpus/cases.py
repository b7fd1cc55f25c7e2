"""The corpus: small logs, each beside a TOML with the options of a user and what must come out.

`NAME.toml` says how `NAME.csv` (or `.lvm`, `.npz`, …) is read:

- `options`: words of the command line; `pair`: text of a pair file that they replace.
- `xfail`: why the expectation is not met yet; the test fails as soon as it is met.
- `doors`: those of `DOORS` through which the text is read, if not all; or one of `READERS` for a
  table that is no log, whose numbers stand in `[table]`.
- `needs`: the optional package without which the file is not read.
- `[log]`: `rows`, the verdict on the `ratio` and what it says, the `notes`, and for each role the
  name of its column, its unit, first and last value, the sum of all values, and the mean angle of
  a shaft in degrees.
- `[preview]`: what `inspect` reports without a ratio: columns, notes and commands.
- `[error]`: exit code, place, what the sentence `says`, and its `slug` where it has one.

A note and the sentence of an error are compared by their facts: names in backticks, options, line
numbers. The words between them may change.

    python -m tests.corpus.cases tests/corpus/NAME.csv --ratio 16:9 > tests/corpus/NAME.toml

prints what is found today (`--preview` for a log without its ratio), and `--again` instead of the
text writes all expectations anew that are met today; read the difference before you keep it.
"""

import contextlib
import io
import json
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import jsonschema
import numpy as np

import vttig_jax
from tests.schemas import load_schema
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.cli.main import main
from vttig_jax.logs import read_backlash_readings, read_deviations
from vttig_jax.pair import Gear, GearPair

FOLDER = Path(__file__).parent
DOORS = ("read_log", "inspect", "stdin")
READERS = ("backlash", "deviations", "pitches")
GEARS = GearPair(Gear(4), Gear(3, face_width_mm=20.0), module_mm=20.0, pressure_angles_deg=20.0)
"""The gears of the texts of deviations and pitches."""

FACTS = re.compile(
    r"`[^`\n]+`|--[a-z][a-z-]*(?:[= ][^\s`'();,]*[^\s`'();,.:])?|\bline \d+|#\d+|#row"
)
HEAD = ("options", "pair", "xfail", "doors", "needs")
REPEATED = ("column", "unit", "invert", "cut")
KEYWORDS = {"column": "columns", "sample_rate": "sample_rate_hz", "from": "start", "to": "stop"}

Found = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Case:
    """A text, the options with which it is read, and what is expected."""

    log: Path
    options: str = ""
    pair: str | None = None
    xfail: str | None = None
    doors: tuple[str, ...] = DOORS
    needs: str | None = None
    expected: Found = field(default_factory=dict)

    def words(self, folder: Path) -> list[str]:
        """Return the options; the pair file is written to `folder`."""
        if self.pair is None:
            return shlex.split(self.options)
        path = folder / "pair.toml"
        path.write_text(self.pair, encoding="utf-8")
        return ["--pair", str(path), *shlex.split(self.options)]


def texts_of_the_corpus() -> list[Path]:
    """All files of the corpus that are no TOML."""
    return [path for path in FOLDER.glob("[!._]*") if path.suffix not in (".toml", ".py")]


def name_of(path: Path) -> str:
    """Name of a case; a text may have two endings, as `.csv.gz`."""
    return path.name.partition(".")[0]


def cases() -> Iterator[Case]:
    """All texts of the corpus that have a TOML."""
    texts = {name_of(path): path for path in texts_of_the_corpus()}
    for path in sorted(FOLDER.glob("*.toml")):
        with path.open("rb") as file:
            table = tomllib.load(file)
        head = {name: table.pop(name) for name in [*table] if name in HEAD}
        yield Case(texts[path.stem], **head, expected=table)


def keywords(words: list[str]) -> dict[str, Any]:
    """Return the keywords of `read_log` that say the same as options of the command line."""
    found: dict[str, Any] = {}
    for option, value in zip(words[::2], words[1::2], strict=True):
        name = option.removeprefix("--").replace("-", "_")
        if name == "pair":
            found[name] = vttig_jax.load_pair(value)
        elif name in REPEATED:
            found.setdefault(name, []).append(value)
        else:
            found[name] = float(value) if name in ("sample_rate", "lead_mm") else value
    if "radius_mm" in found:
        found["lead_mm"] = 2 * np.pi * float(found.pop("radius_mm"))
    if "column" in found:
        found["column"] = dict(one.split("=", 1) for one in found["column"])
    if "=" in "".join(found.get("unit", "")):
        found["unit"] = dict(one.split("=", 1) for one in found["unit"])
    elif "unit" in found:
        (found["unit"],) = found["unit"]
    return {KEYWORDS.get(name, name): value for name, value in found.items()}


def through_read_log(case: Case, folder: Path) -> Found:
    """Return what `read_log` makes of a text, with the values of the columns."""
    try:
        log = vttig_jax.read_log(case.log, **keywords(case.words(folder)))
    except vttig_jax.VttigError as error:
        found = refused((error.exit_code, error.where, error.message), case, folder)
        slug = getattr(error, "slug", None)
        return {"error": found["error"] | ({"slug": slug} if slug else {})}
    found = reported(vttig_jax.inspect_log(log).to_json())["log"]
    curve = None if log.error is None else log.error / ARCSEC
    values = {
        "time": log.time,
        "driving": log.driving.reading,
        "driven": None if log.driven is None else log.driven.reading,
        "transmission_error": curve,
    }
    for role, column in found.items():
        if isinstance(column, dict) and "name" in column:
            array = np.asarray(getattr(log, role) if role not in values else values[role])
            column |= {"first": array[0].item(), "last": array[-1].item()}
            column["sum"] = array.sum().item()
            if role in ("driving", "driven"):
                angle = log.driving_angle if role == "driving" else log.driven_angle
                column["mean_deg"] = np.degrees(angle).mean().item()
    return {"log": found | {"notes": list(log.notes)}}


def through_inspect(case: Case, folder: Path, *, stdin: bool = False) -> Found:
    """Return what the command `inspect --json` prints about a text."""
    log = "-" if stdin else str(case.log)
    out, err = io.StringIO(), io.StringIO()
    pipe = SimpleNamespace(
        buffer=io.BytesIO(case.log.read_bytes()), closed=False, isatty=lambda: False
    )
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), patch("sys.stdin", pipe):
        code = main(["inspect", log, "--json", *case.words(folder)])
    report = json.loads(out.getvalue())
    if code:
        assert report["exit"] == code and err.getvalue().splitlines()[-1].startswith("error: ")
        return refused((code, report["where"], report["message"]), case, folder)
    validator().validate(report)
    return reported(report)


def through_reader(door: str, case: Case, folder: Path) -> Found:
    """Return what the reader of a table that is no log makes of a text."""
    try:
        if door == "backlash":
            found = read_backlash_readings(case.log, **keywords(case.words(folder)))
            angles = {"driving_deg": found.driving_angle, "backlash_deg": found.backlash}
            table = {name: (angle / DEG).tolist() for name, angle in angles.items()}
            return {"table": table | {"lines": found.lines.tolist()}}
        which = "maps" if door == "deviations" else "pitches"
        return {"table": {"text": str(read_deviations(**{which: case.log}, pair=GEARS))}}
    except vttig_jax.VttigError as error:
        found = refused((error.exit_code, error.where, error.message), case, folder)["error"]
        return {"error": found | {"of_a_log": [*{"encoder", "time_s"} & {*error.message.split()}]}}


@cache
def validator() -> Any:
    """Return the validator of the reports."""
    return jsonschema.Draft202012Validator(load_schema("vttig.inspect/1"))


def refused(seen: tuple[int, str, str], case: Case, folder: Path) -> Found:
    """Return a refusal (exit code, place, sentence); its place is without the name of the file."""
    code, where, message = seen
    assert message[-1] in ".?" and "\n" not in message, message
    for name in (str(case.log), f"<stdin>{case.log.suffix}", "<stdin>.csv"):
        where = where.removeprefix(name).removeprefix(": ")
    where = where.removeprefix(f"{folder}/")
    return {"error": {"exit": code, "where": where, "says": message}}


def reported(report: dict[str, Any]) -> Found:
    """Return the part of a report that is compared."""
    columns = report["columns"]
    found: dict[str, Any] = {"rows": report["samples"]["read"], "notes": report["notes"]}
    if report["sampling"] is not None:
        found["seconds"] = report["sampling"]["duration_s"]
    found |= {c["role"]: {"name": c["name"], "unit": c["unit"] or ""} for c in columns if c["role"]}
    if report["ratio"]["given"] is not None:
        told = report["ratio"]["verdict"], report["ratio"]["sentence"]
        return {"log": found | {"ratio": dict(zip(("verdict", "says"), told, strict=True))}}
    commands = [report.get("fit_command"), *(p["command"] for p in report.get("proposals", ()))]
    source = shlex.quote(report["source"])
    told = [one.replace(source, "LOG").replace("fit - ", "fit LOG ") for one in commands if one]
    return {"preview": found | {"names": [c["name"] for c in columns], "commands": told}}


def facts(sentence: str) -> list[str]:
    """Return what any wording of a sentence has to name: columns, options and lines."""
    return list(dict.fromkeys(FACTS.findall(sentence)))


def differences(expected: Any, found: Any, place: str = "") -> list[str]:
    """Return where something found is not as expected; what is not expected is not compared."""
    if isinstance(expected, dict):
        if not isinstance(found, dict):
            return [f"{place}: {found!r} instead of a table"]
        missing = [f"{place}.{key}: missing in {found}" for key in expected if key not in found]
        both = (differences(expected[k], found[k], f"{place}.{k}") for k in expected if k in found)
        return [*missing, *(one for part in both for one in part)]
    if place.endswith(".says"):
        return [f"{place}: no {one} in {found!r}" for one in expected if one not in found]
    if place.endswith(".notes"):
        rest = [
            f"{place}: no note with {', '.join(one)}"
            for one in expected
            if not any(all(fact in note for fact in one) for note in found)
        ]
        return [*rest, *([f"{place}: {len(found)} notes"] if len(found) != len(expected) else [])]
    if place.endswith("_deg") and isinstance(expected, list):
        same = len(found) == len(expected) and np.allclose(found, expected, rtol=1e-14, atol=0)
    elif isinstance(expected, float) and isinstance(found, float):
        same = bool(np.isclose(found, expected, rtol=1e-12, atol=1e-10))
    else:
        same = expected == found
    return [] if same else [f"{place}: {found!r} instead of {expected!r}"]


def expected_at(case: Case, door: str) -> Found:
    """Return what is expected at a door: only `read_log` gives slugs, values and all notes."""
    if door in ("read_log", *READERS) or "preview" in case.expected:
        return case.expected
    if "error" in case.expected:
        return {"error": {k: v for k, v in case.expected["error"].items() if k != "slug"}}
    told = {k: v for k, v in case.expected["log"].items() if k != "notes"}
    return {
        "log": {
            key: {k: value[k] for k in ("name", "unit") if k in value}
            if isinstance(value, dict) and key != "ratio"
            else value
            for key, value in told.items()
        }
    }


def through(door: str, case: Case, folder: Path) -> Found:
    """Return what is found at one of `DOORS` or `READERS`."""
    if door in READERS:
        return through_reader(door, case, folder)
    if door == "read_log":
        return through_read_log(case, folder)
    return through_inspect(case, folder, stdin=door == "stdin")


def as_toml(case: Case, folder: Path) -> str:
    """Return the TOML of a case with what is found today."""
    door = "read_log" if "read_log" in case.doors else case.doors[0]
    ((kind, table),) = through(door, case, folder).items()
    lines = [f"options = {json.dumps(case.options, ensure_ascii=False)}"] if case.options else []
    if case.pair:
        lines.append(f"pair = '''\n{case.pair}'''")
    if case.xfail:
        lines.append(f"xfail = {json.dumps(case.xfail, ensure_ascii=False)}")
    if case.needs:
        lines.append(f"needs = {json.dumps(case.needs)}")
    if case.doors != DOORS:
        lines.append(f"doors = {json.dumps(case.doors)}")
    lines += ["", f"[{kind}]"]
    for key, value in table.items():
        if key == "says":
            value = facts(value)
        elif key == "notes":
            value = [facts(note) for note in value]
        if isinstance(value, dict):
            value |= {"says": facts(value["says"])} if "says" in value else {}
            inner = ", ".join(
                f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in value.items()
            )
            lines.append(f"{key} = {{ {inner} }}")
        else:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines).lstrip() + "\n"


def record(words: list[str]) -> None:
    """Print the TOML of a text, or with `--again` write those of all expectations that are met."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as made:
        if words == ["--again"]:
            for case in cases():
                if not case.xfail:
                    path = FOLDER / f"{name_of(case.log)}.toml"
                    path.write_text(as_toml(case, Path(made)), encoding="utf-8")
        else:
            options = [one for one in words[1:] if one != "--preview"]
            doors = DOORS if options == words[1:] else DOORS[1:]
            case = Case(Path(words[0]), shlex.join(options), doors=doors)
            sys.stdout.write(as_toml(case, Path(made)))


if __name__ == "__main__":
    record(sys.argv[1:])
