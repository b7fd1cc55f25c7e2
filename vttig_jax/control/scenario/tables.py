"""Tables of a scenario file: every key with its default, bounds, unit and meaning.

This module needs no jax. The bounds exclude infinity and not-a-number. Meanings and units are
ASCII, so that the printed file is valid UTF-8 in any terminal encoding.
"""

from typing import Annotated, Literal

from ...base.files.toml_io import Table, key

Plant = Literal["play", "rigid", "elastic"]
Controller = Literal["none", "acceleration", "predictive", "feedforward"]
Motor = Literal["prescribed", "pi"]
Flanks = Literal["exact", "closed"]
MotionKind = Literal["trapezoid", "s_curve", "sine", "recorded"]
Event = Literal["reversal", "slow_down", "aborted", "emergency_stop"]
Observer = Literal["alpha_beta_gamma", "difference"]
TurnSource = Literal["known", "located", "unknown"]
Gap = Literal["mean", "low95", "low95_simultaneous"]

_ANY = {"ge": -1e6, "le": 1e6}
_POSITIVE = {"gt": 0, "le": 1e9}
_NOT_NEGATIVE = {"ge": 0, "le": 1e9}


class EccentricityTable(Table, frozen=True):
    """Table `[eccentricities]` of the rig, without defaults. Examples: Table 2 of the paper."""

    driving_mm: Annotated[
        float, key("eccentricity of the driving gear", "mm", ge=0, le=1e3, examples=[0.0226])
    ]
    driving_phase_deg: Annotated[
        float,
        key("its angle from the line of centres at angle 0", "deg", **_ANY, examples=[49.5]),
    ]
    driven_mm: Annotated[
        float, key("eccentricity of the driven gear", "mm", ge=0, le=1e3, examples=[0.0273])
    ]
    driven_phase_deg: Annotated[
        float,
        key("its angle from the line of centres at angle 0", "deg", **_ANY, examples=[79.3]),
    ]
    constant_backlash_deg: Annotated[
        float,
        key(
            "backlash without eccentricities, angle of the driven gear",
            "deg",
            ge=0,
            le=90,
            examples=[0.038],
        ),
    ]


class MapTable(Table, frozen=True):
    """Table `[map]`: other eccentricities that the controller believes, key by key.

    It goes with `[eccentricities]`; `controller_map` names a whole map instead.
    """

    driving_mm: (
        Annotated[
            float, key("eccentricity of the driving gear", "mm", ge=0, le=1e3, examples=[0.0226])
        ]
        | None
    ) = None
    driving_phase_deg: Annotated[float, key("its angle", "deg", **_ANY, examples=[49.5])] | None = (
        None
    )
    driven_mm: (
        Annotated[
            float, key("eccentricity of the driven gear", "mm", ge=0, le=1e3, examples=[0.0273])
        ]
        | None
    ) = None
    driven_phase_deg: Annotated[float, key("its angle", "deg", **_ANY, examples=[79.3])] | None = (
        None
    )
    constant_backlash_deg: (
        Annotated[
            float, key("backlash without eccentricities", "deg", ge=0, le=90, examples=[0.038])
        ]
        | None
    ) = None


class MotionTable(Table, frozen=True):
    """Table `[motion]` of the driving shaft."""

    kind: Annotated[MotionKind, key("shape of the speed; recorded: that of `file`")] = "trapezoid"
    event: Annotated[Event, key("reversal, or an event instead of it or before it")] = "reversal"
    speed_rpm: Annotated[
        float, key("steady speed of the driving shaft; sine: peak speed", "rpm", gt=0, le=1e6)
    ] = 60.0
    reversal_deg: Annotated[
        float, key("driving angle of the turn; slow_down: end angle", "deg", **_POSITIVE)
    ] = 7560.0
    dwell_s: Annotated[
        float,
        key("standstill at both ends; slow_down: also time at slow speed", "s", ge=0, le=1e6),
    ] = 2.0
    ramp_s: Annotated[float, key("time between standstill and steady speed", "s", gt=0, le=1e6)] = (
        0.5
    )
    slow_share: Annotated[
        float, key("slow_down, aborted: slow speed over steady speed", "1", gt=0, lt=1)
    ] = 0.3
    stop_s: Annotated[float, key("emergency_stop: stopping time", "s", gt=0, le=1e6)] = 0.05
    file: Annotated[
        str, key("recorded: CSV with time_s and driving_deg, relative to the scenario")
    ] = ""


class InertiaTable(Table, frozen=True):
    """Table `[inertia]`: moment of inertia of each shaft with all parts that turn with it."""

    driven_kgm2: Annotated[float, key("driven shaft and parts on it", "kg m^2", **_POSITIVE)] = 0.01
    driving_kgm2: Annotated[
        float, key("driving shaft and parts on it; servo motor only", "kg m^2", **_POSITIVE)
    ] = 0.002


class FrictionTable(Table, frozen=True):
    """Table `[friction]` of the driven shaft, and dry friction of the driving shaft."""

    coulomb_Nm: Annotated[
        float, key("dry friction of the turning driven shaft", "N m", **_NOT_NEGATIVE)
    ] = 0.1
    viscous_Nms: Annotated[
        float, key("viscous friction torque per speed", "N m s/rad", **_NOT_NEGATIVE)
    ] = 0.0
    stribeck_Nm: Annotated[
        float, key("additional dry friction at standstill", "N m", **_NOT_NEGATIVE)
    ] = 0.0
    stribeck_rad_s: Annotated[
        float, key("speed at which half of the addition remains", "rad/s", **_POSITIVE)
    ] = 0.1
    driving_Nm: Annotated[
        float, key("dry friction of the driving shaft; servo motor only", "N m", **_NOT_NEGATIVE)
    ] = 0.05


