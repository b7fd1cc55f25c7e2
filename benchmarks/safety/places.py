"""Places where a hostile text can stand: every one prepares a folder and yields calls.

A place is a function of the text and of a folder that holds the valid inputs; it returns the
arguments of the calls.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

from .inputs import DRIVE, GEARS, SCENARIO, SWEEP
from .texts import argument, file_name, toml_text

Calls = list[list[str]]
Place = Callable[[str, Path], Calls]

PAIR = ["--pair", "pair.toml"]
FIT = ["fit", "log.csv", *PAIR]


def _toml(folder: Path, name: str, table: dict[str, Any]) -> str:
    (folder / name).write_text(tomli_w.dumps(table), "utf-8")
    return name


def _key(text: str) -> str:
    return f'"{"".join(f"{chr(92)}U{ord(mark):08x}" for mark in toml_text(text))}"'


def _named(folder: Path, text: str) -> str:
    return _toml(folder, "named.toml", {"name": toml_text(text)} | DRIVE)


def _named_gears(folder: Path, text: str) -> str:
    return _toml(folder, "named.toml", GEARS | {"name": toml_text(text)})


def _copy(folder: Path, source: str, text: str, suffix: str = "") -> str:
    """Return the name of a copy called like the text, or of a file that is missing."""
    name = file_name(text)
    if name is None:
        return argument(text) + suffix
    (folder / (name + suffix)).write_bytes((folder / source).read_bytes())
    return f"./{name}{suffix}"


def _log(folder: Path, *, header: str | None = None, cell: str | None = None) -> str:
    """Write a log with another name of the driven column, or with a cell more."""
    rows = (folder / "log.csv").read_text().splitlines()
    if header is not None:
        rows[0] = rows[0].replace("driven_deg", header)
    if cell is not None:
        rows[9] = rows[9].replace(",", f",{cell}", 1)
    data = "\n".join(rows).encode("utf-8", "surrogatepass")
    (folder / "other.csv").write_bytes(data)
    return "other.csv"


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def in_a_name_of_a_drive(text: str, folder: Path) -> Calls:
    """The name of the pair, in everything that follows from a fit."""
    name = _named(folder, text)
    return [
        ["inspect", "log.csv", "--pair", name],
        ["fit", "log.csv", "--pair", name, "--out", "out", "--log-file", "l.txt", "--no-figures"],
        ["map", "out", "--out", "map.csv"],
        ["export", "out", "--out", "x.json", "--constant-backlash-deg", "0.03"],
        ["export", "out", "--out", "x.csv", "--constant-backlash-deg", "0.03"],
        ["locate", "out", "--driving-deg", "4", "--driven-deg", "2"],
        ["fit", "--run", "out"],
    ]  # fmt: skip


def in_pictures(text: str, folder: Path) -> Calls:
    """The name of the pair, in the pictures of a fit."""
    return [["fit", "log.csv", "--pair", _named(folder, text), "--out", "out"]]


def in_a_name_of_gears(text: str, folder: Path) -> Calls:
    """The name of the gears, in meshes, drawings, solids and pictures."""
    name = _named_gears(folder, text)
    surface = [
        "surface",
        name,
        "--gear",
        "driving",
        "--tolerance-um",
        "200",
        "--teeth",
        "1",
        "--out",
    ]
    drawn = ["surface", name, "--gear", "driven", "--out"]
    return [
        ["measure", name],
        *([*surface, f"tooth{suffix}"] for suffix in (".stl", ".ply", ".obj", ".step")),
        *([*drawn, f"cut{suffix}"] for suffix in (".svg", ".dxf", ".png")),
    ]  # fmt: skip


def in_names_of_columns(text: str, folder: Path) -> Calls:
    """The header of a column that is read, and of one that is only listed."""
    quoted = _quoted(text)
    pair = {"log": {"driven": toml_text(text)}, "unit": {"driven": "deg"}} | DRIVE
    named = _toml(folder, "column.toml", pair)
    log = _log(folder, header=quoted)
    column = ["--column", f"driven={argument(text)}", "--unit", "driven=deg", "--ratio", "2:1"]
    return [
        ["inspect", log],
        ["inspect", log, "--pair", named],
        ["fit", log, *column, "--write-pair", "written.toml"],
        ["fit", log, "--pair", named, "--out", "out", "--no-figures"],
        ["inspect", log, "--explain-columns", *column],
    ]


def in_cells(text: str, folder: Path) -> Calls:
    """A cell of a log, of readings, of deviations and of a recorded motion."""
    quoted = _quoted(text)
    log = _log(folder, cell=quoted)
    (folder / "readings.csv").write_bytes(
        f"driving_deg,backlash_deg\n0,0.02\n{quoted},0.03\n".encode("utf-8", "surrogatepass")
    )
    (folder / "deviations.csv").write_bytes(
        f"gear,flank,roll_mm,z_mm,deviation_um\n{quoted},A,1,1,1\n".encode("utf-8", "surrogatepass")
    )
    return [
        ["inspect", log, *PAIR],
        ["fit", log, *PAIR],
        ["fit-many", log, *PAIR, "--csv", "many.csv"],
        [*FIT, "--backlash-readings", "readings.csv"],
        ["contact", "gears.toml", "--deviations", "deviations.csv"],
        ["contact", "gears.toml", "--pitch", "deviations.csv"],
    ]


def in_names_of_files(text: str, folder: Path) -> Calls:
    """The name of a log, a pair, a scenario and a sweep that exist."""
    log, pair = _copy(folder, "log.csv", text, ".csv"), _copy(folder, "pair.toml", text, ".toml")
    scenario = _copy(folder, "scenario.toml", text, ".s.toml")
    return [
        ["inspect", log],
        ["fit", log, "--pair", pair, "--out", "out", "--no-figures"],
        ["fit", "--run", "out"],
        ["fit-many", log, "--pair", pair, "--csv", "many.csv", "--out", "many"],
        ["simulate", scenario, "--set", "motion.nonsense=1"],
        ["measure", _copy(folder, "gears.toml", text, ".g.toml")],
    ]


def in_missing_files(text: str, folder: Path) -> Calls:
    """The path of a file or folder that does not exist, for every command that takes one."""
    del folder
    path = argument(text)
    return [
        ["inspect", path], ["fit", path, *PAIR], ["fit-many", path, *PAIR], ["fit", "--run", path],
        ["inspect", "log.csv", "--pair", path], [*FIT, "--backlash-readings", path],
        ["map", path], ["export", path, "--out", "x.json"], ["locate", path, "--driving-deg", "1"],
        ["sample", "--out", path], ["sample", path, *PAIR, "--out", "s"],
        ["simulate", path], ["sweep", path], ["tune", path], ["measure", path],
        ["surface", path, "--gear", "driving", "--out", "a.stl"], ["contact", path],
        ["contact", "gears.toml", "--rig", path], ["contact", "gears.toml", "--pitch", path],
        ["plan", "--pair", path, "--noise-std-deg", "0.002"],
    ]  # fmt: skip


def in_outputs(text: str, folder: Path) -> Calls:
    """The path of a file or folder to write, which another file may be in the way of."""
    name = file_name(text) or "x"
    (folder / "wall").write_text("")
    inside = f"wall/{name}"
    return [
        [*FIT, "--out", inside, "--no-figures"],
        ["map", "run", "--out", f"{inside}.csv"],
        ["export", "run", "--out", argument(text)],
        ["export", "run", "--out", f"./{name}.json", "--constant-backlash-deg", "0.03"],
        ["sample", "log.csv", *PAIR, "--out", inside],
        ["calibrate", "--out", inside, "--scenario", "white", "--rigs", "20"],
        ["surface", "gears.toml", "--gear", "driving", "--out", argument(text)],
        ["surface", "gears.toml", "--gear", "driving", "--out", f"./{name}.svg"],
        ["tune", "sweep.toml", "--out", argument(text)],
        ["demo", "--out", inside],
        ["inspect", "log.csv", "--log-file", f"{inside}.txt"],
        [*FIT, "--write-pair", f"{inside}.toml"],
    ]


def in_keys(text: str, folder: Path) -> Calls:
    """An unknown key of a pair, a scenario and a sweep, an axis, and a key of an option."""
    key, path = _key(text), argument(text)
    pair = (folder / "pair.toml").read_text()
    (folder / "key.toml").write_text(f"{key} = 1\n{pair}")
    (folder / "inner.toml").write_text(pair.replace("[log]", f"[log]\n{key} = 1"))
    (folder / "table.toml").write_text(f"{pair}\n[{key}]\nx = 1\n")
    (folder / "scene.toml").write_text(SCENARIO.replace("[motion]", f"[motion]\n{key} = 1"))
    (folder / "axis.toml").write_text(f"{SWEEP}{key} = [1, 2]\n")
    return [
        ["inspect", "log.csv", "--pair", "key.toml"],
        ["inspect", "log.csv", "--pair", "inner.toml"],
        ["fit", "log.csv", "--pair", "table.toml"],
        ["measure", "key.toml"],
        ["simulate", "scene.toml"],
        ["sweep", "axis.toml"],
        ["tune", "axis.toml"],
        ["simulate", "scenario.toml", "--set", f"{path}=1"],
        ["tune", "sweep.toml", "--free", path],
        ["plan", "--pair", "gears.toml", "--noise-std-deg", "0.002", "--assume", f"{path}=1"],
        ["plan", "--pair", "gears.toml", "--noise-std-deg", "0.002", "--want", f"{path}=1"],
        [*FIT, "--require", path],
    ]


def in_values(text: str, folder: Path) -> Calls:
    """A value in a pair, a scenario, a sweep and a run file."""
    value = toml_text(text)
    base = dict(DRIVE)
    tables = {
        "ratio": base | {"drive": {"ratio": value}},
        "encoding": base | {"log": {"encoding": value}},
        "delimiter": base | {"log": {"delimiter": value}},
        "column": base | {"log": {"driving": value}},
        "scale": base | {"log": {"driving_scale": value}},
        "unit": base | {"unit": {"driving": value}},
    }
    names = [_toml(folder, f"{name}.toml", table) for name, table in tables.items()]
    quoted = _key(text)
    (folder / "pairs.toml").write_text(SCENARIO.replace('"gears.toml"', quoted))
    (folder / "plant.toml").write_text(SCENARIO.replace('"rigid"', quoted))
    (folder / "rig.toml").write_text(
        SWEEP[: SWEEP.index("[ecc")] + f"rig = {{ from = {quoted} }}\n[motion]\ndwell_s = 0.2\n"
    )
    (folder / "axis.toml").write_text(SWEEP + f'"controller" = [{quoted}]\n')
    run = (folder / "run" / "run.toml").read_text().replace('"../log.csv"', quoted)
    (folder / "r.toml").write_text(run)
    return [
        *(["inspect", "log.csv", "--pair", name] for name in names),
        ["simulate", "pairs.toml"],
        ["simulate", "plant.toml"],
        ["simulate", "rig.toml"],
        ["sweep", "axis.toml"],
        ["fit", "--run", "r.toml"],
    ]


def in_options(text: str, folder: Path) -> Calls:
    """The value of an option, the name of an option and the name of a command."""
    del folder
    value = argument(text)
    texts = ["--ratio", "--teeth", "--counts", "--unit", "--driving-rpm", "--invert", "--column"]
    return [
        *(["inspect", "log.csv", name, value] for name in (*texts, "--most-memory")),
        [*FIT, "--delay", value],
        [*FIT, "--delay-within", value],
        [*FIT, "--loss", value],
        [*FIT, f"--{value}"],
        [value],
        ["sweep", "sweep.toml", "--dask", value],
        ["fit-many", "log.csv", *PAIR, "--dask", value],
        ["export", "run", "--out", "x.h", "--name", value],
        ["simulate", "scenario.toml", "--set", f"controller={value}"],
        ["locate", "run", "--driving-deg", value],
        ["calibrate", "--scenario", value],
        ["demo", "--seed", value],
        ["sample", "--out", "run", "--prior", value],
    ]


def in_c_names(text: str, folder: Path) -> Calls:
    """The name of gears whose compensation is written in C, and in the pictures of a contact."""
    table = GEARS | {"name": toml_text(text)}
    name = _toml(folder, "named.toml", table)
    run = folder / "gears"
    return [
        ["fit", str(folder / "gears.csv"), "--pair", name, "--out", str(run), "--no-figures"],
        ["export", "gears", "--out", "x.h"],
        ["export", "gears", "--out", "y.h", "--name", argument(text)],
        ["export", "gears", "--out", "z.h", "--quantity", "backlash", "--name", "a"],
    ]


PLACES: tuple[Place, ...] = (
    in_a_name_of_a_drive,
    in_pictures,
    in_a_name_of_gears,
    in_names_of_columns,
    in_cells,
    in_names_of_files,
    in_missing_files,
    in_outputs,
    in_keys,
    in_values,
    in_options,
    in_c_names,
)

INDEPENDENT = (in_cells, in_missing_files, in_outputs, in_keys, in_values, in_options)
"""Places whose calls do not build on each other, so that a text needs only some of them."""


def in_slow_commands(text: str, folder: Path) -> Calls:
    """The name of gears in commands that compile for long: few texts go there."""
    name = _named_gears(folder, text)
    (folder / "scenario.toml").write_text(SCENARIO.replace("gears.toml", name))
    (folder / "sweep.toml").write_text(SWEEP.replace("gears.toml", name))
    return [
        ["simulate", "scenario.toml", "--trace", "trace.csv", "--figure", "reversal.png"],
        ["sweep", "sweep.toml", "--out", "swept"],
        ["contact", name, "--out", "contact", "--span-rev", "0.1", "--step-deg", "4"],
        ["plan", "--pair", name, "--turns", "21", "--noise-std-deg", "0.002"],
        ["sample", "log.csv", "--pair", _named(folder, text), "--out", "s", "--steps", "40"],
    ]
