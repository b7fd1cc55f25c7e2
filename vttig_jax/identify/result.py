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

_HALVES_DIFFER = 4.0
_CLEAR, _MOST_ORDERS = 4.0, 8
"""Standard errors from which a further order is printed, and how many of them."""

_UNKNOWN_DEG = 60.0
"""Standard error from which a start angle is called unknown."""

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
    - `regressors`: coefficients of torque, acceleration, speed and ratio that were fitted.
    - `logs`: file, digest, zero and samples of every log.
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
    regressors: tuple[Parameter, ...] = ()
    logs: tuple[dict, ...] = ()

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
            "regressors": {p.name: p.to_json() for p in self.regressors},
            "orders": [order.to_json() for order in self.orders],
            "logs": list(self.logs),
            "checks": self.checks,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        shown = [p for p in (*self.parameters.values(), *self.regressors) if p.determined]
        rms = self.residual_rms_deg
        noise = (
            f"AR({len(self.noise.coefficients)}) of blocks of {_duration(self.noise.block_s)},"
            f" {_memory(self.noise)}"
        )
        head = key_values(
            [
                *(("log", one["source"]) for one in self.logs[1:] and self.logs),
                *([] if self.logs[1:] else [("log", self.source)]),
                ("outcome", self.outcome.replace("_", " ")),
                ("flanks", " and ".join(self.flanks)),
                ("samples", _samples(self.samples)),
                ("zero of both angles", _ZEROS[self.zero]),
                *_starts(self.logs),
                ("residual", f"{rms:.5f}° rms ({rms * DEG / ARCSEC:.2f}″)"),
                ("noise", noise),
                ("drift", _drift(self.checks)),
            ],
            title=self.pair.name or "fit",
        )
        table = text_table(
            [_row(p) for p in shown], ["parameter", "value", "std", "95 % interval", "unit"]
        )
        parts = [head, table, *_orders(self.orders)]
        if self.conditional_on:
            parts.append("conditional on: " + ", ".join(self.conditional_on).replace("_", " "))
        parts += _listed("undetermined", self._open_reasons())
        parts += _listed("checks", self._check_sentences())
        parts += _listed("notes", list(self.notes))
        return "\n\n".join(parts)

    def _open_reasons(self) -> list[str]:
        """Undetermined parameters, those of one reason together."""
        together: dict[str, list[str]] = {}
        for parameter in (*self.parameters.values(), *self.regressors):
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
        sentences += [
            _pass(one, several=len(self.logs) > 1) for one in self.checks.get("passes", [])[:3]
        ]
        sentences += [_half(one) for one in self.checks.get("halves", []) if _differs(one)]
        for line in self.checks.get("lines", []):
            place = f" of log {line['log']}" if line["log"] else ""
            sentences.append(
                f"line left in the residual{place}: {line['amplitude_arcsec']:.3g}″ ±"
                f" {line['amplitude_std_arcsec']:.1g}″ at {line['cycles_per_rev']:.5g} cycles per"
                f" driving revolution (false alarm {line['false_alarm']:.1g})"
            )
        white = self.checks.get("whiteness")
        if white and white["widening"] > 1:
            sentences.append(
                "the residual remembers more than the noise model allows for (Ljung–Box"
                f" {white['probability']:.1g}): standard errors are taken from blocks of the log,"
                f" up to {white['widening']:.2g} times larger"
            )
        for jump in self.checks["reversals"][:3]:
            place = f" of log {jump['log']}" if self.logs[1:] else ""
            sentence = f"jump at {jump['driving_deg']:.1f}°{place}: {jump['jump_deg']:.5f}°"
            if "constant_backlash_deg" in jump:
                sentence += (
                    f", less j_v there {jump['constant_backlash_deg']:.5f}° (the paper's way to the"
                    " constant backlash)"
                )
            sentences.append(sentence)
        if (gap := self.checks.get("apparent_gap")) and not self.parameters[
            "constant_backlash_deg"
        ].determined:
            low = gap["value_deg"] < -3 * gap["std_deg"]
            mark = ", no significant backlash"
            if gap["significant"]:
                mark = ""
            elif low:
                mark = ": below zero, so friction or wind-up and no backlash"
            sentences.append(
                f"flank B stands {gap['value_deg']:+.5f}° ± {gap['std_deg']:.5f}° above flank A"
                f" over the angles covered{mark}"
            )
        for log in self.checks.get("ratio", [])[:1]:
            if log["seen"] is not None:
                sentences.append(
                    f"ratio {log['given']} given, {log['seen']:.9g} ± {log['std']:.1g} seen"
                )
        if read := self.checks.get("readings"):
            joined = "joined the fit" if read["used"] else "check only"
            sentences.append(
                f"{read['count']} backlash readings ({joined}): {read['mean_deg']:+.5f}° mean,"
                f" {read['rms_deg']:.5f}° rms from the fit, scatter {read['scatter_deg']:.5f}°"
                + (": they contradict it" if read.get("contradicts") else "")
            )
        if weakest := self.checks.get("weakest_direction"):
            sentences.append(_weakest(weakest))
        if (drawing := self.checks["drawing_backlash_deg"]) is not None:
            sentences.append(f"constant backlash by the drawing: {drawing:.4f}°")
        return sentences


