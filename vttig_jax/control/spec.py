"""The scenario file as its author wrote it: validated fields, nothing derived. Needs no jax.

`ScenarioSpec` is the TOML of one simulated case, or with `[sweep]` of many, one `msgspec` struct a
table (`spec_tables`). Whatever is wrong is a `ScenarioError` whose `where` names file and key.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from msgspec.structs import replace

from ..base.errors import ScenarioError
from ..base.toml_file import Table, plain_table
from ..base.toml_keys import key, value_keys
from .spec_axes import SCENARIO_FILE, Sweep, parse_sweep, unknown_key
from .spec_check import check_rig, check_scenario
from .spec_tables import (
    ActuatorTable,
    Controller,
    EccentricityTable,
    EncoderTable,
    Flanks,
    FrictionTable,
    InertiaTable,
    JudgementTable,
    LoadTable,
    MapTable,
    MeshTable,
    MotionTable,
    Plant,
    RigTable,
    SamplingTable,
    ServoTable,
)


class ScenarioSpec(Table, frozen=True):
    """A whole scenario or sweep file. Either `eccentricities` or `rig`."""

    pair: Annotated[
        str, key("pair file, relative to this file", min_length=1, examples=["pair.toml"])
    ]
    plant: Annotated[Plant, key("what the driven shaft does inside the gap")] = "rigid"
    controller: Annotated[Controller, key("who shifts the driven gear, and when")] = "acceleration"
    flanks: Annotated[Flanks, key("kinematics of the eccentric pair")] = "exact"
    seed: Annotated[int, key("of the encoder noise", "1", ge=0, le=2**32 - 1)] = 0
    eccentricities: Annotated[
        EccentricityTable | None, key("offsets of the gears from their axes, and the gap")
    ] = None
    map: Annotated[MapTable, key("what the controller believes instead of the rig itself")] = (
        MapTable()
    )
    motion: Annotated[MotionTable, key("what the driving shaft is to do")] = MotionTable()
    servo: Annotated[ServoTable, key("motor of the driving shaft")] = ServoTable()
    inertia: Annotated[InertiaTable, key("of both shafts, with all that turns with them")] = (
        InertiaTable()
    )
    friction: Annotated[FrictionTable, key("of both shafts")] = FrictionTable()
    load: Annotated[LoadTable, key("of the driven shaft")] = LoadTable()
    mesh: Annotated[MeshTable, key("contact of the flanks")] = MeshTable()
    driving_encoder: Annotated[
        EncoderTable, key("of the driving shaft, as the controller reads it")
    ] = EncoderTable()
    driven_encoder: Annotated[
        EncoderTable, key("of the driven shaft, as the controller reads it")
    ] = EncoderTable()
    actuator: Annotated[ActuatorTable, key("shifts the driven gear axially")] = ActuatorTable()
    judgement: Annotated[JudgementTable, key("how a reversal is noticed")] = JudgementTable()
    sampling: Annotated[SamplingTable, key("rates of controller and plant")] = SamplingTable()
    rig: Annotated[RigTable | None, key("the rig of a run folder")] = None
    sweep: Annotated[Sweep | None, key("axes of a sweep")] = None


KEYS = {
    one.name: one for one in value_keys(ScenarioSpec) if not one.name.startswith(("rig.", "sweep."))
}
"""Every key of one case by its dotted name; these an axis of a sweep may name."""


def parse_scenario_spec(table: Mapping[str, Any], source: str = "") -> ScenarioSpec:
    """Validate a parsed TOML table; `source` is the file name for messages.

    Of a sweep, each axis is validated by itself; `with_values` validates each case as a whole.
    """
    with SCENARIO_FILE.placed(source):
        _check_places(table)
        plain = {name: value for name, value in table.items() if name != "sweep"}
        spec: ScenarioSpec = SCENARIO_FILE.convert(plain, ScenarioSpec)
        if "sweep" not in table:
            check_scenario(spec)
            return spec
        sweep = parse_sweep(table["sweep"], KEYS)
        _check_axes(sweep, spec)
        check_rig(spec)
    return replace(spec, sweep=sweep)


def load_scenario_spec(path: str | Path) -> ScenarioSpec:
    """Read and validate a scenario file (TOML) of one case."""
    spec = parse_scenario_spec(SCENARIO_FILE.read(path), str(path))
    with SCENARIO_FILE.placed(str(path)):
        if spec.sweep is not None:
            raise ScenarioError(
                "this file holds many cases; run it with `vttig sweep`, or remove [sweep].",
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


def load_sweep_spec(path: str | Path) -> ScenarioSpec:
    """Read and validate a sweep file (TOML): a scenario with `[sweep]`."""
    spec = parse_scenario_spec(SCENARIO_FILE.read(path), str(path))
    if spec.sweep is None:
        also = "" if spec.rig is None else "; an empty [sweep] runs the draws of `rig` alone"
        raise ScenarioError(
            f"missing; a sweep names its axes in [sweep], one case is run with `vttig simulate`"
            f"{also}.",
            where=f"{path}: sweep",
        )
    return spec


def spec_table(spec: ScenarioSpec) -> dict[str, Any]:
    """The TOML table of a spec: `parse_scenario_spec(spec_table(spec)) == spec`."""
    table = plain_table(replace(spec, sweep=None))
    return table if spec.sweep is None else {**table, "sweep": spec.sweep.table}


def with_values(spec: ScenarioSpec, values: Mapping[str, Any]) -> ScenarioSpec:
    """One case: the scenario with other values, validated again.

    **Arguments**
    - `spec`: the scenario or sweep; its `[sweep]` is left out of the result, its `rig` where
      `values` names eccentricities.
    - `values`: dotted key → value, a Python number or text.

    **Raises** `ScenarioError` for an unknown key, a value out of bounds and a contradiction.

    **Example**
    ```python
    >>> from vttig_jax.control.spec import parse_scenario_spec, with_values
    >>> spec = parse_scenario_spec({"pair": "p.toml", "rig": {"from": "RUN"}})
    >>> with_values(spec, {"motion.reversal_deg": 720.0, "controller": "none"}).motion.reversal_deg
    720.0

    ```
    """
    case = _with_values(spec, values)
    check_scenario(case)
    return case


def _with_values(spec: ScenarioSpec, values: Mapping[str, Any]) -> ScenarioSpec:
    table = spec_table(replace(spec, sweep=None))
    if any(name.startswith("eccentricities.") for name in values):
        table.pop("rig", None)
    for name, value in values.items():
        if name not in KEYS:
            raise ScenarioError(unknown_key(name, KEYS), where=name)
        above, _, last = name.rpartition(".")
        (table.setdefault(above, {}) if above else table)[last] = value
    return SCENARIO_FILE.convert(table, ScenarioSpec)


def _check_places(table: Mapping[str, Any]) -> None:
    """Refuse what belongs to a sweep where it stands in the wrong table."""
    if "zip" in table:
        raise ScenarioError("belongs into [sweep], beside the axes it names.", where="zip")
    sweep = table.get("sweep")
    if isinstance(sweep, dict) and "rig" in sweep:
        raise ScenarioError(
            "no axis; `rig` stands at the top of the file, before the first table.",
            where="sweep.rig",
        )


def _check_axes(sweep: Sweep, spec: ScenarioSpec) -> None:
    if spec.rig is None and not sweep.axes:
        raise ScenarioError(
            'names no axis; write for example "motion.reversal_deg" = { from = 360, to = 5760,'
            " num = 1000 }.",
            where="sweep",
        )
    for name in sweep.axes:
        if spec.rig is not None and name.startswith("eccentricities."):
            raise ScenarioError(
                "given beside `rig`, which draws all eccentricities; keep one of them.",
                where=f'sweep."{name}"',
            )
