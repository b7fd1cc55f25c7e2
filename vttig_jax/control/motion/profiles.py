"""Commanded motions: trapezoids and S-curves with a reversal, a slow-down or a stop."""

from typing import Any, Literal

from ...base.arrays import float64, namespace
from .limits import check_choice, check_numbers
from .motion import Motion
from .piecewise import EVENTS, Event, PieceMotion, Section, Value, sections_of
from .sine import sine

Kind = Literal["trapezoid", "s_curve", "sine"]

KINDS = ("trapezoid", "s_curve", "sine")


def motion_of(
    kind: Kind,
    event: Event,
    speed_rpm: Value,
    reversal_deg: Value,
    dwell_s: Value,
    ramp_s: Value,
    slow_share: Value,
    stop_s: Value,
) -> Motion:
    """Return the motion of a scenario; see `trapezoid`, `s_curve` and `sine`.

    A sine has no ramps, no standstill and no event except the reversal; `slow_share` and `stop_s`
    apply to some events only. All numbers are checked even if they do not apply.

    **Raises** `ValueError` for an unknown kind or event, a sine with another event, and numbers
    out of range. Traced values are not checked.
    """
    if kind == "recorded":
        raise ValueError(
            'Argument `kind` must not be "recorded" here; `read_motion` makes a motion from a file.'
        )
    check_choice(KINDS, kind=kind)
    check_choice(EVENTS, event=event)
    if kind == "sine":
        if event != "reversal":
            raise ValueError(
                f'Argument `event` must be "reversal" for a sine, but is {event!r}; take kind'
                ' "trapezoid" or "s_curve".'
            )
        check_numbers(dwell_s=dwell_s, ramp_s=ramp_s, slow_share=slow_share, stop_s=stop_s)
        return sine(speed_rpm, reversal_deg)
    build = trapezoid if kind == "trapezoid" else s_curve
    options: Any = {"event": event, "slow_share": slow_share, "stop_s": stop_s}
    return build(speed_rpm, reversal_deg, dwell_s, ramp_s, **options)


def trapezoid(
    speed_rpm: Value,
    reversal_deg: Value,
    dwell_s: Value,
    ramp_s: Value,
    *,
    event: Event = "reversal",
    slow_share: Value = 0.3,
    stop_s: Value = 0.05,
) -> PieceMotion:
    """Return a motion to `reversal_deg` with a trapezoidal speed.

    **Events**
    - `reversal`: a standstill of `dwell_s`, the motion back to 0, and a second standstill.
    - `slow_down`: half way, the speed falls to the share `slow_share`, stays there for `dwell_s`
      and rises again; the run stops at `reversal_deg` for `dwell_s` and never turns back.
    - `aborted`: the slow-down without time at the slow speed, then the reversal.
    - `emergency_stop`: the reversal, but the forward pass stops within `stop_s`.

    **Arguments**
    - `speed_rpm`: steady speed of the driving shaft, positive.
    - `reversal_deg`: driving angle of the turn or the end; negative for the mirrored motion.
    - `ramp_s`: time from standstill to steady speed; smaller changes take a proportional time.

    The run includes every standstill, also the last. `braking_s` is the start of the deceleration
    right before the turn; for `slow_down`, that of the slow-down.

    **Raises** `ValueError` for a reversal inside the ramps and for numbers out of range, including
    `ramp_s` and `stop_s` of zero. Traced values are not checked.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax.control import trapezoid
    >>> vttig_jax.enable_x64()
    >>> motion = trapezoid(speed_rpm=60.0, reversal_deg=720.0, dwell_s=2.0, ramp_s=0.5)
    >>> motion.braking_s.item(), motion.turn_s.item(), motion.duration_s.item()
    (2.0, 4.5, 9.0)
    >>> point = motion.at(2.25)
    >>> round(math.degrees(point.angle), 6), round(math.degrees(point.acceleration), 6)
    (697.5, -720.0)

    ```
    """
    sections = sections_of(
        event,
        speed_rpm=speed_rpm,
        reversal_deg=reversal_deg,
        dwell_s=dwell_s,
        ramp_s=ramp_s,
        slow_share=slow_share,
        stop_s=stop_s,
    )
    return _joined(sections, jerky=False)


def s_curve(
    speed_rpm: Value,
    reversal_deg: Value,
    dwell_s: Value,
    ramp_s: Value,
    *,
    event: Event = "reversal",
    slow_share: Value = 0.3,
    stop_s: Value = 0.05,
) -> PieceMotion:
    """Return the motion of `trapezoid`, with equal times and angles, but with S-curve ramps.

    The acceleration of a ramp is a triangle over time: zero at both ends, and in the middle twice
    the constant acceleration of `trapezoid`.
    """
    sections = sections_of(
        event,
        speed_rpm=speed_rpm,
        reversal_deg=reversal_deg,
        dwell_s=dwell_s,
        ramp_s=ramp_s,
        slow_share=slow_share,
        stop_s=stop_s,
    )
    return _joined(sections, jerky=True)


def _joined(sections: list[Section], *, jerky: bool) -> PieceMotion:
    """Return the motion that consists of consecutive sections; `jerky` for S-curve ramps."""
    clock: Any = float64(0.0)
    pieces: list[tuple[Any, ...]] = []
    pauses: list[int] = []
    marks: dict[str, Any] = {}
    for section in sections:
        if section.mark:
            marks[section.mark] = clock
        if section.shape == "rest":
            pauses.append(len(pieces) - 1)
            clock = clock + section.duration
            continue
        pieces.append((clock, *_piece(section, jerky)))
        clock = clock + section.duration
    xp = namespace(pieces)
    start, duration, speed, acceleration, jerk = map(xp.stack, zip(*pieces, strict=True))
    return PieceMotion(
        start=start,
        duration=duration,
        speed=speed,
        acceleration=acceleration,
        jerk=jerk,
        duration_s=clock,
        braking_s=marks.get("braking", clock),
        turn_s=marks.get("turn", clock),
        pauses=tuple(pauses),
        jerky=jerky,
    )


def _piece(section: Section, jerky: bool) -> tuple[Any, Any, Any, Any]:
    """Return duration, initial speed, initial acceleration and jerk of a section in motion."""
    duration = section.duration
    zero = 0.0 * duration  # an array of the same kind as the other values, with which it is stacked
    speed = section.speed + zero
    if section.shape == "steady":
        return duration, speed, zero, zero
    change = section.end_speed - section.speed
    if jerky:
        return duration, speed, zero, 4.0 * change / duration**2
    return duration, speed, change / duration, zero
