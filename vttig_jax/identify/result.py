"""The result of a fit: parameters, orders, checks, and the flank model they make."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError
from ..base.units import DEG
from ..kinematics.orders import OrderModel
from ..kinematics.te_curve import TECurve
from ..pair.eccentricities import Eccentricities
from ..pair.gears import Drive, GearPair
from .evidence import Evidence
from .noise import NoiseModel
from .order_table import Order
from .parameters import Parameter

Outcome = Literal["ok", "partly_determined", "not_determined", "not_converged"]


@dataclass(frozen=True)
class Fit:
    """What a log says about a gear pair or drive.

    **Arguments**
    - `parameters`: every name of the contract → `Parameter`.
    - `orders`: every fitted harmonic, flank by flank.
    - `model`: the order-complete flank model, absolute, as measured (encoder errors included).
    - `curves`: block-averaged transmission error, one a certain run; `residuals` beside them, rad.
    - `noise`, `residual_rms_deg`: of block means, and of single samples.
    - `covariance`, `covariance_names`: of the Cartesian parameters, mm and rad.
    - `checks`: closure, reversal jumps, order amplitudes, ratio, drift; the search for lines and
      the comparisons inside the log are carried out when they are first read.
    - `notes`: sentences on what was left out and why.
    - `regressors`: coefficients of torque, acceleration, speed and ratio that were fitted.
    - `logs`: file, digest, zero and samples of every log.
    - `evidence`: the compressed logs; what `sample` works on.
    """

    pair: GearPair | Drive
    source: str
    sha256: str
    outcome: Outcome
    flanks: tuple[str, ...]
    samples: dict[str, int]
    zero: str
    zero_readings: dict[str, float | int | None]
    conditional_on: tuple[str, ...]
    parameters: dict[str, Parameter]
    orders: tuple[Order, ...]
    model: OrderModel
    noise: NoiseModel
    residual_rms_deg: float
    curves: tuple[TECurve, ...]
    residuals: tuple[Float[np.ndarray, " _"], ...]
    covariance: Float[np.ndarray, "p p"]
    covariance_names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    checks: Mapping[str, Any]
    notes: tuple[str, ...]
    regressors: tuple[Parameter, ...] = ()
    logs: tuple[dict, ...] = ()
    evidence: Evidence | None = None

    def value(self, name: str) -> float:
        """Value of a parameter; NaN where it has none."""
        value = self.parameters[name].value
        return float("nan") if value is None else value

    def eccentricities(self, constant_backlash_deg: float | None = None) -> Eccentricities:
        """The fitted rig; amplitudes that are undetermined count as zero.

        `constant_backlash_deg` replaces the fitted value.
        """
        cartesian = dict(zip(self.covariance_names, self.values, strict=True))
        driving, driven = (
            complex(cartesian[f"{shaft}_x"], cartesian[f"{shaft}_y"])
            if self.parameters[f"{shaft}_eccentricity_mm"].determined
            else 0.0
            for shaft in ("driving", "driven")
        )
        if constant_backlash_deg is None:
            constant_backlash_deg = cartesian.get("constant_backlash", 0.0) / DEG
        return Eccentricities(
            abs(driving),
            np.angle(driving, deg=True),
            abs(driven),
            np.angle(driven, deg=True),
            constant_backlash_deg,
        )

    def to_json(self) -> dict:
        """The object of schema `vttig.fit/1`."""
        return {
            "schema": "vttig.fit/1",
            "outcome": self.outcome,
            "source": self.source,
            "sha256": self.sha256,
            "pair": self.pair.name,
            "flanks": list(self.flanks),
            "samples": self.samples,
            "zero": self.zero,
            "zero_readings": self.zero_readings,
            "conditional_on": list(self.conditional_on),
            "noise": self.noise.to_json(),
            "residual_rms_deg": self.residual_rms_deg,
            "parameters": {name: p.to_json() for name, p in self.parameters.items()},
            "regressors": {p.name: p.to_json() for p in self.regressors},
            "orders": [order.to_json() for order in self.orders],
            "logs": list(self.logs),
            "checks": dict(self.checks),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        from .fit_text import fit_text

        return fit_text(self)


def require_rig(fit: Fit) -> None:
    """Refuse a fit that leaves open which rig it is, for a simulation.

    **Raises** `NoAnswerError` for a drive without gears, and without a constant backlash.
    """
    if isinstance(fit.pair, Drive):
        raise NoAnswerError(
            "a drive without gear geometry has no eccentricities to simulate; give [pair].",
            where=fit.source,
        )
    gap = fit.parameters["constant_backlash_deg"]
    if not gap.determined:
        raise NoAnswerError(
            f"the constant backlash is undetermined ({gap.reason}), so that there is no gap to"
            " simulate; record both directions.",
            where=fit.source,
        )
