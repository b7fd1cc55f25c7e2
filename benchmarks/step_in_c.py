"""The step of `simulation_step.c`, compiled here and run on the lanes of a stack.

The C program is an oracle too: it shares no code with the scan, only its formulas.
"""

import ctypes
import dataclasses
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vttig_jax.base.units import REV
from vttig_jax.control.controllers.controller import Acceleration
from vttig_jax.control.hardware.encoder import AlphaBetaGamma
from vttig_jax.control.motion.motion import PieceMotion
from vttig_jax.control.plants.plant import ON_B, Rigid, Shafts
from vttig_jax.control.simulation.case import (
    Accumulators,
    Case,
    State,
    initial_state,
    run_periods,
)
from vttig_jax.kinematics.flank_table import FirstOrderBounds

from .compiler import fast_to_compile

CC = shutil.which("cc")
SOURCE = Path(__file__).with_name("simulation_step.c")
FAST = ("-O3", "-march=native", "-ffast-math")
WIDE = (*FAST, "-mprefer-vector-width=512")
NARROW = (*FAST, "-mprefer-vector-width=256")
"""What GCC prefers by itself on many machines with AVX-512, but not on all."""
LOOPS = "-fno-thread-jumps"
"""GCC threads jumps between selections by the same condition, and then finds the loop too
complicated for vectors: 64 ns a step instead of 16. Every program in C gets it."""

NEVER = 1e300
_SHAFTS = ("angle", "speed", "offset", "drift", "side")
_FLANKS = ("lower", "upper", "lower_slope", "upper_slope")
_OTHERS = (
    *("unobstructed", "rate", "reached", "queue"),
    *("seen_angle", "seen_speed", "seen_acceleration"),
)
METRICS = (
    *("samples", "total", "highest", "lowest", "first", "before", "after"),
    *("gap", "crossing", "crossing_s", "detection", "detection_s", "false_closings"),
    *("residual_gap", "shortfall", "opened", "retracted", "largest_command", "interference"),
    *("travel", "farthest"),
    *("commanded", "blocked", "blocked_s"),
    *("carrier", "largest_jump", "early_jump", "wrong_travel"),
    *("output_start", "output_error", "output_squares", "lost"),
)
"""Accumulators that the C program has: all that this case changes, which `scanned` checks."""
FIELDS = (*_SHAFTS, *_FLANKS, *_OTHERS, "closes", "shift", *METRICS)
_OWN, _SHARED = 2 * 8 + 3, 2 + 16 + 1 + 2 + 8 + 2 + 5 + 6 + 3 + 3 + 1 + 4 + 2 + 2
"""Numbers of a lane, and of all lanes."""