class ServoTable(Table, frozen=True):
    """Table `[servo]`: motor of the driving shaft."""

    motor: Annotated[
        Motor, key("prescribed: exact motion with unlimited torque; pi: servo motor")
    ] = "prescribed"
    speed_gain_Nms: Annotated[
        float, key("pi: torque per speed error", "N m s/rad", **_POSITIVE)
    ] = 1.0
    integral_gain_Nm: Annotated[
        float, key("pi: torque per integral of the speed error", "N m/rad", **_NOT_NEGATIVE)
    ] = 20.0
    position_gain_1_s: Annotated[
        float, key("pi: speed per position error; 0: no position loop", "1/s", **_NOT_NEGATIVE)
    ] = 20.0
    torque_limit_Nm: Annotated[float, key("pi: largest torque", "N m", **_POSITIVE)] = 5.0


class LoadTable(Table, frozen=True):
    """Table `[load]` of the driven shaft."""

    torque_Nm: Annotated[
        float,
        key("constant load torque; a positive one opposes forward motion", "N m", **_ANY),
    ] = 0.0


class MeshTable(Table, frozen=True):
    """Table `[mesh]`: contact of the flanks."""

    restitution: Annotated[
        float, key("rigid: relative speed after an impact over that before", "1", ge=0, le=1)
    ] = 0.3
    stiffness_N_mm_um: Annotated[
        float,
        key("elastic: mesh stiffness per face width, ISO 6336", "N/(mm um)", **_POSITIVE),
    ] = 20.0
    damping_ratio: Annotated[
        float, key("elastic: damping over critical damping", "1", ge=0, le=100)
    ] = 0.1
    friction_coefficient: Annotated[
        float, key("coefficient of friction between the flanks", "1", ge=0, le=10)
    ] = 0.0


class EncoderTable(Table, frozen=True):
    """Tables `[driving_encoder]` and `[driven_encoder]` of the shaft encoders."""

    counts_per_rev: (
        Annotated[
            int,
            key(
                "counts per revolution, by default those of the pair file; 0: not quantised",
                "counts",
                ge=0,
                le=2**40,
                examples=[90000],
            ),
        ]
        | None
    ) = None
    amplitude_arcsec: Annotated[
        float, key("amplitude of the error once per revolution", "arcsec", ge=0, le=648_000)
    ] = 0.0
    phase_deg: Annotated[float, key("phase of that error", "deg", **_ANY)] = 0.0
    noise_arcsec: Annotated[
        float, key("standard deviation of white noise", "arcsec", ge=0, le=648_000)
    ] = 0.0


class ActuatorTable(Table, frozen=True):
    """Table `[actuator]` of the axial actuator of the driven gear."""

    speed_mm_s: Annotated[float, key("largest speed", "mm/s", **_POSITIVE)] = 20.0
    acceleration_mm_s2: Annotated[float, key("largest acceleration", "mm/s^2", **_POSITIVE)] = (
        2000.0
    )
    resolution_mm: Annotated[float, key("smallest step; 0: continuous", "mm", ge=0, le=1e3)] = 0.0
    delay_s: Annotated[
        float, key("dead time, a whole number of controller periods", "s", ge=0, le=1e3)
    ] = 0.0
    stroke_mm: Annotated[float, key("largest shift", "mm", gt=0, le=1e5)] = 10.0
    force_limit_N: Annotated[
        float, key("largest axial force; 0: no limit", "N", **_NOT_NEGATIVE)
    ] = 0.0


class JudgementTable(Table, frozen=True):
    """Table `[judgement]`: detection of a reversal by the controller."""

    turn: Annotated[
        TurnSource,
        key("turn of the hunting period; located: from one reading of both shafts"),
    ] = "known"
    observer: Annotated[Observer, key("estimator of speed and acceleration")] = "alpha_beta_gamma"
    bandwidth_hz: Annotated[float, key("bandwidth of the observer", "Hz", **_POSITIVE)] = 20.0
    threshold_rad_s2: Annotated[
        float, key("acceleration: deceleration that counts as a reversal", "rad/s^2", **_POSITIVE)
    ] = 1.0
    least_rpm: Annotated[
        float,
        key("below it: acceleration keeps its state, predictive closes", "rpm", **_POSITIVE),
    ] = 3.0
    horizon_s: Annotated[
        float, key("predictive: closes if the shaft will stop within it", "s", **_POSITIVE)
    ] = 0.3
    margin_mm: Annotated[
        float, key("part of the closing shift that is not commanded", "mm", ge=-1e3, le=1e3)
    ] = 0.01
    jump_s: Annotated[
        float, key("feedforward: time in which the motor crosses the gap", "s", gt=0, le=1e3)
    ] = 0.005


class SamplingTable(Table, frozen=True):
    """Table `[sampling]`: rates of controller and plant."""

    controller_hz: Annotated[float, key("controller rate", "Hz", gt=0, le=1e7)] = 1000.0
    plant_hz: Annotated[
        float,
        key("plant rate, a whole multiple of controller_hz; 0: equal to it", "Hz", ge=0, le=1e9),
    ] = 0.0


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
