"""Scenario of a simulation: its objects, and the tables of a file, which follow from their numbers.

A `Scenario` has gears, motion, plant, controller and the parts around them, and a file builds
exactly these objects (`control/simulation/prepare.py`). Every number of a file has the default,
bounds, unit and meaning of its field (`control/fields.py`). The bounds exclude infinity and
not-a-number. Meanings and units are ASCII, so that the printed file is valid UTF-8 in any terminal
encoding.
"""

from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int
from msgspec import NODEFAULT, Struct, defstruct

from ...base.arrays import Number, Numbers, namespace
from ...base.errors import ScenarioError
from ...base.files.toml_io import Table, key
from ...kinematics.flank_model import FlankModel
from ...pair.gear_pair import Drive, Eccentricities, GearPair
from ..controllers.controller import Acceleration, Controller, Feedforward, NoController, Predictive
from ..fields import Part, Quantity, not_negative, number, number_fields
from ..hardware.actuator import Actuator
from ..hardware.encoder import AlphaBetaGamma, Encoder, FilteredDifference, Observer
from ..hardware.servo import Servo
from ..motion.motion import AbortedStop, EmergencyStop, Motion, Reversal, SlowDown
from ..plants.elastic import Elastic
from ..plants.plant import Friction, Inertia, Load, Mesh, Plant, Play, Rigid
from .axes import Gap, Sweep

Kinematics = Literal["exact", "closed"]
TurnSource = Literal["known", "located", "unknown"]


class Sampling(Part):
    """Rates of the controller and of the plant."""

    controller_hz: Quantity = number(1000.0, "controller rate", "Hz", gt=0, le=1e7)
    plant_hz: Quantity = not_negative(
        0.0, "plant rate, a whole multiple of controller_hz; 0: equal to it", "Hz"
    )

    @property
    def fits(self) -> Any:
        """Whether the plant rate is a whole multiple of that of the controller."""
        steps = self.plant_hz / self.controller_hz
        whole = namespace(steps).maximum(1, namespace(steps).rint(steps))
        return (self.plant_hz == 0) | (abs(steps - whole) <= 1e-9 * whole)

    def check(self) -> None:
        """Raise `ScenarioError` if the plant rate, which is known, is no whole multiple."""
        if self.fits:
            return
        plant, controller = float(self.plant_hz), float(self.controller_hz)
        steps = plant / controller
        raise ScenarioError(
            f"{plant:g} Hz is {steps:g} times controller_hz; write a whole multiple such as"
            f" {max(1, round(steps)) * controller:g}, or 0 for controller_hz itself.",
            where="sampling.plant_hz",
        )


class Scenario(eqx.Module):
    """One simulated case: a gear drive, its motion, and its controller.

    Every number of every part may be traced by JAX, also those of the gears, the eccentricities and
    the maps. The parts have the names, defaults and units of the tables of a scenario file, which
    `vttig simulate --print-defaults` prints.

    **Arguments**
    - `pair`: the gears, or a drive of which only the ratio is known.
    - `eccentricities`: those of the gears; they need no `plant_map`.
    - `motion`: `Reversal`, `SlowDown`, `AbortedStop`, `EmergencyStop`, `Sine`, `recorded(…)`, or a
      `Motion` of the user. - `plant`: `Play`, `Rigid`, `Elastic`, or a `Plant` of the user.
    - `controller`: `NoController`, `Acceleration`, `Predictive`, `Feedforward`, or a `Controller`
      of the user. - `observer`: what estimates speed and acceleration for it.
    - `servo`: motor of the driving shaft; None for a motion with unlimited torque.
    - `inertia`, `friction`, `load`, `mesh`, `driving_encoder`, `driven_encoder`, `actuator`,
      `sampling`: further parts.
    - `plant_map`: flanks of the gears, instead of those of the eccentricities.
    - `controller_map`: flanks that the controller believes: a flank model, or other eccentricities;
      by default those of `eccentricities`, else `plant_map`.
    - `map_backlash_deg`: mean backlash that the controller believes, instead of that of its map.
    - `flanks`: kinematics of the eccentricities, exact or of first order ("closed").
    - `turn`: how the controller knows its turn within the hunting period, see `[judgement]`.
    - `seed`: seed of the encoder noise.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import Predictive, Reversal, Scenario
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> motion = Reversal(speed_rpm=60, reversal_deg=720, dwell_s=0.2)
    >>> scenario = Scenario(
    ...     paper_pair(), paper_eccentricities(), motion, controller=Predictive(margin_mm=0.01)
    ... )
    >>> run = vttig_jax.simulate(scenario)
    >>> run.outcome, round(run.metrics["residual_gap_deg"], 5)
    ('ok', 0.00075)

    ```
    """

    pair: GearPair | Drive
    eccentricities: Eccentricities | None = None
    motion: Motion | Reversal = Reversal()
    plant: Plant = Rigid()
    controller: Controller = Acceleration()
    servo: Servo | None = None
    inertia: Inertia = Inertia()
    friction: Friction = Friction()
    load: Load = Load()
    mesh: Mesh = Mesh()
    driving_encoder: Encoder = Encoder()
    driven_encoder: Encoder = Encoder()
    actuator: Actuator = Actuator()
    observer: Observer = AlphaBetaGamma()
    sampling: Sampling = Sampling()
    plant_map: FlankModel | None = None
    controller_map: FlankModel | Eccentricities | None = None
    map_backlash_deg: Float[Number, ""] | None = None
    seed: Int[Numbers, ""] = eqx.field(
        converter=lambda seed: seed if isinstance(seed, jax.Array) else np.asarray(seed), default=0
    )
    flanks: Kinematics = eqx.field(static=True, default="exact")
    turn: TurnSource = eqx.field(static=True, default="known")