_ZEROS = {"start": "the first sample", "reading": "where the channel reads zero"}


def _memory(noise: NoiseModel) -> str:
    if noise.correlation_s < noise.block_s:
        return "correlated over less than a block"
    return f"correlation time {_duration(noise.correlation_s)}"


def _orders(orders: tuple[Order, ...]) -> list[str]:
    """Higher orders that stand out, the largest first, with both flanks beside each other."""
    found: dict[tuple[str, int], dict[str, Order]] = {}
    for one in orders:
        if one.order > 1 or one.shaft == "mesh":
            found.setdefault((one.shaft, one.order), {})[one.flank] = one
    clear = [
        (name, flanks)
        for name, flanks in found.items()
        if any(o.amplitude_arcsec > _CLEAR * o.std_arcsec for o in flanks.values())
    ]
    clear.sort(key=lambda item: -max(o.amplitude_arcsec for o in item[1].values()))
    if not clear:
        return []
    rows = [
        [f"{shaft} {order}", *(_amplitude(flanks.get(flank)) for flank in ("A", "B"))]
        for (shaft, order), flanks in clear[:_MOST_ORDERS]
    ]
    table = text_table(rows, ["further orders", "flank A [″]", "flank B [″]"])
    left = len(clear) - _MOST_ORDERS
    return [table + (f"\n… and {left} more in fit.json" if left > 0 else "")]


def _amplitude(order: Order | None) -> str:
    return "" if order is None else f"{order.amplitude_arcsec:.3g} ± {order.std_arcsec:.2g}"


def _starts(logs: tuple[dict, ...]) -> list[tuple[str, str]]:
    """Start angles of further logs that have their own."""
    return [
        (
            f"start of log {number}",
            ", ".join(_start(shaft, one["start"]) for shaft in ("driving", "driven")),
        )
        for number, one in enumerate(logs[1:], 2)
        if one["start"]["driving_std_deg"] > 0
    ]


def _start(shaft: str, start: dict) -> str:
    value, std = start[f"{shaft}_deg"], start[f"{shaft}_std_deg"]
    return f"{shaft} {value:.3f}° ± {std:.2g}°" if 0 < std < _UNKNOWN_DEG else f"{shaft} unknown"


def _samples(samples: dict[str, int]) -> str:
    return (
        f"{samples['read']} read, {samples['used']} used ({samples['forward']} forward,"
        f" {samples['backward']} backward)"
    )


def _listed(title: str, lines: list[str]) -> list[str]:
    return ["\n".join([f"{title}:", *(f"  {line}" for line in lines)])] if lines else []


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def _pass(one: dict, *, several: bool) -> str:
    first, second = one["passes"]
    place = f" of log {one['log']}" if several else ""
    return (
        f"flank {one['flank']}{place}, pass {second} less pass {first}: {one['mean_deg']:+.5f}°"
        f" mean, {one['scatter_deg']:.5f}° scatter over {one['overlap_deg']:.0f}°"
    )


def _differs(one: dict) -> bool:
    return one["difference_arcsec"] > _HALVES_DIFFER * one["std_arcsec"]


def _half(one: dict) -> str:
    return (
        f"{one['shaft']} order 1 on flank {one['flank']} changes by"
        f" {one['difference_arcsec']:.3g}″ ± {one['std_arcsec']:.2g}″ from the first half of the"
        " log to the second"
    )


def _weakest(weakest: dict) -> str:
    shares = weakest["parameters"].items()
    named = [(name.replace("_of_", " of log ").replace("_", " "), share) for name, share in shares]
    text = " ".join(f"{'−' if share < 0 else '+'} {name}" for name, share in named)
    return (
        f"weakest direction: {text.removeprefix('+ ')} (standard error ×"
        f" {weakest['inflation']:.3g})"
    )


def _drift(checks: dict) -> str:
    if knots_s := checks.get("drift_knots_s"):
        what = f"cubic spline with knots every {_duration(knots_s)}"
    elif checks["drift_order"]:
        what = f"power {checks['drift_order']} of time"
    else:
        return "none"
    stiffness = checks.get("drift_stiffness_s")
    return what + (f", follows nothing faster than {_duration(stiffness)}" if stiffness else "")


def _row(parameter: Parameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", p.unit]
    places = _places(p.std or 0.0, p.value)
    number = lambda x: f"{x:.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        return [p.name, f"< {number(p.upper95)}", number(p.std), "upper limit", p.unit]
    span = f"{number(p.low95)} … {number(p.high95)}"
    unlike = " (as given)" if p.name == "ratio" else " (not significant)"
    mark = "" if p.significant else unlike
    return [p.name, number(p.value) + mark, number(p.std), span, p.unit]


def _places(std: float, value: float) -> int:
    """Decimals that show two digits of the standard error."""
    size = std if std > 0 else abs(value) * 1e-6
    return 3 if size == 0 else int(np.clip(1 - np.floor(np.log10(size)), 0, 12))
