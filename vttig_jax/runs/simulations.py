"""Simulations with fitted maps: run folders and map files take the place of eccentricities."""

import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from msgspec import structs

from ..base.errors import ScenarioError, UsageError
from ..control.controllers.controller import Controller
from ..control.scenario import spec as specs
from ..control.scenario.axes import SCENARIO_FILE
from ..control.scenario.scenario import Scenario
from ..control.scenario.spec import ScenarioSpec
from ..control.simulation import simulate as simulation
from ..control.simulation.result import Simulation
from ..control.sweeps.table import SweepTable
from ..control.tuning import tune as tuning
from ..identify.backlash import contact_map
from ..identify.result import Fit
from ..kinematics.flank_table import as_flank_model
from ..pair.gear_pair import Drive, GearPair
from .maps import opened_maps
from .run import open_run
from .sweeps import sweep_in_folder


def simulate(
    scenario: str | Path | Mapping[str, Any] | ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    *,
    plant_map: Any = None,
    controller_map: Any = None,
    folder: str | Path | None = None,
    **options: Any,
) -> Simulation:
    """Simulate the run of one scenario: the gear drive, its motion and its controller.

    The plant has one map of its flanks, and the controller believes another one. By default both
    are those of [eccentricities]; the scenario or the arguments name other ones.

    **Arguments**
    - `scenario`: a `vttig_jax.control.Scenario`, a scenario file (TOML), its parsed table or
      specification, or the run folder of a fit, which is then simulated with default values.
    - `pair`: gears or drive instead of those of the scenario.
    - `plant_map`, `controller_map`: a `FlankModel`, `BacklashMap`, `Fit` or posterior draw, or a
      function (driving angle in rad, "A" or "B") → TE in rad; beside a file or table also a run
      folder or a map file.
    - `folder`: folder for relative paths; by default that of the scenario file, or else the
      working folder.
    - `options`: `controller`, `trace_every` and `progress` of `vttig_jax.control.simulate`.

    **Raises** `ScenarioError` with file and key, `PairError`, and `ValueError` without 64-bit
    floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> fit = vttig_jax.fit(rig.log(), rig.pair)
    >>> motion = {"reversal_deg": 720.0, "dwell_s": 0.2}
    >>> run = vttig_jax.simulate(
    ...     {"motion": motion, "controller": "predictive"},
    ...     rig.pair, plant_map=rig.flank_model(), controller_map=fit,
    ... )
    >>> run.outcome, run.metrics["residual_gap_deg"] < 0.0012
    ('ok', True)

    ```
    """
    if isinstance(scenario, Scenario):
        models = _models(scenario.pair, None, plant_map, controller_map, files=())
        return simulation.simulate(
            replace(scenario, pair=pair or scenario.pair, **models), **options
        )
    spec, folder = specified(scenario, folder, plant_map, controller_map, sweep=False)
    with file_named(scenario):
        pair, maps = _opened(spec, folder, pair, plant_map, controller_map)
        return simulation.simulate(spec, pair, folder=folder, maps=maps, **options)


def sweep(
    spec: str | Path | Mapping[str, Any] | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    plant_map: Any = None,
    controller_map: Any = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    **options: Any,
) -> SweepTable:
    """Simulate every case of a sweep: the Cartesian product of its axes.

    With rig = { from = "RUN", draws = N } the plant of each case has the whole map of a posterior
    draw, and the controller the map of the run, so that the table says what the machine will do
    with the map that it was given.

    **Arguments**
    - `spec`: a sweep file (TOML), its parsed table or specification.
    - `pair`, `plant_map`, `controller_map`, `folder`: as for `simulate`.
    - `controller`: controller of the user instead of that of the file.
    - `options`: `out`, the folder for `sweep.parquet`, which is written block by block; `resume`,
      to continue with the blocks that are missing there, or to return the table that is complete;
      `overwrite`, to replace the sweep there; `dask`, the address of a dask.distributed scheduler,
      whose workers get the blocks; and `devices`, `announce` and `progress` of
      `vttig_jax.control.sweep`.

    **Raises** what `vttig_jax.control.sweep` raises, and `UsageError` for a folder that may not be
    written.
    """
    read, folder = specified(spec, folder, plant_map, controller_map, sweep=True)
    with file_named(spec):
        pair, maps = _opened(read, folder, pair, plant_map, controller_map)
        return sweep_in_folder(read, pair, folder, controller, maps, **options)