def _called(command: Sequence[str]) -> str:
    """What the compiler says; ends the program where it refuses."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"cc refused {SOURCE.name}:\n{done.stderr}")
    return done.stdout + done.stderr


class StepInC:
    """The compiled program. **Raises** `RuntimeError` where `cc` is missing."""

    def __init__(self, folder: Path, flags: Sequence[str] = FAST, block: int = 64) -> None:
        if CC is None:
            raise RuntimeError("no C compiler (`cc`) on this machine")
        self.block = block
        library = folder / f"step_{block}_{abs(hash(tuple(flags)))}.so"
        sizes = {"LANES": block, "FIELDS": len(FIELDS), "OWN": _OWN, "SHARED": _SHARED}
        defined = [f"-D{name}={value}" for name, value in sizes.items()]
        common = [LOOPS, "-std=gnu11", "-fPIC", "-fopt-info-vec-optimized"]
        compiled = library.with_suffix(".o")
        command = [CC, *flags, *common, *defined, "-c", "-o", str(compiled), str(SOURCE)]
        self.said = _called(command)
        # Linked with -ffast-math, it would make subnormal numbers zero in the whole process.
        _called([CC, "-shared", "-o", str(library), str(compiled), "-lm"])
        self._run = ctypes.CDLL(str(library)).run
        self._run.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_long] * 2
        self._run.restype = None

    @property
    def vector_loops(self) -> list[int]:
        """Bytes of the vectors of every loop over the lanes that GCC vectorised."""
        lines = [line for line in self.said.splitlines() if "loop vectorized using" in line]
        return [int(line.split(" using ")[1].split()[0]) for line in lines]

    def prepared(self, cases: Sequence[Case]) -> "Prepared":
        """Memory that the program runs on: start of all cases, a whole number of blocks."""
        blocks, left = divmod(len(cases), self.block)
        assert not left, (len(cases), self.block)

        def rows(values: np.ndarray) -> np.ndarray:
            """(rows, lanes) to (blocks, rows, lanes of a block), in lines of the cache."""
            shaped = values.reshape(-1, blocks, self.block).transpose(1, 0, 2)
            return _aligned(shaped)

        start = rows(_numbers(_started(cases)))
        return Prepared(start, rows(_own(cases)), _shared(cases[0]))

    def run(self, memory: "Prepared", periods: int) -> np.ndarray:
        """The state of all lanes after so many periods, shape (fields, lanes)."""
        state = _aligned(memory.start)
        self._run(
            state.ctypes.data, memory.own.ctypes.data, memory.shared.ctypes.data,
            len(state), periods,
        )  # fmt: skip
        return state.transpose(1, 0, 2).reshape(len(FIELDS), -1)


class Prepared:
    def __init__(self, start: np.ndarray, own: np.ndarray, shared: np.ndarray) -> None:
        self.start, self.own, self.shared = start, own, shared


def scanned(cases: Sequence[Case], periods: int) -> np.ndarray:
    """The same state by the simulator: one scan, vmapped over the cases."""
    state = jax.tree.map(np.asarray, _scan()(_stacked(cases), periods))
    start = Accumulators(output_start=jnp.zeros(()))  # the start of the output is in `METRICS`
    for name in {field.name for field in dataclasses.fields(Accumulators)} - set(METRICS):
        there, at_first = getattr(state.accumulators, name), getattr(start, name)
        if there is at_first is None:  # only with a controller that moves the motor
            continue
        assert np.array_equal(
            there, np.broadcast_to(np.asarray(at_first), there.shape), equal_nan=True
        ), name
    return _numbers(state)


def difference(one: np.ndarray, other: np.ndarray) -> dict[str, float]:
    """Largest difference of every field, relative where a value is beyond 1; inf where only one
    of both has happened.

    In a gap that is closed on both flanks the last digit says which of them carries. Side and drift
    are compared in lanes without such a gap. A flank that the opening gap grazes after the turn is
    met at a double root, which rounding moves by its square root: the largest jump is compared in
    lanes where it is that of the crossing.
    """
    unobstructed, reached = FIELDS.index("unobstructed"), FIELDS.index("reached")
    held = (one[reached] < one[unobstructed]) & (other[reached] < other[unobstructed])
    grazed = one[FIELDS.index("largest_jump")] > one[FIELDS.index("gap")]
    left_out = {"side": held, "drift": held, "largest_jump": grazed}
    found = {}
    for name, a, b in zip(FIELDS, one, other, strict=True):
        never = (np.abs(a) == NEVER) != (np.abs(b) == NEVER)
        apart = np.abs(a - b) / np.maximum(1.0, np.abs(b))
        apart = np.where(never, np.inf, apart)
        found[name] = float(np.where(left_out.get(name, False), 0.0, apart).max())
    return found


def _scan_all(cases: Any, periods: int) -> Any:
    def one(case: Case) -> State:
        return run_periods(case, initial_state(case), jnp.arange(periods))[0]

    return jax.vmap(one)(cases)


@cache
def _scan() -> Any:
    return jax.jit(_scan_all, static_argnums=1, **fast_to_compile())


_start = jax.jit(jax.vmap(initial_state))


def _stacked(cases: Sequence[Case]) -> Any:
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *cases)


def _started(cases: Sequence[Case]) -> Any:
    return jax.tree.map(np.asarray, _start(_stacked(cases)))


def _numbers(state: State) -> np.ndarray:
    """Fields of a state as rows of numbers, NEVER for NaN (with the sign of a maximum)."""
    shafts, accumulators = state.shafts, state.accumulators
    values = {name: getattr(shafts, name) for name in _SHAFTS}
    values |= {name: getattr(shafts.flanks, name) for name in _FLANKS}
    values |= {name: getattr(state.carriage, name) for name in _OTHERS[:3]}
    values["queue"] = np.asarray(state.carriage.queue)[:, 0]
    values |= {f"seen_{name}": value for name, value in vars(state.estimate).items()}
    values |= {"closes": state.controller.closing, "shift": state.controller.shift}
    values |= vars(accumulators)
    rows = np.array([np.asarray(values[name], np.float64) for name in FIELDS])
    rows[np.isnan(rows)] = NEVER
    highest = rows[FIELDS.index("highest")]
    highest[highest == NEVER] = -NEVER
    return rows


def _own(cases: Sequence[Case]) -> np.ndarray:
    """Rows of `Own`: edges and angles there, ends of the run."""
    columns = []
    for case in cases:
        motion = case.motion
        edges = [(start, angle) for start, angle, *_ in _edges(motion)]
        ends = [motion.duration_s, motion.braking_s, motion.turn_s]
        columns.append([*(e[0] for e in edges), *(e[1] for e in edges), *map(float, ends)])
    return np.array(columns).T


def _edges(motion: Any) -> list[tuple[float, float, float, float]]:
    """Start, angle there, speed and acceleration of every piece and standstill."""
    assert isinstance(motion, PieceMotion) and not motion.jerky
    found, angle = [], 0.0
    numbers = (motion.start, motion.duration, motion.speed, motion.acceleration)
    for row in zip(*map(np.asarray, numbers), strict=True):
        start, duration, speed, acceleration = map(float, row)
        found.append((start, angle, speed, acceleration))
        angle += duration * (speed + 0.5 * duration * acceleration)
    assert len(found) == 8
    return found


def _shared(case: Case) -> np.ndarray:
    """Numbers of `Shared`, in its order."""
    plant, actuator, observer, controller = (
        case.plant, case.actuator, case.observer, case.controller,
    )  # fmt: skip
    assert isinstance(plant, Rigid) and isinstance(observer, AlphaBetaGamma)
    assert isinstance(controller, Acceleration) and case.substeps == 1
    assert not (plant.drag.sticky or case.noisy or case.driving_encoder.eccentric)
    bounds, believed = case.bounds, case.believed
    assert isinstance(bounds, FirstOrderBounds) and isinstance(believed, FirstOrderBounds)
    assert actuator.periods == 1
    period, drag = float(case.period), plant.drag
    pole = np.exp(-REV * observer.bandwidth_hz * period)
    edges = _edges(case.motion)
    values = [
        *(period, np.where(case.sense > 0, ON_B, -ON_B)),
        *(speed for _, _, speed, _ in edges),
        *(acceleration for *_, acceleration in edges),
        *(bounds.ratio, bounds.offset, bounds.cosine, bounds.sine, bounds.closing),
        *(drag.inertia, drag.coulomb, drag.load),
        np.expm1(-drag.viscous * period / drag.inertia) * drag.inertia / period,
        *(plant.restitution, actuator.speed_mm_s, actuator.acceleration_mm_s2, actuator.stroke_mm),
        *(actuator.resolution_mm, actuator.delay, actuator.back_drivable),
        *(1 - pole**3, 1.5 * (1 - pole) ** 2 * (1 + pole) / period, (1 - pole) ** 3 / period**2),
        *(controller.threshold_rad_s2, controller.least_rpm * REV / 60, controller.margin_mm),
        *(np.diff(believed.offset), np.diff(believed.cosine, axis=0)),
        *(np.diff(believed.sine, axis=0), 1.0 / np.sum(believed.closing), believed.ratio),
        *(case.driving_encoder.count, case.driven_encoder.count),
    ]
    flat = np.concatenate([np.ravel(np.asarray(value, np.float64)) for value in values])
    assert len(flat) == _SHARED
    return flat


def _aligned(values: np.ndarray) -> np.ndarray:
    """A copy that starts on a line of the cache."""
    room = np.empty(values.size * 8 + 64, np.uint8)
    first = -room.ctypes.data % 64
    aligned = room[first : first + values.size * 8].view(np.float64).reshape(values.shape)
    aligned[...] = values
    return aligned


assert set(_SHAFTS) <= {field.name for field in dataclasses.fields(Shafts)}
