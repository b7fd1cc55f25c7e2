"""Calibration: random rigs are fitted, and the intervals that contain the true value are counted.

The share of these intervals is then compared with their nominal probability.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.files.text_tables import text_table
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC
from .batched_fit import BatchEstimate
from .case_result import CaseResult, Ranks
from .coverage import Cell, CoverageDisc, amplitude_ranks, normal_ranks, rejected
from .program import Batch, Program
from .rigs import LARGEST_ECCENTRICITY_MM
from .sampled_subset import sampled_coverage
from .scenarios import Scenario, judged_parameters

_HEADERS = (
    "scenario",
    ("rate", "Hz"),
    "turns",
    "N",
    "rigs",
    ("68 %", "%"),
    ("95 %", "%"),
    ("95 % white", "%"),
    "AR order",
    "verdict",
)


def calibration_text(result: "Calibration") -> str:
    """Return the report: a table with the range of coverages in every case, and the verdict.

    The range goes from the parameter with the lowest coverage to that with the highest.
    """
    rows = [_row(result, case) for case in result.cases]
    parts = [text_table(rows, _HEADERS, align="lrrrrrrrrl")]
    parts += [_sampled_row(case) for case in result.cases if case.sampled is not None]
    parts.append(
        "Coverage of nominal 68 % and 95 % intervals, lowest to highest of the parameters; N"
        " samples in all directions, turns of the driving shaft in each. White: the same logs,"
        " every sample counted as independent."
    )
    for cell in result.failed:
        parts.append(f"{cell.case}: {cell.name}, {cell.what}: p = {cell.probability:.1e}")
    parts += [f"{case}: its intervals hold although its model is wrong" for case in result.unseen]
    kinds = {case.scenario.holds for case in result.cases}
    words = {True: "right models hold", False: "wrong ones are seen to fail"}
    verdict = "yes; " + ", ".join(words[kind] for kind in (True, False) if kind in kinds)
    parts.append(f"calibrated: {verdict if result.is_calibrated else f'NO; {result.sentence}'}")
    return "\n\n".join(parts)


def _row(result: "Calibration", case: CaseResult) -> list[str]:
    s = case.scenario
    return [
        s.case,
        f"{s.rate_hz:g}",
        f"{s.turns:.2f}",
        str(case.samples),
        str(len(case.ranks)),
        _range(case, case.ranks, 0.68),
        _range(case, case.ranks, 0.95),
        _range(case, case.white_samples, 0.95),
        f"{case.orders.min()}–{case.orders.max()}",
        result.verdict(case),
    ]


def _range(case: CaseResult, ranks: Ranks, level: float) -> str:
    low, high = (100 * share for share in case.range_of(ranks, level))
    return f"{low:.1f}–{high:.1f}"


def _sampled_row(case: CaseResult) -> str:
    assert case.sampled is not None  # checked by the caller
    ranks = case.sampled.ranks
    return (
        f"{case.scenario.case}: {len(ranks)} rigs sampled, 68 % {_range(case, ranks, 0.68)} %,"
        f" 95 % {_range(case, ranks, 0.95)} %, longest autocorrelation"
        f" {case.sampled.tau.max():.0f} of {case.sampled.steps} steps"
    )


Progress = Callable[[str, int], None]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Results of all cases in the order of the scenarios; `seed` is the random seed of the rigs."""

    cases: tuple[CaseResult, ...]
    seed: int

    @cached_property
    def failed(self) -> tuple[Cell, ...]:
        """Tested numbers that the test rejects although the fit of their scenario is right.

        The coverages, the coverages of the sampled rigs and the rank histograms of amplitudes are
        tested as three families. Each family has a false rejection with a probability of 1 %.
        """
        right = [case for case in self.cases if case.scenario.holds]
        families = (CaseResult.cells, CaseResult.sampled_cells, CaseResult.amplitude_cells)
        return tuple(
            cell for of in families for cell in rejected([c for case in right for c in of(case)])
        )

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Scenarios with a wrong model in which the test rejects no coverage."""
        wrong = [case for case in self.cases if not case.scenario.holds]
        return tuple(case.scenario.case for case in wrong if not rejected(case.cells()))

    @property
    def is_calibrated(self) -> bool:
        """Whether the calibration is passed.

        In every scenario whose fit has the right model (`Scenario.holds`), the intervals must
        contain the true values as often as they claim. In every scenario with a wrong model, the
        test must reject at least one coverage.
        """
        return not (self.failed or self.unseen)

    @property
    def sentence(self) -> str:
        """Sentence that names the scenarios that did not pass; "" if all passed."""
        wrong = []
        if self.failed:
            cases = ", ".join(dict.fromkeys(cell.case for cell in self.failed))
            wrong.append(f"intervals do not hold in {cases}")
        if self.unseen:
            wrong.append(f"wrong models pass unseen in {', '.join(self.unseen)}")
        return f"{'; '.join(wrong)}." if wrong else ""

    def verdict(self, case: CaseResult) -> str:
        """Return the verdict on a case, which depends on the model of its fit.

        It is "holds" or "FAILS" for the right model, and "seen to fail" or "NOT SEEN" for a wrong
        one.
        """
        if not case.scenario.holds:
            return "NOT SEEN" if case.scenario.case in self.unseen else "seen to fail"
        return "FAILS" if any(c.case == case.scenario.case for c in self.failed) else "holds"

    def to_json(self) -> dict:
        """Return the object of schema `vttig.calibrate/1`."""
        return {
            "schema": "vttig.calibrate/1",
            "calibrated": self.is_calibrated,
            "seed": self.seed,
            "failed": [
                {"case": c.case, "name": c.name, "what": c.what, "probability": c.probability}
                for c in self.failed
            ],
            "unseen": list(self.unseen),
            "cases": [case.to_json() | {"verdict": self.verdict(case)} for case in self.cases],
        }

    def __str__(self) -> str:
        return calibration_text(self)


@one_blas_thread
def calibrate(
    scenarios: Sequence[Scenario],
    *,
    rigs: int = 2000,
    seed: int = 0,
    posterior: int = 0,
    progress: Progress = lambda case, rigs: None,
) -> Calibration:
    """Return the coverage of the intervals of `vttig_jax.fit` in every scenario.

    **Arguments**
    - `scenarios`: values of `SCENARIOS`, at the wanted length (`Scenario.of_length`).
    - `rigs`: number of rigs that are drawn and fitted in each scenario.
    - `seed`: seed of the rigs.
    - `posterior`: number of these rigs that are sampled too.
    - `progress`: called with the case and the number of rigs that were drawn, fitted or sampled.

    **Raises** `ValueError` for wrong arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import calibrate
    >>> from vttig_jax.posterior import SCENARIOS
    >>> vttig_jax.enable_x64()
    >>> result = calibrate([SCENARIOS["encoders_left_out"].of_length("short")], rigs=50)
    >>> result.is_calibrated, result.verdict(result.cases[0])
    (True, 'seen to fail')

    ```
    """
    require_x64("calibrate")
    if rigs < 1:
        raise ValueError(f"Argument `rigs` must be at least 1, but is {rigs!r}.")
    if not 0 <= posterior <= rigs:
        raise ValueError(f"Argument `posterior` must be 0 … {rigs} (rigs), but is {posterior!r}.")
    cases = [run_case(Program(scenario), rigs, seed, posterior, progress) for scenario in scenarios]
    return Calibration(tuple(cases), seed)


def run_case(
    program: Program, rigs: int, seed: int, posterior: int, progress: Progress
) -> CaseResult:
    """Draw and fit `rigs` rigs of one case, and return the ranks of their true values.

    The posteriors of the first `posterior` rigs are sampled too.
    """
    start, scenario = time.perf_counter(), program.scenario
    batches: list[Batch] = []
    for step in program.batches(rigs, seed):
        if isinstance(step, int):
            progress(scenario.case, step)
        else:
            batches.append(step)
    names = program.relation.names
    judged = list(judged_parameters(names))
    truth, orders = _joined([b.truth for b in batches]), _joined([b.fitted.order for b in batches])
    modelled = _estimates([b.fitted.modelled for b in batches])
    ranks = {
        "ranks": _ranks(truth, modelled)[:, judged],
        "white_rows": _ranks(truth, _estimates([b.fitted.white_rows for b in batches]))[:, judged],
        "white_samples": _ranks(truth, _estimates([b.fitted.white_samples for b in batches]))[
            :, judged
        ],
    }
    amplitudes = amplitude_ranks(
        truth,
        np.asarray(modelled.values),
        np.asarray(modelled.covariance),
        _discs(scenario, names),
        seed,
    )
    sampled = None
    if posterior:
        sampled = sampled_coverage(program, batches, posterior, seed, progress)
    return CaseResult(
        scenario=scenario,
        names=tuple(names[k] for k in judged),
        rows=program.rows * len(scenario.flanks),
        row_s=program.size / scenario.rate_hz,
        **ranks,
        amplitudes=amplitudes,
        orders=orders,
        std=np.sqrt(np.diagonal(modelled.covariance, axis1=1, axis2=2)).mean(axis=0)[judged],
        seconds=time.perf_counter() - start,
        sampled=sampled,
    )


def _joined(parts: list) -> np.ndarray:
    return np.concatenate([np.asarray(part) for part in parts])


def _estimates(parts: list[BatchEstimate]) -> BatchEstimate:
    return BatchEstimate(*(_joined(list(pieces)) for pieces in zip(*parts, strict=True)))


def _ranks(truth: np.ndarray, estimate: BatchEstimate) -> np.ndarray:
    std = np.sqrt(np.diagonal(np.asarray(estimate.covariance), axis1=1, axis2=2))
    return normal_ranks(truth, np.asarray(estimate.values), std)


def _discs(scenario: Scenario, names: tuple[str, ...]) -> list[CoverageDisc]:
    """Return the fitted vectors (x, y) of a rig that are drawn with uniform density in a disc."""
    radii = {"driving": LARGEST_ECCENTRICITY_MM, "driven": LARGEST_ECCENTRICITY_MM}
    if scenario.encoders == "disc" and scenario.encoder_terms:
        radii |= {f"{shaft}_encoder": scenario.encoder_arcsec * ARCSEC for shaft in list(radii)}
    return [
        CoverageDisc(name, names.index(f"{name}_x"), names.index(f"{name}_y"), radius)
        for name, radius in radii.items()
    ]