def tune(
    spec: str | Path | Mapping[str, Any] | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    plant_map: Any = None,
    controller_map: Any = None,
    folder: str | Path | None = None,
    **options: Any,
) -> tuning.Tuned:
    """Tune the settings of a controller for all cases of a sweep.

    **Arguments**
    - `spec`, `pair`, `plant_map`, `controller_map`, `folder`: as for `sweep`.
    - `options`: further arguments of `vttig_jax.control.tune`, such as `free` and `objective`.
    """
    read, folder = specified(spec, folder, plant_map, controller_map, sweep=True)
    with file_named(spec):
        pair, maps = _opened(read, folder, pair, plant_map, controller_map)
        return tuning.tune(read, pair, folder=folder, maps=maps, **options)


def file_named(scenario: Any) -> AbstractContextManager[None]:
    """Return a context in which errors of a scenario name its file, if it is one."""
    return SCENARIO_FILE.error_context(str(scenario) if isinstance(scenario, (str, Path)) else "")


def specified(
    scenario: Any,
    folder: str | Path | None = None,
    plant_map: Any = None,
    controller_map: Any = None,
    *,
    sweep: bool,
) -> tuple[ScenarioSpec, Path]:
    """Return the specification with the given maps, and the folder of its relative paths."""
    given = {"plant_map": plant_map, "controller_map": controller_map}
    changes = {
        name: str(value) if isinstance(value, (str, Path)) else name
        for name, value in given.items()
        if value is not None
    }
    if isinstance(scenario, specs.ScenarioSpec):
        spec = structs.replace(scenario, **changes)
        if spec.sweep is None:
            specs.check_rig(spec)
        return spec, Path(folder or "")
    if not isinstance(scenario, Mapping):
        scenario = Path(scenario)
        if scenario.is_dir():
            scenario = _table_of_run(scenario)
        elif folder is None:
            folder = scenario.parent
    load = specs.load_sweep_spec if sweep else specs.load_scenario_spec
    return load(scenario, **changes), Path(folder or "")


def _table_of_run(path: Path) -> dict[str, Any]:
    """Return the scenario of a run folder: default values, and no controller without taper."""
    try:
        pair = open_run(path).pair
    except UsageError as error:
        raise ScenarioError(error.message, where=error.where) from None
    tapers = isinstance(pair, GearPair) and float(pair.thinning) > 0
    return {"rig": {"from": str(path)}, **({} if tapers else {"controller": "none"})}


def _opened(spec: Any, folder: Path, pair: Any, *maps: Any) -> Any:
    """Return the gears, and the flank models of all maps; see `opened_maps`."""
    return opened_maps(spec, folder, pair, _models(pair, spec.constant_backlash_deg, *maps))


def _models(pair: Any, backlash_deg: Any, *maps: Any, files: Any = (str, Path)) -> dict[str, Any]:
    """Return the flank models of the arguments `plant_map` and `controller_map` that are no files.

    `backlash_deg` is the gap of a fit whose log has one direction.
    """
    given = {}
    for name, source in zip(("plant_map", "controller_map"), maps, strict=True):
        if isinstance(source, Fit):
            source = contact_map(source, constant_backlash_deg=backlash_deg)[1]
        if source is not None and not isinstance(source, files):
            given[name] = as_flank_model(source, math.nan if pair is None else float(pair.ratio))
    return given
