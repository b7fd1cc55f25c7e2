"""Tables of a scenario file: the numbers of the parts of a `Scenario`, and the choices of parts.

Every number has the default, bounds, unit and meaning of its field (`control/fields.py`). The
bounds exclude infinity and not-a-number. Meanings and units are ASCII, so that the printed file is
valid UTF-8 in any terminal encoding.
"""

from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from msgspec import NODEFAULT, Struct, defstruct

from ...base.files.toml_io import Table, key
from ..controllers.acceleration import Acceleration
from ..controllers.controller import NoController
from ..controllers.feedforward import Feedforward
from ..controllers.predictive import Predictive
from ..fields import number_fields
from ..hardware.actuator import Actuator
from ..hardware.encoder import Encoder
from ..hardware.observer import AlphaBetaGamma, FilteredDifference
from ..hardware.servo import Servo
from ..motion.profiles import AbortedStop, EmergencyStop, Reversal, SlowDown
from ..plants.elastic import Elastic
from ..plants.plant import Friction, Inertia, Load, Mesh
from ..plants.play import Play
from ..plants.rigid import Rigid
from .axes import Gap, Sweep
from .scenario import Sampling

PlantName = Literal["play", "rigid", "elastic"]
ControllerName = Literal["none", "acceleration", "predictive", "feedforward"]
ObserverName = Literal["alpha_beta_gamma", "difference"]
Kinematics = Literal["exact", "closed"]
MotionKind = Literal["trapezoid", "s_curve", "sine", "recorded"]
Event = Literal["reversal", "slow_down", "aborted", "emergency_stop"]
Motor = Literal["prescribed", "pi"]
TurnSource = Literal["known", "located", "unknown"]


def _named(names: Any, *kinds: type) -> dict[str, Any]:
    return dict(zip(get_args(names), kinds, strict=True))


PLANTS = _named(PlantName, Play, Rigid, Elastic)
CONTROLLERS = _named(ControllerName, NoController, Acceleration, Predictive, Feedforward)
OBSERVERS = _named(ObserverName, AlphaBetaGamma, FilteredDifference)
EVENTS = _named(Event, Reversal, SlowDown, AbortedStop, EmergencyStop)


def choice(kind: Any, meaning: str, default: Any = "") -> tuple[Any, Any]:
    """Return type and default of a key that holds no number."""
    return Annotated[kind, key(meaning)], default


def table_of(name: str, *contents: Any) -> Any:
    """Return the struct of a table with these keys: classes of parts, and name → (type, default).

    A number that several parts have stands where the last of them has it.
    """
    keys: dict[str, tuple[Any, Any]] = {}
    for content in contents:
        new = content
        if isinstance(content, type):
            own = (one for one in number_fields(content) if one.name in content.__annotations__)
            new = {one.name: (one.kind, one.default) for one in own}
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
_RIG: dict[str, tuple[str, str, dict[str, Any]]] = {
    "driving_mm": ("eccentricity of the driving gear", "", _OFFSET | {"examples": [0.0226]}),
    "driving_phase_deg": ("its angle", "line", _ANGLE | {"examples": [49.5]}),
    "driven_mm": ("eccentricity of the driven gear", "", _OFFSET | {"examples": [0.0273]}),
    "driven_phase_deg": ("its angle", "line", _ANGLE | {"examples": [79.3]}),
    "constant_backlash_deg": (
        "backlash without eccentricities",
        "gear",
        {"unit": "deg", "ge": 0, "le": 90, "examples": [0.038]},
    ),
}
_MORE = {
    "": "",
    "line": " from the line of centres at angle 0",
    "gear": ", angle of the driven gear",
}


def _rig(full: bool) -> dict[str, tuple[Any, Any]]:
    """Return the keys of a rig: required with a full text, or optional."""
    kinds: dict[str, Any] = {
        name: Annotated[float, key(text + _MORE[more] * full, **bounds)]
        for name, (text, more, bounds) in _RIG.items()
    }
    return {
        name: (kind, NODEFAULT) if full else (kind | None, None) for name, kind in kinds.items()
    }