PlantName = Literal["play", "rigid", "elastic"]
ControllerName = Literal["none", "acceleration", "predictive", "feedforward"]
ObserverName = Literal["alpha_beta_gamma", "difference"]
MotionKind = Literal["trapezoid", "s_curve", "sine", "recorded"]
Event = Literal["reversal", "slow_down", "aborted", "emergency_stop"]
Motor = Literal["prescribed", "pi"]


def _named(names: Any, *kinds: type) -> dict[str, Any]:
    return dict(zip(get_args(names), kinds, strict=True))


PLANTS = _named(PlantName, Play, Rigid, Elastic)
CONTROLLERS = _named(ControllerName, NoController, Acceleration, Predictive, Feedforward)
OBSERVERS = _named(ObserverName, AlphaBetaGamma, FilteredDifference)
EVENTS = _named(Event, Reversal, SlowDown, AbortedStop, EmergencyStop)


def choice(kind: Any, meaning: str, default: Any = NODEFAULT) -> tuple[Any, Any]:
    """Return type and default of a key that holds no number; by default an empty text or table."""
    return Annotated[kind, key(meaning)], kind() if default is NODEFAULT else default


def table_of(name: str, *contents: Any) -> Any:
    """Return the struct of a table with these keys: classes of parts, and name → (type, default).

    A number that several parts have stands where the last of them has it.
    """
    keys: dict[str, tuple[Any, Any]] = {}
    for content in contents:
        new = content
        if isinstance(content, type):
            own = (one for one in number_fields(content) if one.name in content.__annotations__)
            new = {one.name: (one.metadata["kind"], one.default) for one in own}
        for field, entry in new.items():
            keys.pop(field, None)
            keys[field] = entry
    fields: Any = [
        (field, kind) if default is NODEFAULT else (field, kind, default)
        for field, (kind, default) in keys.items()
    ]
    return defstruct(name, fields, bases=(Table,), frozen=True, kw_only=True, module=__name__)


_ANGLE = {"unit": "deg", "ge": -1e6, "le": 1e6}
_OFFSET = {"unit": "mm", "ge": 0, "le": 1e3}
_FROM_CENTRES = "its angle from the line of centres at angle 0"
_CONSTANT = "backlash without eccentricities, angle of the driven gear"
_RIG_KEYS = {
    "driving_mm": key("eccentricity of the driving gear", **_OFFSET, examples=[0.0226]),
    "driving_phase_deg": key(_FROM_CENTRES, **_ANGLE, examples=[49.5]),
    "driven_mm": key("eccentricity of the driven gear", **_OFFSET, examples=[0.0273]),
    "driven_phase_deg": key(_FROM_CENTRES, **_ANGLE, examples=[79.3]),
    "constant_backlash_deg": key(_CONSTANT, "deg", ge=0, le=90, examples=[0.038]),
}
_RIG: dict[str, Any] = {name: Annotated[float, one] for name, one in _RIG_KEYS.items()}
"""Keys of a rig, which [eccentricities] requires and [map] does not."""

_FILE = "recorded: CSV with time_s and driving_deg, relative to the scenario"
_MOTOR = "prescribed: exact motion with unlimited torque; pi: servo motor"
_TURN = "turn of the hunting period; located: from one reading of both shafts"
_KIND = "shape of the speed; recorded: that of `file`"
_EVENT = "reversal, or an event instead of it or before it"
_OBSERVER = "estimator of speed and acceleration"

EccentricityTable = table_of(
    "EccentricityTable", {name: (kind, NODEFAULT) for name, kind in _RIG.items()}
)
MapTable = table_of("MapTable", {name: (kind | None, None) for name, kind in _RIG.items()})
MotionTable = table_of(
    "MotionTable",
    {
        "kind": choice(MotionKind, _KIND, "trapezoid"),
        "event": choice(Event, _EVENT, "reversal"),
    },
    *(Reversal, AbortedStop, EmergencyStop),
    {"file": choice(str, _FILE)},
)
ServoTable = table_of("ServoTable", {"motor": choice(Motor, _MOTOR, "prescribed")}, Servo)
InertiaTable = table_of("InertiaTable", Inertia)
FrictionTable = table_of("FrictionTable", Friction)
LoadTable = table_of("LoadTable", Load)
MeshTable = table_of("MeshTable", Rigid, Elastic, Mesh)
EncoderTable = table_of("EncoderTable", Encoder)
ActuatorTable = table_of("ActuatorTable", Actuator)
JudgementTable = table_of(
    "JudgementTable",
    {
        "turn": choice(TurnSource, _TURN, "known"),
        "observer": choice(ObserverName, _OBSERVER, "alpha_beta_gamma"),
    },
    *(AlphaBetaGamma, Acceleration, Predictive, Feedforward),
)
SamplingTable = table_of("SamplingTable", Sampling)


