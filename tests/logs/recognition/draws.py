"""Tables of two shafts in many languages, with columns that could be mistaken for a shaft."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.logs.rig_log import csv
from vttig_jax.base.units import ANGLE_UNITS, DEG


@dataclass(frozen=True)
class Language:
    """Names in one language: both shafts, angle, time, setpoint, actual value, and distractors."""

    shafts: tuple[tuple[str, str], ...]
    angle: tuple[str, ...]
    time: tuple[str, ...]
    setpoint: tuple[str, ...]
    actual: str
    others: dict[str, str] = field(default_factory=dict)


def _language(line: str) -> tuple[str, Language]:
    name, *fields, actual, others = (field.strip() for field in line.split("|"))
    shafts, angle, time, setpoint = (tuple(field.split(", ")) for field in fields)
    pairs = tuple((first, second) for first, _, second in (one.partition("/") for one in shafts))
    quantities = dict(zip(["speed", "torque", "temperature"], others.split(", "), strict=True))
    return name, Language(pairs, angle, time, setpoint, actual, quantities)


WORDS = Path(__file__).with_name("languages.txt").read_text("utf-8")
LANGUAGES = dict(map(_language, WORDS.splitlines()[1:]))
SPELT = {
    "deg": ("deg", "°", "Deg", "degrees"),
    "rad": ("rad", "radians"),
    "rev": ("rev", "turns"),
    "counts": ("counts", "cnt", "inc"),
}
COUNTS = 14400


@dataclass(frozen=True)
class Drawn:
    """Text of a log, keywords of `read_log`, role → name of its column, and the unit."""

    text: str
    options: dict[str, Any]
    roles: dict[str, str]
    unit: str


def drawn_table(seed: int) -> Drawn:
    """Return a table: a rig, names in a language, a layout of its columns, and distractors."""
    rng = np.random.default_rng([20, seed])
    words = LANGUAGES[str(rng.choice([*LANGUAGES]))]
    driving_turns, driven_turns = _turns(rng)
    time, x, y = _motion(rng, driven_turns / driving_turns)
    inverted = rng.random() < 0.1
    y = -y if inverted else y
    unit = str(rng.choice(["deg", "rad", "rev", "counts"], p=[0.5, 0.2, 0.1, 0.2]))
    shafts = [_in_unit(one, unit, _period(rng)) for one in (x, y)]
    spelt, form = _spelling(rng, unit)
    first, second = words.shafts[int(rng.integers(len(words.shafts)))]
    angle = str(rng.choice([*words.angle, ""]))
    order = " " if rng.random() < 0.5 else "_"
    bare = [order.join(filter(None, (one, angle))) for one in (first, second)]
    if rng.random() < 0.3:
        bare = [order.join(filter(None, (angle, one))) for one in (first, second)]
    names = [form.format(one, spelt) for one in bare]
    stamp = str(rng.choice(words.time)) + str(rng.choice(["", " [s]", "_s", " (s)"]))
    columns: dict[str, Any] = {stamp: time, names[0]: shafts[0], names[1]: shafts[1]}
    beside = _distractors(rng, words, (bare, names, form, spelt), (time, x, shafts))
    for name in rng.permutation([*beside])[: int(rng.integers(0, 5))]:
        columns.setdefault(str(name), beside[str(name)])
    placed = [str(name) for name in rng.permutation([*columns])]
    mark = ";" if rng.random() < 0.3 else ","
    text = csv(mark.join(placed), *(columns[name] for name in placed), mark=mark)
    options = _options(rng, (driving_turns, driven_turns), unit, inverted=inverted)
    roles = {"time": stamp, "driving": names[0], "driven": names[1]}
    return Drawn(text, options, roles, unit)


def _turns(rng: np.random.Generator) -> tuple[int, int]:
    """Return driving turns and driven turns of a reduction, a step-up, or equal shafts."""
    kind = rng.random()
    if kind < 0.12:
        return 1, 1
    if kind < 0.3:
        return int(rng.integers(50, 300)), 1
    return int(rng.integers(1, 90)), int(rng.integers(1, 90))


def _motion(rng: np.random.Generator, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time in s and both angles in deg of a run: there and back, one way, or a wave."""
    size = int(rng.integers(300, 900))
    way = np.linspace(0, 1, size)
    kind = rng.random()
    if kind < 0.5:
        way = 1 - np.abs(2 * way - 1)
    elif kind < 0.75:
        way = np.sin(2 * np.pi * 1.5 * way)
    time = np.arange(size) * float(rng.choice([0.001, 0.004, 0.01, 0.0125]))
    if rng.random() < 0.2:
        time = time + np.round(rng.uniform(-0.1, 0.1, size) * time[1], 6)
    turns = rng.uniform(2, 10) * max(1.0, min(1 / ratio, 8.0))
    x = 360 * turns * way + rng.uniform(-90, 90)
    gap = np.where(np.gradient(x) >= 0, 0.0, rng.uniform(0, 0.2))
    y = ratio * x + 0.02 * np.sin(np.radians(x) + 1) + 0.03 * np.sin(np.radians(ratio * x)) + gap
    return time - time[0], x, y


