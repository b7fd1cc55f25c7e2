"""Scenarios of a calibration: rig, noise, motion and model of the fit, with a short or long run."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ...identify.compress.block_means import block_size
from ...identify.model.column_layout import ColumnLayout
from ...identify.model.forward_model import PairRelation, pair_relation
from ...identify.model.harmonics import TermPlan, plan_terms
from ...pair.gear_pair import Flank, GearPair
from ...pair.schema import HarmonicOrders
from ...rig.paper import paper_pair

Length = Literal["short", "long"]

DRIVING_TURNS: dict[Length, float] = {"short": 2 * 80 / 45, "long": 21.0}
"""Turns of the driving shaft in each direction.

The short run is two turns of the *driven* shaft. Two turns of the driving shaft would not suffice:
the first orders of both shafts have a beat of 2.29 driving turns and could not be separated."""

_FIRST = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=1)
"""First orders of both shafts and of the tooth mesh; the mesh needs rows of 5.5 ms at 60 rpm."""

_ALL = HarmonicOrders()
_SHORT_PITCH = HarmonicOrders(driving_orders=tuple(range(1, 5)), driven_orders=tuple(range(1, 5)))


@dataclass(frozen=True)
class Scenario:
    """One kind of rig, log and fit.

    **Arguments**
    - `name`, `words`: name and description in the table.
    - `holds`: True if the model of the fit is right, so that its intervals must be calibrated;
      False for a wrong model, which the calibration must detect.
    - `length`, `turns`: length of the run; driving turns in each direction.
    - `rate_hz`, `speed_rpm`: sampling rate, and speed of the driving shaft.
    - `noise_std_deg`, `correlation_s`: standard deviation and correlation time of the noise of a
      sample of the transmission error.
    - `counts_per_rev`: counts of both encoders; None for readings without quantisation.
    - `encoder_arcsec`: amplitude of the encoder errors. With `encoders` = "disc" it is the radius
      of a disc of uniform density; with "ring" every error has this amplitude and a random phase.
    - `options`: orders that the rig has and the fit models; `pitch_rms_deg` is the rms of all pitch
      orders of a flank together, and `mesh_deg` the amplitude of a mesh order.
    - `missing`: amplitude, in standard errors, of a second order of the driven gear that the rig
      has and the fit omits.
    - `encoder_terms`, `flanks`: whether the fit has encoder errors, and the recorded flanks.
    """

    name: str
    words: str
    holds: bool = True
    length: Length = "long"
    rate_hz: float = 2000.0
    speed_rpm: float = 60.0
    noise_std_deg: float = 0.002
    correlation_s: float = 0.00475
    counts_per_rev: int | None = None
    encoder_arcsec: float = 18.0
    encoders: Literal["disc", "ring"] = "disc"
    options: HarmonicOrders = _FIRST
    pitch_rms_deg: float = 0.002
    mesh_deg: float = 0.003
    missing: float = 0.0
    encoder_terms: bool = True
    flanks: tuple[Flank, ...] = ("A", "B")

    @property
    def turns(self) -> float:
        """Driving turns in each direction."""
        return DRIVING_TURNS[self.length]

    @property
    def samples(self) -> int:
        """Number of samples in each direction."""
        return int(self.turns * 60.0 / self.speed_rpm * self.rate_hz)

    @property
    def pair(self) -> GearPair:
        """Gears of the paper's rig."""
        return paper_pair()

    @property
    def case(self) -> str:
        """Name of the case: name and length of the scenario, for example "white (long)"."""
        return f"{self.name} ({self.length})"

    def of_length(self, length: Length) -> "Scenario":
        """Return the scenario with a short or long run.

        A short run with all orders has only orders 1 to 4 of the shafts, because it cannot separate
        the orders 5 to 8 of one shaft from those of the other shaft.
        """
        options = self.options
        if options == _ALL and length == "short":
            options = _SHORT_PITCH
        return replace(self, length=length, options=options)


_SCENARIOS = (
    Scenario("white", "white noise", correlation_s=0.0),
    Scenario("ar_1ms4", "noise with a memory of 1.4 ms", correlation_s=0.0014),
    Scenario("ar_4ms75", "noise with a memory of 4.75 ms"),
    Scenario("ar_25ms", "noise with a memory of 25 ms", correlation_s=0.025),
    Scenario("orders", "mesh and pitch orders, modelled", options=_ALL),
    Scenario("encoders", "18″ encoders, modelled", encoders="ring"),
    Scenario(
        "counts",
        "counting dominates, 43.38 counts a sample",
        rate_hz=1987.0,
        speed_rpm=57.466,  # 2074.62 samples a turn: a whole number would repeat the same errors
        noise_std_deg=0.0005,
        correlation_s=0.0,
        counts_per_rev=90_000,
    ),
    Scenario(
        "one_direction",
        "one direction, perfect encoders",
        encoder_arcsec=0.0,
        encoder_terms=False,
        flanks=("A",),
    ),
    Scenario("missing_order", "driven order 2 of 10 s.e. left out", holds=False, missing=10.0),
    Scenario(
        "encoders_left_out",
        "18″ encoders left out",
        holds=False,
        encoders="ring",
        encoder_terms=False,
    ),
)

SCENARIOS: dict[str, Scenario] = {scenario.name: scenario for scenario in _SCENARIOS}
"""Scenarios by name, in the order of the table."""


JUDGED = ("constant_backlash", "driving_", "driven_")
"""Beginnings of the names of the parameters whose coverage is tested; offsets are not tested."""


def terms_of(scenario: Scenario) -> TermPlan:
    """Return the harmonics that the fit models."""
    pair, options = scenario.pair, scenario.options
    return plan_terms(
        pair.ratio,
        options.driving_orders,
        options.driven_orders,
        options.mesh_orders,
        pair.driving.teeth,
    )


def columns_of(terms: TermPlan) -> ColumnLayout:
    """Return the column layout of one log without drift."""
    return ColumnLayout(tuple(h.term for h in terms.free), tuple(h.term for h in terms.tied))


def relation_of(scenario: Scenario) -> PairRelation:
    """Return the forward model, which computes the tied coefficients from the parameters."""
    terms = terms_of(scenario)
    return pair_relation(
        scenario.pair,
        terms,
        columns_of(terms),
        scenario.flanks,
        encoder_terms=scenario.encoder_terms,
    )


def judged_parameters(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the indices in `names` of the parameters whose coverage is tested."""
    return tuple(k for k, name in enumerate(names) if name.startswith(JUDGED))


_RIPPLE, _RIPPLE_ORDER = 0.001, 6  # relative ripple of the speed, and its order (chosen)


def driving_angles(scenario: Scenario) -> Float[np.ndarray, "flanks n"]:
    """Return the true driving angles of each flank, rad: forward on flank A, backward on flank B.

    The speed has a small ripple.
    """
    time = np.arange(scenario.samples) / scenario.rate_hz
    forward = REV * scenario.speed_rpm / 60.0 * time
    passes = {"A": forward, "B": REV * scenario.turns - forward}
    angle = np.stack([passes[flank] for flank in scenario.flanks])
    return angle + _RIPPLE / _RIPPLE_ORDER * np.sin(_RIPPLE_ORDER * angle)


def row_size(scenario: Scenario) -> int:
    """Return the number of samples per row, which is that of a fit of this motion."""
    terms = terms_of(scenario)
    highest = float(max(terms.frequency(term) for term in terms.terms))
    steps = np.abs(np.diff(driving_angles(scenario)[0]))
    return block_size(REV / float(steps.max()), highest)