_FILE = "recorded: CSV with time_s and driving_deg, relative to the scenario"
_MOTOR = "prescribed: exact motion with unlimited torque; pi: servo motor"
_TURN = "turn of the hunting period; located: from one reading of both shafts"
_KIND = "shape of the speed; recorded: that of `file`"
_EVENT = "reversal, or an event instead of it or before it"

EccentricityTable = table_of("EccentricityTable", _rig(full=True))
MapTable = table_of("MapTable", _rig(full=False))
MotionTable = table_of(
    "MotionTable",
    {
        "kind": choice(MotionKind, _KIND, "trapezoid"),
        "event": choice(Event, _EVENT, "reversal"),
    },
    *(Reversal, SlowDown, EmergencyStop),
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
        "observer": choice(ObserverName, "estimator of speed and acceleration", "alpha_beta_gamma"),
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


def _part(kind: Any, meaning: str, default: Any = NODEFAULT) -> tuple[Any, Any]:
    """Return type and default of a key that holds a table."""
    return choice(kind, meaning, kind() if default is NODEFAULT else default)


_PAIR = key("pair file, relative to this file; a run folder has its own", examples=["pair.toml"])
_SEED = key("seed of the encoder noise", "1", ge=0, le=2**32 - 1)
_BELIEVED = key(
    "flanks the controller believes; by default eccentricities, else those of the plant",
    examples=["RUN"],
)
_GAP = key(
    "gap of a run whose log has one direction; replaces that of others",
    "deg",
    ge=0,
    le=90,
    examples=[0.02],
)

if TYPE_CHECKING:  # msgspec makes this class, which type checkers do not see

    class ScenarioSpec(Any):
        """Content of a scenario or sweep file."""

else:
    ScenarioSpec = table_of(
        "ScenarioSpec",
        {
            "pair": (Annotated[str, _PAIR], NODEFAULT),
            "plant": choice(PlantName, "model of the driven shaft and the contact", "rigid"),
            "controller": choice(
                ControllerName, "rule that shifts the driven gear", "acceleration"
            ),
            "flanks": choice(Kinematics, "kinematics of the eccentric pair", "exact"),
            "seed": (Annotated[int, _SEED], 0),
            "eccentricities": _part(
                EccentricityTable | None,
                "eccentricities of the gears, and the constant backlash",
                None,
            ),
            "plant_map": choice(
                str,
                "flanks of the plant: eccentricities, a run folder or a map file",
                ECCENTRICITIES,
            ),
            "controller_map": (Annotated[str | None, _BELIEVED], None),
            "controller_gap": choice(
                Gap, "gap of that map: mean, or an edge of its band in map.csv", "mean"
            ),
            "constant_backlash_deg": (Annotated[float, _GAP] | None, None),
            "map": _part(MapTable, "rig assumed by the controller; absent keys: true values"),
            "motion": _part(MotionTable, "motion of the driving shaft"),
            "servo": _part(ServoTable, "motor of the driving shaft"),
            "inertia": _part(InertiaTable, "moments of inertia of both shafts"),
            "friction": _part(FrictionTable, "friction of both shafts"),
            "load": _part(LoadTable, "load of the driven shaft"),
            "mesh": _part(MeshTable, "contact of the flanks"),
            "driving_encoder": _part(
                EncoderTable, "encoder of the driving shaft that the controller reads"
            ),
            "driven_encoder": _part(
                EncoderTable, "encoder of the driven shaft that the controller reads"
            ),
            "actuator": _part(ActuatorTable, "axial shift of the driven gear"),
            "judgement": _part(JudgementTable, "detection of a reversal"),
            "sampling": _part(SamplingTable, "rates of controller and plant"),
            "rig": _part(RigTable | None, "the rig of a run folder", None),
            "sweep": _part(Sweep | None, "axes of a sweep", None),
        },
    )


def part_of(kind: Any, table: Struct, **choices: Any) -> Any:
    """Return the part of a class with the numbers of a table, and with further choices."""
    numbers = {field.name: getattr(table, field.name) for field in number_fields(kind)}
    return kind(**numbers, **choices)


def name_of(part: Any, kinds: dict[str, Any]) -> str:
    """Return the name of a part in a scenario file, or the class name of that of a user."""
    names = {kind: name for name, kind in kinds.items()}
    return names.get(type(part), type(part).__name__)
