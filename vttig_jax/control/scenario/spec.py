"""Scenario file: reading, validation of single keys and of combinations of keys, and its defaults.

`ScenarioSpec` holds the TOML content for one simulated case, or for many cases with `[sweep]`. Each
table is one `msgspec` struct (`scenario.py`). Every error is a `ScenarioError` whose attribute
`where` names file and key.
"""

import math
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w
from msgspec.structs import replace

from ...base.errors import ScenarioError
from ...base.files.toml_io import Key, keys, plain_table, value_keys
from ..motion.motion import Reversal
from .axes import SCENARIO_FILE, Gap, parse_sweep, unknown_key
from .scenario import ECCENTRICITIES, EVENTS, Sampling, ScenarioSpec, part_of


def check_scenario(spec: ScenarioSpec) -> None:
    """Raise `ScenarioError` if keys contradict each other; its `where` is the dotted key."""
    check_choices(spec)
    table = spec.motion
    if table.kind in ("trapezoid", "s_curve"):
        motion: Reversal = part_of(EVENTS[table.event], table)
        if not motion.fits:
            raise ScenarioError(
                f"{table.reversal_deg:g} lies inside the ramps of this {table.event}; at"
                f" {table.speed_rpm:g} rpm with ramp_s = {table.ramp_s:g} it must be at least"
                f" {_rounded_up(float(motion.least_deg))}.",
                where="motion.reversal_deg",
            )
    part_of(Sampling, spec.sampling).check()


def check_choices(spec: ScenarioSpec) -> None:
    """Raise `ScenarioError` if keys without numbers contradict each other."""
    check_rig(spec)
    motion = spec.motion
    if motion.kind == "recorded" and not motion.file:
        raise ScenarioError(
            'missing; kind = "recorded" follows a CSV with time_s and driving_deg.',
            where="motion.file",
        )
    if motion.kind != "recorded" and motion.file:
        raise ScenarioError(
            f'given, but kind is "{motion.kind}"; write kind = "recorded" to follow this file, or'
            " remove it.",
            where="motion.file",
        )
    if motion.kind not in ("trapezoid", "s_curve") and motion.event != "reversal":
        raise ScenarioError(
            f'"{motion.event}" needs kind = "trapezoid" or "s_curve", but kind is "{motion.kind}".',
            where="motion.event",
        )


def check_rig(spec: ScenarioSpec) -> None:
    """Raise `ScenarioError` unless the flanks of plant and controller have one source each."""
    if spec.rig is not None and spec.plant_map != ECCENTRICITIES:
        raise ScenarioError(
            "given together with `rig`, whose map the plant has; remove one of them.",
            where="plant_map",
        )
    used = (spec.controller_map, None if spec.rig else spec.plant_map)
    if ECCENTRICITIES in used and spec.eccentricities is None:
        raise ScenarioError(
            'missing; write [eccentricities], or rig = { from = "RUN" } or plant_map = "RUN" for'
            " the map of a run folder.",
            where="eccentricities",
        )
    if spec.rig is not None and spec.eccentricities is not None and spec.controller_map is None:
        raise ScenarioError(
            "given together with `rig`; remove one of them, or write controller_map ="
            ' "eccentricities" for a controller that closes by these.',
            where="eccentricities",
        )
    if spec.controller_gap != "mean" and believed_map(spec) == ECCENTRICITIES:
        raise ScenarioError(
            "given, but [eccentricities] have no band; name a run folder with draws, or its"
            " map.csv, as controller_map.",
            where="controller_gap",
        )
    if spec.constant_backlash_deg is not None and not names_of_maps(spec):
        raise ScenarioError(
            "replaces the gap of a run folder, but none is named; write"
            " eccentricities.constant_backlash_deg.",
            where="constant_backlash_deg",
        )
    if not spec.pair and not names_of_maps(spec):
        raise ScenarioError("missing; name the pair file, relative to this file.", where="pair")


def names_of_maps(spec: ScenarioSpec) -> tuple[str, ...]:
    """Return the run folders and map files that a scenario or sweep names, each once."""
    axes = {} if spec.sweep is None else spec.sweep.axes
    named: list[str] = [] if spec.rig is None else [spec.rig.run]
    for which in ("plant_map", "controller_map"):
        named += [getattr(spec, which) or "", *_texts(axes.get(which, ()))]
    return tuple(dict.fromkeys(name for name in named if name not in ("", ECCENTRICITIES)))


def believed_map(spec: ScenarioSpec) -> str:
    """Return the name of the map that the controller believes, or "eccentricities"."""
    if spec.controller_map is not None or spec.eccentricities is not None:
        return spec.controller_map or ECCENTRICITIES
    return spec.plant_map if spec.rig is None else spec.rig.run


def believed_flanks(spec: ScenarioSpec) -> str:
    """Return the name of the flanks that the controller believes, such as "low95 of RUN"."""
    name, gap = believed_map(spec), spec.controller_gap
    return name if gap == "mean" else f"{gap} of {name}"