class RigTable(Table, frozen=True, rename={"run": "from"}):
    """Table `rig`: the map in a run folder of `vttig fit`, instead of `[eccentricities]`.

    A single case uses the whole fitted map, or the posterior mean if the folder has a posterior. In
    a sweep each plant has the whole map of a posterior draw.
    """

    run: Annotated[str, key("run folder of `vttig fit`", min_length=1, examples=["RUN"])]
    draws: (
        Annotated[
            int, key("sweep only: draws of the posterior", "1", ge=1, le=10**7, examples=[200])
        ]
        | None
    ) = None
    seed: (
        Annotated[int, key("sweep only: seed of the draws", "1", ge=0, le=2**32 - 1, examples=[0])]
        | None
    ) = None

    @property
    def chosen(self) -> tuple[int, int]:
        """Number and seed of the draws; by default 200 and 0."""
        return 200 if self.draws is None else self.draws, self.seed or 0


ECCENTRICITIES = "eccentricities"
"""Value of `plant_map` and `controller_map` for the exact or closed map of [eccentricities]."""


_PAIR = key("pair file, relative to this file; a run folder has its own", examples=["pair.toml"])
_SEED = key("seed of the encoder noise", "1", ge=0, le=2**32 - 1)
_MAP = "flanks of the plant: eccentricities, a run folder or a map file"
_BELIEVED = key(
    "flanks the controller believes; by default eccentricities, else those of the plant",
    examples=["RUN"],
)
_EDGE = "gap of that map: mean, or an edge of its band in map.csv"
_ONE_GAP = "gap of a run whose log has one direction; replaces that of others"
_GAP: Any = Annotated[float, key(_ONE_GAP, "deg", ge=0, le=90, examples=[0.02])]
_ENCODER = "encoder of the {} shaft that the controller reads"
_MOUNTED = "eccentricities of the gears, and the constant backlash"

_KEYS = {
    "pair": (Annotated[str, _PAIR], NODEFAULT),
    "plant": choice(PlantName, "model of the driven shaft and the contact", "rigid"),
    "controller": choice(ControllerName, "rule that shifts the driven gear", "acceleration"),
    "flanks": choice(Kinematics, "kinematics of the eccentric pair", "exact"),
    "seed": (Annotated[int, _SEED], 0),
    "eccentricities": choice(EccentricityTable | None, _MOUNTED, None),
    "plant_map": choice(str, _MAP, ECCENTRICITIES),
    "controller_map": (Annotated[str | None, _BELIEVED], None),
    "controller_gap": choice(Gap, _EDGE, "mean"),
    "constant_backlash_deg": (_GAP | None, None),
    "map": choice(MapTable, "rig assumed by the controller; absent keys: true values"),
    "motion": choice(MotionTable, "motion of the driving shaft"),
    "servo": choice(ServoTable, "motor of the driving shaft"),
    "inertia": choice(InertiaTable, "moments of inertia of both shafts"),
    "friction": choice(FrictionTable, "friction of both shafts"),
    "load": choice(LoadTable, "load of the driven shaft"),
    "mesh": choice(MeshTable, "contact of the flanks"),
    "driving_encoder": choice(EncoderTable, _ENCODER.format("driving")),
    "driven_encoder": choice(EncoderTable, _ENCODER.format("driven")),
    "actuator": choice(ActuatorTable, "axial shift of the driven gear"),
    "judgement": choice(JudgementTable, "detection of a reversal"),
    "sampling": choice(SamplingTable, "rates of controller and plant"),
    "rig": choice(RigTable | None, "the rig of a run folder", None),
    "sweep": choice(Sweep | None, "axes of a sweep", None),
}

if TYPE_CHECKING:  # msgspec makes this class, which type checkers do not see

    class ScenarioSpec(Any):
        """Content of a scenario or sweep file."""

else:
    ScenarioSpec = table_of("ScenarioSpec", _KEYS)


def part_of(kind: Any, table: Struct, **choices: Any) -> Any:
    """Return the part of a class with the numbers of a table, and with further choices."""
    numbers = {field.name: getattr(table, field.name) for field in number_fields(kind)}
    return kind(**numbers, **choices)


def name_of(part: Any, kinds: dict[str, Any]) -> str:
    """Return the name of a part in a scenario file, or the class name of that of a user."""
    names = {kind: name for name, kind in kinds.items()}
    return names.get(type(part), type(part).__name__)
