"""The driven shaft between two springs with dampers, by DOP853 from one event to the next.

    J φ̈₂ = F_A − F_B − T_load − b φ̇₂ − T_c sgn φ̇₂,  F = max(0, c p + clip(d ṗ, ±c p)),
    p_A = TE_A(φ₁) − x,  p_B = x − TE_B(φ₁),  x = φ₂ − i φ₁

The law has four pieces: `free` (p < 0), `stiff` (2 c p: the damper at its limit, on the way in),
`both` (c p + d ṗ) and `loose` (0: the damper at its limit, on the way out). Friction adds two
senses of slip and `stick`. Within a piece everything is smooth; its ends are events of the solver,
which works in x and ẋ: small numbers keep its relative tolerance meaningful.

A damper without limit, F = max(0, c p + d ṗ) where p > 0, is the law that MuJoCo's limits come to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from .flank_formulas import Wall
from .trapezoid_corners import Corners

Place = Sequence[float] | np.ndarray
"""(x, ẋ)."""

_MOST_PIECES = 20_000

_FIRST = 1e-6
"""s: away from the event that began a piece before the solver looks for it again."""


@dataclass(frozen=True)
class Contact:
    """What the driven shaft feels; torques N m, inertia kg m², stiffness N m/rad.

    `limited`: the damper gives at most what the spring does.
    """

    walls: tuple[Wall, Wall]
    motion: Corners
    ratio: float
    inertia: float
    stiffness: float
    damping: float
    coulomb: float = 0.0
    viscous: float = 0.0
    load: float = 0.0
    limited: bool = True

    def depth(self, side: int, time: float, place: Place) -> tuple[float, float]:
        """(p, ṗ) of flank A (0) or B (1); place: (x, ẋ)."""
        angle, speed, _ = self.motion.at(time)
        error, slope = self.walls[side](angle)
        if side == 0:
            return error - place[0], slope * speed - place[1]
        return place[0] - error, place[1] - slope * speed

    def force(self, piece: str, side: int, time: float, place: Place) -> float:
        """Torque of one flank, N m."""
        if piece in ("free", "loose"):
            return 0.0
        depth, rate = self.depth(side, time, place)
        if piece == "stiff":
            return 2 * self.stiffness * depth
        return self.stiffness * depth + self.damping * rate

    def turning(self, time: float, place: Place) -> float:
        """φ̇₂."""
        return place[1] + self.ratio * self.motion.at(time)[1]

    def push(self, mode: "Mode", time: float, place: Place) -> float:
        """Torque on the driven shaft without Coulomb friction."""
        torque = self.force(mode.a, 0, time, place) - self.force(mode.b, 1, time, place)
        return torque - self.load - self.viscous * self.turning(time, place)

    def resting(self, time: float) -> tuple[float, float]:
        """(x, ẋ) in steady forward motion: flank A pushes against friction and load."""
        angle, speed, _ = self.motion.at(time)
        error, slope = self.walls[0](angle)
        turning = speed * (self.ratio + slope)
        torque = self.coulomb + self.load + self.viscous * turning
        return error - torque / self.stiffness, slope * speed


@dataclass(frozen=True)
class Mode:
    """Piece of the law on each flank, and of friction: 1 and −1 slip, 0 stick."""

    a: str
    b: str
    slip: int


@dataclass(frozen=True)
class Path:
    """x and ẋ at the times asked for, and the start of every piece."""

    offset: np.ndarray
    drift: np.ndarray
    pieces: list[tuple[float, Mode]]


def integrate(
    contact: Contact,
    start: tuple[float, float],
    times: np.ndarray,
    rtol: float = 1e-10,
    atol: tuple[float, float] = (1e-15, 1e-12),
) -> Path:
    """Follow the driven shaft from (x, ẋ) at times[0]; corners of the motion are waited for."""
    stops = [t for t in contact.motion.times if times[0] < t < times[-1]] + [float(times[-1])]
    time, place = float(times[0]), np.array(start, float)
    mode = _first_mode(contact, time, place)
    found, pieces = [place[:, None]], [(time, mode)]
    for _ in range(_MOST_PIECES):
        stop = next(s for s in stops if s > time)
        events = _events(contact, mode)
        run = solve_ivp(
            _right_hand_side(contact, mode),
            (time, stop),
            place,
            method="DOP853",
            t_eval=np.append(times[(times > time) & (times < stop)], stop),
            events=[event for event, _ in events],
            rtol=rtol,
            atol=atol,
            max_step=_longest(contact, mode),
            first_step=min(_FIRST, stop - time),
        )
        assert run.success
        if len(run.t):
            found.append(run.y[:, np.isin(run.t, times)])
        which = next((k for k, hits in enumerate(run.t_events) if len(hits)), None)
        if which is not None:
            time, place = float(run.t_events[which][0]), run.y_events[which][0]
            mode = events[which][1](time, place)
        else:
            time, place = stop, np.array(run.y)[:, -1]
            if time >= times[-1]:
                path = np.concatenate(found, axis=1)
                assert path.shape[1] == len(times)
                return Path(path[0], path[1], pieces)
        if mode.slip == 0:
            # What has changed may tear it loose.
            mode = Mode(mode.a, mode.b, _slip(contact, mode, time, place))
        if mode.slip == 0:
            place = np.array([place[0], place[1] - contact.turning(time, place)])
        pieces.append((time, mode))
    raise AssertionError("too many pieces")


def _longest(contact: Contact, mode: Mode) -> float:
    """Step of the solver within which no event can come and go unseen."""
    period = 2 * np.pi * np.sqrt(contact.inertia / contact.stiffness)
    if {mode.a, mode.b} == {"free"}:
        return 2e-3
    return period / 8 if {mode.a, mode.b} <= {"free", "both"} else period / 30


def _right_hand_side(contact: Contact, mode: Mode):
    def rates(time, place):
        forced = -contact.ratio * contact.motion.at(time)[2]
        if mode.slip != 0:
            torque = contact.push(mode, time, place) - mode.slip * contact.coulomb
            forced += torque / contact.inertia
        return (place[1], forced)

    return rates


def _first_mode(contact: Contact, time: float, place: np.ndarray) -> Mode:
    sides = []
    for side in (0, 1):
        depth, rate = contact.depth(side, time, place)
        spring, damper = contact.stiffness * depth, contact.damping * rate
        if depth < 0 or (depth == 0 and rate <= 0):
            sides.append("free")
        else:
            near = "both" if damper > -spring else "loose"
            sides.append("stiff" if contact.limited and damper > spring else near)
    a, b = sides
    turning = contact.turning(time, place)
    return Mode(a, b, int(np.sign(turning)) or _slip(contact, Mode(a, b, 1), time, place))


def _slip(contact: Contact, mode: Mode, time: float, place: Place) -> int:
    """Sense in which the shaft starts to move from standstill; 0 where friction holds it."""
    push = contact.push(mode, time, place)
    return 0 if abs(push) <= contact.coulomb else int(np.sign(push))


def _events(contact: Contact, mode: Mode):
    """(event function, new mode) for whatever ends a piece."""
    found = []

    def when(value, direction, after):
        def event(time, place):
            return value(time, place)

        event.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
        event.direction = direction  # pyright: ignore[reportFunctionMemberAccess]
        found.append((event, after))

    for side, name in enumerate("ab"):
        for value, direction, new in _ends(contact, side, getattr(mode, name)):

            def after(time, place, name=name, new=new):
                return Mode(**{**vars(mode), name: new})

            when(value, direction, after)
    if mode.slip:

        def stopped(time, place):
            return Mode(mode.a, mode.b, _slip(contact, mode, time, place))

        when(contact.turning, -mode.slip, stopped)
    else:
        for sense in (1, -1):

            def torn(time, place, sense=sense):
                return contact.push(mode, time, place) - sense * contact.coulomb

            when(torn, sense, lambda time, place, sense=sense: Mode(mode.a, mode.b, sense))
    return found


def _ends(contact: Contact, side: int, piece: str):
    """(value, direction, next piece) for the ends of a piece of the law on one flank."""
    c, d = contact.stiffness, contact.damping

    def depth(time, place):
        return contact.depth(side, time, place)[0]

    def least(time, place):
        p, w = contact.depth(side, time, place)
        return c * p + d * w

    def most(time, place):
        p, w = contact.depth(side, time, place)
        return c * p - d * w

    damped, limited = d > 0, d > 0 and contact.limited
    limit = [(most, -1, "stiff")] if limited else []
    return {
        "free": [(depth, 1, "stiff" if limited else "both")],
        "stiff": [(most, 1, "both")],
        "both": [*limit, (least, -1, "loose")] if damped else [(depth, -1, "free")],
        "loose": [(depth, -1, "free"), (least, 1, "both")],
    }[piece]