def lower_maps(spec: ScenarioSpec) -> dict[str, tuple[str, Gap]]:
    """Return which edges of bands a scenario or sweep believes: name → (map, edge)."""
    axes = {} if spec.sweep is None else spec.sweep.axes
    keys = ("plant_map", "controller_map", "controller_gap")
    values = [_texts(axes.get(key, ())) or [getattr(spec, key)] for key in keys]
    cases = [replace(spec, **dict(zip(keys, case, strict=True))) for case in product(*values)]
    return {
        believed_flanks(case): (believed_map(case), case.controller_gap)
        for case in cases
        if case.controller_gap != "mean" and believed_map(case) != ECCENTRICITIES
    }


def _texts(axis: Any) -> list[str]:
    return [value for value in axis if isinstance(value, str)] if isinstance(axis, tuple) else []


def _rounded_up(value: float) -> str:
    """Return the value as text, rounded up to six significant digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 5)
    return f"{math.ceil(value / step * (1 - 1e-12)) * step:.6g}"


KEYS = {
    entry.name: entry
    for entry in value_keys(ScenarioSpec)
    if not entry.name.startswith(("rig.", "sweep."))
}
"""Every key of one case by its dotted name; each of them can be an axis of a sweep."""


def parse_scenario_spec(table: Mapping[str, Any], source: str = "") -> ScenarioSpec:
    """Validate a parsed TOML table and return it as a specification.

    `source` is the file name for error messages. In a sweep the values of every axis are validated
    separately here; `with_values` validates the combination of values in each case.
    """
    with SCENARIO_FILE.error_context(source):
        if "zip" in table:
            raise ScenarioError("not at the top level; move it to [sweep].", where="zip")
        sweep = parse_sweep(table["sweep"], KEYS) if "sweep" in table else None
        plain = {name: value for name, value in table.items() if name != "sweep"}
        if "rig" in plain or "plant_map" in plain:
            plain.setdefault("pair", "")  # a run folder has its own
        spec: ScenarioSpec = SCENARIO_FILE.convert(plain, ScenarioSpec)
        if sweep is None:
            check_scenario(spec)
            return spec
        if spec.rig is None and not sweep.axes:
            raise ScenarioError(
                'names no axis; write for example "motion.reversal_deg" = { from = 360, to = 5760,'
                " num = 1000 }.",
                where="sweep",
            )
        for name in sweep.axes:
            if spec.rig is not None and name.startswith("eccentricities."):
                raise ScenarioError(
                    "given together with `rig`, which draws all eccentricities; remove one of"
                    " them.",
                    where=f'sweep."{name}"',
                )
        check_rig(with_keys(spec, {name: sweep.values(name)[0] for name in sweep.axes}))
    return replace(spec, sweep=sweep)


def load_scenario_spec(path: str | Path | Mapping[str, Any], **changes: str) -> ScenarioSpec:
    """Read and validate a scenario of one case: a file (TOML) or its parsed table.

    `changes` are further values of keys at the top of the file.
    """
    spec, source = _read(path, changes)
    with SCENARIO_FILE.error_context(source):
        if spec.sweep is not None:
            raise ScenarioError(
                "this file has many cases; run it with `vttig sweep`, or remove [sweep].",
                where="sweep",
            )
        for name in ("draws", "seed"):
            if spec.rig is not None and getattr(spec.rig, name) is not None:
                raise ScenarioError(
                    "one case runs with the fitted rig; remove this key, or run the draws of the"
                    " posterior with `vttig sweep`.",
                    where=f"rig.{name}",
                )
    return spec


def load_sweep_spec(path: str | Path | Mapping[str, Any], **changes: str) -> ScenarioSpec:
    """Read and validate a sweep: a scenario with `[sweep]`; see `load_scenario_spec`."""
    spec, source = _read(path, changes)
    if spec.sweep is None:
        hint = "" if spec.rig is None else "; an empty [sweep] runs the draws of `rig` alone"
        raise ScenarioError(
            f"missing; a sweep names its axes in [sweep], one case is run with `vttig simulate`"
            f"{hint}.",
            where=f"{source}: sweep" if source else "sweep",
        )
    return spec


def _read(
    path: str | Path | Mapping[str, Any], changes: dict[str, str]
) -> tuple[ScenarioSpec, str]:
    """Return the specification, and the name of its file; "" for a table."""
    if isinstance(path, Mapping):
        return parse_scenario_spec({**path, **changes}), ""
    return parse_scenario_spec({**SCENARIO_FILE.read(path), **changes}, str(path)), str(path)


def spec_table(spec: ScenarioSpec) -> dict[str, Any]:
    """Return the specification as a TOML table, the inverse of `parse_scenario_spec`."""
    table = plain_table(replace(spec, sweep=None))
    if spec.rig is not None:  # the plant has its map
        del table["plant_map"]
    return table if spec.sweep is None else {**table, "sweep": spec.sweep.table}


def with_values(spec: ScenarioSpec, values: Mapping[str, Any]) -> ScenarioSpec:
    """Return the scenario of one case: the given one with other values, validated again.

    **Arguments**
    - `spec`: scenario or sweep. The result has no `[sweep]`. If `values` contains eccentricities,
      they replace `rig`.
    - `values`: dotted key → value, a Python number or text.

    **Raises** `ScenarioError` for an unknown key, a value out of bounds and contradicting keys.

    **Example**
    ```python
    >>> from vttig_jax.control import parse_scenario_spec, with_values
    >>> spec = parse_scenario_spec({"pair": "p.toml", "rig": {"from": "RUN"}})
    >>> with_values(spec, {"motion.reversal_deg": 720.0, "controller": "none"}).motion.reversal_deg
    720.0

    ```
    """
    case = with_keys(spec, values)
    check_scenario(case)
    return case


def with_keys(spec: ScenarioSpec, values: Mapping[str, Any]) -> ScenarioSpec:
    """Return the scenario with other values, each of which is checked, but not all together."""
    table = spec_table(replace(spec, sweep=None))
    if any(name.startswith("eccentricities.") for name in values):
        table.pop("rig", None)
    for name, value in values.items():
        if name not in KEYS:
            raise ScenarioError(unknown_key(name, KEYS), where=name)
        above, _, last = name.rpartition(".")
        (table.setdefault(above, {}) if above else table)[last] = value
    return SCENARIO_FILE.convert(table, ScenarioSpec)


def with_numbers(spec: ScenarioSpec, values: Mapping[str, Any]) -> ScenarioSpec:
    """Return the scenario with other numbers, which are not checked; JAX may trace them."""
    for name, value in values.items():
        table, _, field = name.rpartition(".")
        if table:
            field, value = table, replace(getattr(spec, table), **{field: value})
        spec = replace(spec, **{field: value})
    return spec


_HEAD = """\
# Every key of a scenario: its default, its [unit] ([1]: a pure number) and its meaning.
# A key after # has no default; a key marked "required" must be given. The values of
# both are examples: the rig of the paper (its Table 2).
"""
_SWEEP = """\
# Only in a sweep file: [sweep] names keys of a scenario by their dotted names, slowest first.
# Each has { from, to, num } with both ends or a list of values; keys in zip advance together.
# [sweep]
# "motion.reversal_deg" = { from = 360, to = 5760, num = 1000 }
# controller = ["none", "acceleration", "predictive"]
# "motion.speed_rpm" = [30.0, 60.0]
# "motion.ramp_s" = [1.0, 0.5]
# zip = [["motion.speed_rpm", "motion.ramp_s"]]
"""


def default_toml() -> str:
    """Return a scenario file with the default, unit and meaning of every key.

    The text is valid TOML. If the keys marked as required are uncommented, it is a complete
    scenario. The table [rig], which replaces [eccentricities], and the table [sweep] of a sweep
    file follow as comments at the end.

    **Example**
    ```python
    >>> from vttig_jax.control.scenario.spec import default_toml
    >>> print(default_toml().splitlines()[4])
    plant = "rigid"              # play | rigid | elastic: model of the driven shaft and the contact

    ```
    """
    top = list(keys(ScenarioSpec))
    parts = [_HEAD + _lines([entry for entry in top if entry.table is None])]
    for entry in top:
        if entry.table is not None and entry.name != "sweep":
            header, hidden = f"[{entry.name}]  # {entry.meaning}\n", entry.name == "rig"
            if hidden:
                header = f"# Instead of [eccentricities]: {entry.meaning}.\n# [rig]\n"
            parts.append(header + _lines(list(keys(entry.table)), hidden))
    return "\n".join([*parts, _SWEEP])


def _lines(table: list[Key], hidden: bool = False) -> str:
    """Return one line of TOML per key with aligned comments.

    If `hidden`, all keys are commented out; otherwise only those without a default.
    """
    starts = []
    for entry in table:
        absent = entry.required or entry.default is None
        value = entry.examples[0] if absent else entry.default
        hide = "# " if absent or hidden else ""
        starts.append(hide + tomli_w.dumps({entry.name.rpartition(".")[2]: value}).strip())
    width = max(map(len, starts))
    return "".join(
        f"{start:{width}}  # {_comment(key)}\n" for start, key in zip(starts, table, strict=True)
    )


def _comment(entry: Key) -> str:
    literals = [kind for kind in entry.types if get_origin(kind) is Literal]
    choices = [choice for kind in literals for choice in get_args(kind)]
    parts = [
        "required: " * entry.required,
        f"[{entry.unit}] " * bool(entry.unit),
        " | ".join(choices) + ": " * bool(choices),
        entry.meaning,
    ]
    return "".join(parts)
