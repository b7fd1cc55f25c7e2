"""What a sweep is made of: everything that another process needs to run a part of it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from msgspec.structs import replace

from ..base.errors import ScenarioError
from ..base.toml_file import plain_table
from ..pair.eccentricities import Eccentricities
from ..pair.gears import GearPair
from .controller import Controller
from .simulate import gears
from .spec import ScenarioSpec, load_sweep_spec, spec_table
from .spec_axes import SCENARIO_FILE
from .spec_tables import MapTable
from .sweep_cases import SweepCases, rig_table

_PACKAGES = ("vttig-jax", "jax", "numpy")


@dataclass(frozen=True)
class Recipe:
    """See `sweep` for what the fields are; `folder` is where recorded motions lie."""

    spec: ScenarioSpec
    pair: GearPair
    folder: Path
    rigs: tuple[Eccentricities, ...] = ()
    controller: Controller | None = None

    def cases(self) -> SweepCases:
        """The cases of the sweep."""
        return SweepCases(self.spec, self.pair, self.folder, self.rigs, self.controller)

    @property
    def header(self) -> dict[str, Any]:
        """What must agree for a sweep to be continued."""
        return {
            "schema": "vttig.sweep_parts/1",
            "versions": {name: version(name) for name in _PACKAGES},
            "pair": _digest(self.pair),
            "rigs": _digest(self.rigs),
            "controller": _digest(self.controller),
            "scenario": spec_table(self.spec),
        }


def recipe_of(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | None = None,
    folder: str | Path | None = None,
    rigs: Sequence[Eccentricities] = (),
    believed: Eccentricities | None = None,
    controller: Controller | None = None,
) -> Recipe:
    """What a sweep is made of, read and validated; see `sweep`."""
    source = "" if isinstance(spec, ScenarioSpec) else str(spec)
    whole = spec if isinstance(spec, ScenarioSpec) else load_sweep_spec(spec)
    with SCENARIO_FILE.placed(source):
        if whole.sweep is None:
            raise ScenarioError("missing; a sweep names its axes in [sweep].", where="sweep")
        if whole.rig is not None and not rigs:
            raise ScenarioError(
                "names a posterior, which `vttig sweep` draws from; in Python give"
                " rigs=vttig_jax.rig_draws(posterior, 200), believed=fit.eccentricities().",
                where="rig",
            )
        if controller is not None and "controller" in whole.sweep.axes:
            raise ScenarioError(
                "an axis, but a controller of your own is given; remove one of them.",
                where="sweep.controller",
            )
        if believed is not None:
            known = plain_table(whole.map)
            whole = replace(whole, map=MapTable(**(rig_table(believed) | known)))
        home = Path(source).parent if folder is None else Path(folder)
        found = gears(home / whole.pair) if pair is None else pair
    return Recipe(whole, found, home, tuple(rigs), controller)


def _digest(tree: Any) -> str:
    """SHA-256 of a structure and all its numbers."""
    leaves, structure = jax.tree.flatten(tree)
    found = hashlib.sha256(str(structure).encode())
    for leaf in leaves:
        found.update(np.asarray(leaf, np.float64).tobytes())
    return found.hexdigest()
