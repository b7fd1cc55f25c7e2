"""The result of a fit: parameters, orders, checks, and the flank model they make."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..base.tables import key_values, text_table
from ..base.units import ARCSEC, DEG
from ..kinematics.orders import OrderModel
from ..kinematics.te_curve import TECurve
from ..pair.eccentricities import Eccentricities
from ..pair.gears import Drive, GearPair
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
    - `checks`: closure, reversal jumps, order amplitudes, ratio, drift.
    - `notes`: sentences on what was left out and why.
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
    checks: dict
    notes: tuple[str, ...]

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
            "noise": {
                "model": f"AR({len(self.noise.coefficients)})",
                "coefficients": self.noise.coefficients.tolist(),
                "block_s": self.noise.block_s,
                "std_deg": self.noise.std / DEG,
                "innovation_std_deg": self.noise.innovation_std / DEG,
                "correlation_s": self.noise.correlation_s,
            },
            "residual_rms_deg": self.residual_rms_deg,
            "parameters": {name: p.to_json() for name, p in self.parameters.items()},
            "orders": [order.to_json() for order in self.orders],
            "checks": self.checks,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        shown = [p for p in self.parameters.values() if p.determined]
        rms = self.residual_rms_deg
        noise = (
            f"AR({len(self.noise.coefficients)}) of blocks of {_duration(self.noise.block_s)},"
            f" correlation time {_duration(self.noise.correlation_s)}"
        )
        head = key_values(
            [
                ("log", self.source),
                ("outcome", self.outcome.replace("_", " ")),
                ("flanks", " and ".join(self.flanks)),
                ("samples", _samples(self.samples)),
                ("zero of both angles", _ZEROS[self.zero]),
                ("residual", f"{rms:.5f}° rms ({rms * DEG / ARCSEC:.2f}″)"),
                ("noise", noise),
                ("drift", _drift(self.checks["drift_order"])),
            ],
            title=self.pair.name or "fit",
        )
        table = text_table(
            [_row(p) for p in shown], ["parameter", "value", "std", "95 % interval", "unit"]
        )
        parts = [head, table]
        if self.conditional_on:
            parts.append("conditional on: " + ", ".join(self.conditional_on).replace("_", " "))
        parts += _listed("undetermined", self._open_reasons())
        parts += _listed("checks", self._check_sentences())
        parts += _listed("notes", list(self.notes))
        return "\n\n".join(parts)

    def _open_reasons(self) -> list[str]:
        """Undetermined parameters, those of one reason together."""
        together: dict[str, list[str]] = {}
        for parameter in self.parameters.values():
            if not parameter.determined:
                together.setdefault(parameter.reason or "", []).append(parameter.name)
        return [f"{', '.join(names)}: {reason}" for reason, names in together.items()]

    def _check_sentences(self) -> list[str]:
        sentences = []
        if found := self.checks["closure"]:
            sentences.append(
                f"closure after {found['period_deg']:g}°: {found['rms_deg']:.5f}° rms"
                f" ({found['mean_deg']:+.5f}° mean) over {found['overlap_deg']:.0f}°"
            )
        for jump in self.checks["reversals"][:3]:
            sentence = f"jump at {jump['driving_deg']:.1f}°: {jump['jump_deg']:.5f}°"
            if "constant_backlash_deg" in jump:
                sentence += (
                    f", less j_v there {jump['constant_backlash_deg']:.5f}° (the paper's way to the"
                    " constant backlash)"
                )
            sentences.append(sentence)
        if (drawing := self.checks["drawing_backlash_deg"]) is not None:
            sentences.append(f"constant backlash by the drawing: {drawing:.4f}°")
        return sentences


_ZEROS = {"start": "the first sample", "reading": "where the channel reads zero"}


def _samples(samples: dict[str, int]) -> str:
    return (
        f"{samples['read']} read, {samples['used']} used ({samples['forward']} forward,"
        f" {samples['backward']} backward)"
    )


def _listed(title: str, lines: list[str]) -> list[str]:
    return ["\n".join([f"{title}:", *(f"  {line}" for line in lines)])] if lines else []


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def _drift(order: int) -> str:
    return f"power {order} of time" if order else "none"


def _row(parameter: Parameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", p.unit]
    places = _places(p.std or 0.0, p.value)
    number = lambda x: f"{x:.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        return [p.name, f"< {number(p.upper95)}", number(p.std), "upper limit", p.unit]
    span = f"{number(p.low95)} … {number(p.high95)}"
    mark = "" if p.significant else " (not significant)"
    return [p.name, number(p.value) + mark, number(p.std), span, p.unit]


def _places(std: float, value: float) -> int:
    """Decimals that show two digits of the standard error."""
    size = std if std > 0 else abs(value) * 1e-6
    return 3 if size == 0 else int(np.clip(1 - np.floor(np.log10(size)), 0, 12))
