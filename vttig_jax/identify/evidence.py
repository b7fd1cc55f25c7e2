"""Compressed logs of a fit, from which the likelihood can be evaluated again without the logs."""

from dataclasses import astuple, dataclass, fields
from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ..pair.gear_pair import Drive, Flank, GearPair
from .compress.flank_summary import FlankSummary
from .compress.harmonic_summary import HarmonicSummary
from .compress.noise_kinds import NOISE
from .model.column_layout import ColumnLayout
from .model.forward_model import ForwardModel, relation_of
from .model.harmonics import Harmonic, TermPlan
from .settings import NoiseSettings


@dataclass(frozen=True, eq=False)
class Evidence:
    """All data that the likelihood of a fit needs.

    **Arguments**
    - `summary`: lag products and ends of the block rows, with the selected columns.
    - `encoder_terms`, `gear_terms`: whether the first orders contain encoder and gear errors.
    - `determined`: names of the parameters that the logs determine.
    - `jacobian`: Jacobian of the tied coefficients at the fit, shape (flanks, tied, p).
    - `partial`: partial autocorrelations of the noise.
    - `variance_factor`: factor by which a robust loss increases the variance.
    - `widening`: final standard error of every parameter divided by that of the noise model alone.
    - `delay_s`: delay already removed from the angles, s; the parameter `delay` is added to it.
    """

    summary: HarmonicSummary
    encoder_terms: bool
    gear_terms: bool
    determined: tuple[str, ...]
    jacobian: Float[np.ndarray, "flanks tied p"]
    partial: Float[np.ndarray, " order"]
    variance_factor: float
    delay_s: float
    widening: Float[np.ndarray, " p"]

    def relation(self, pair: GearPair | Drive) -> ForwardModel:
        """Return the forward model, from parameters to tied coefficients."""
        return relation_of(
            pair,
            self.summary.terms,
            self.summary.columns,
            tuple(flank.flank for flank in self.summary.flanks),
            encoder_terms=self.encoder_terms,
            gear_terms=self.gear_terms,
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the evidence as named arrays of numbers and text."""
        terms, columns = self.summary.terms, self.summary.columns
        harmonics = terms.free + terms.tied
        own = [(name, str(log)) for name, log in columns.names]
        arrays = {
            "harmonics": np.array([h.shaft for h in harmonics]),
            "harmonic_orders": np.array(
                [(h.order, *map(float, h.term)) for h in harmonics], np.float64
            ).reshape(-1, 3),
            "own": np.array(own),
            "counts": np.array([len(terms.free), len(columns.own)]),
            "flags": np.array([self.encoder_terms, self.gear_terms]),
            "numbers": np.array([self.summary.block_s, self.variance_factor, self.delay_s]),
            "determined": np.array(self.determined, str),
            "noise": np.array(astuple(self.summary.noise)),
            "jacobian": self.jacobian,
            "partial": self.partial,
            "widening": self.widening,
        }
        for flank in self.summary.flanks:
            arrays |= {
                f"{flank.flank}_{field.name}": np.asarray(getattr(flank, field.name))
                for field in fields(flank)
                if field.name != "flank"
            }
        return arrays


def evidence_from(arrays: dict[str, np.ndarray], ratio: Fraction) -> Evidence:
    """Return the evidence from the arrays of `Evidence.to_arrays`."""
    free, logs = (int(count) for count in arrays["counts"])
    harmonics = tuple(
        Harmonic(str(shaft), _number(order), (_exact(first), _exact(second)))
        for shaft, (order, first, second) in zip(
            arrays["harmonics"], arrays["harmonic_orders"], strict=True
        )
    )
    own = tuple(
        tuple(str(name) for name, log in arrays["own"] if int(log) == number)
        for number in range(logs)
    )
    flanks: tuple[Flank, ...] = ("A", "B")
    noise = NoiseSettings(*(str(word) for word in arrays["noise"]))  # pyright: ignore
    kind = NOISE[noise.kind].summary
    summary = HarmonicSummary(
        flanks=tuple(
            _flank_from(arrays, flank, kind) for flank in flanks if f"{flank}_rows" in arrays
        ),
        terms=TermPlan(ratio, harmonics[:free], harmonics[free:], ()),
        columns=ColumnLayout(
            tuple(h.term for h in harmonics[:free]), tuple(h.term for h in harmonics[free:]), own
        ),
        block_s=float(arrays["numbers"][0]),
        noise=noise,
    )
    return Evidence(
        summary,
        encoder_terms=bool(arrays["flags"][0]),
        gear_terms=bool(arrays["flags"][1]),
        determined=tuple(str(name) for name in arrays["determined"]),
        jacobian=arrays["jacobian"],
        partial=arrays["partial"],
        variance_factor=float(arrays["numbers"][1]),
        delay_s=float(arrays["numbers"][2]),
        widening=arrays.get("widening", np.ones(arrays["jacobian"].shape[2])),
    )


def _number(value: float) -> int | float:
    """Return an order as it was given: whole numbers are integers."""
    return int(value) if value == int(value) else float(value)


def _exact(value: float) -> int | Fraction:
    """Return an order of a term as an integer, or as the fraction of its shortest decimal form."""
    return int(value) if value == int(value) else Fraction(str(float(value)))


def _flank_from(
    arrays: dict[str, np.ndarray], flank: Flank, kind: type[FlankSummary]
) -> FlankSummary:
    """Return the summary of a flank; older arrays hold products of the rows Z and no triangle."""
    names = [field.name for field in fields(kind) if field.name not in ("flank", "rows")]
    parts = {name: arrays[f"{flank}_{name}"] for name in names if f"{flank}_{name}" in arrays}
    rows = int(arrays[f"{flank}_rows"])
    if "triangle" in parts:
        return kind(flank, rows=rows, **parts)
    return kind.of_products(flank, rows, **parts)