def _period(rng: np.random.Generator) -> str:
    """Return how an angle is shown: through all turns, from 0 to 360°, or from −180° to 180°."""
    return str(rng.choice(["all", "from zero", "about zero"], p=[0.7, 0.2, 0.1]))


def _in_unit(angle_deg: np.ndarray, unit: str, period: str) -> np.ndarray:
    if period == "from zero":
        angle_deg = np.mod(angle_deg, 360)
    elif period == "about zero":
        angle_deg = np.mod(angle_deg + 180, 360) - 180
    if unit == "counts":
        return np.rint(angle_deg / 360 * COUNTS).astype(int)
    return angle_deg * DEG / ANGLE_UNITS[unit]


def _spelling(rng: np.random.Generator, unit: str) -> tuple[str, str]:
    """Return how a unit is spelt, and the form of a name with it."""
    form = str(rng.choice(["{} [{}]", "{} ({})", "{}_{}", "{}"], p=[0.35, 0.2, 0.2, 0.25]))
    return (unit if form == "{}_{}" else str(rng.choice(SPELT[unit]))), form


def _distractors(
    rng: np.random.Generator,
    words: Language,
    named: tuple[list[str], list[str], str, str],
    motion: tuple[np.ndarray, np.ndarray, list[np.ndarray]],
) -> dict[str, np.ndarray]:
    """Return columns that are no measured angle of a shaft, or that repeat one."""
    bare, names, form, spelt = named
    time, x, shafts = motion
    noise = rng.normal(0, 1, len(time))
    late = np.concatenate([shafts[0][:1], shafts[0][:-1]])
    return {
        form.format(f"{bare[0]} {words.setpoint[0]}", spelt): late,
        form.format(f"{words.setpoint[-1]} {bare[1]}", spelt): shafts[1],
        f"{bare[0]} {words.actual} 2": shafts[0],
        f"{bare[0]} {words.others['speed']}": np.gradient(x, time) / 6,
        f"{bare[1]} {words.others['speed']} [rpm]": np.gradient(x, time) / 7,
        f"{words.others['torque']} {bare[1]}": noise,
        f"{words.others['temperature']} {bare[0]} [°C]": 20 + 0.01 * noise,
        "row": np.arange(len(time)),
        "#": np.arange(1, len(time) + 1),
        "cycle": np.arange(len(time)) * 2,
        "clock": time + 7,
        "ticks": np.rint(time * 1e6).astype(int),
        f"{names[0]} raw": 1.5 * shafts[0],
        "x9": np.cumsum(np.abs(noise)),
        "TE": 0.01 * noise,
    }


def _options(
    rng: np.random.Generator, turns: tuple[int, int], unit: str, *, inverted: bool
) -> dict[str, Any]:
    driving, driven = turns
    stated = rng.random()
    options: dict[str, Any] = {"ratio": f"{driving}:{driven}"}
    if stated < 0.15:
        options = {"teeth": f"{driven}/{driving}"}
    elif stated < 0.3:
        options = {"ratio": f"{driven}/{driving}"}
    elif stated < 0.35:
        options = {"ratio": driven / driving}
    if unit == "counts":
        options["counts"] = COUNTS
    elif rng.random() < 0.5:
        options["unit"] = unit
    if inverted and rng.random() < 0.6:
        options["invert"] = "driven"
    return options
