"""Calibration of a fit: how often its intervals hold the truth of rigs like this one."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ...base.errors import NoAnswerError
from ...base.files.text_tables import key_values, text_table
from ...base.results import TextResult
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...identify.fit_settings import FitSettings
from ...identify.identification import told_by
from ...identify.result import Fit
from ...model.parameter import Parameter
from .drawn import LikeRigs

TOLERATED = 0.925
"""Smallest true coverage of 95 % intervals that counts as calibrated (chosen)."""

FAMILY_WISE = 0.01
"""Probability of a false alarm in the whole table (chosen)."""


@dataclass(frozen=True)
class Coverage:
    """Number `hits` of 95 % intervals that hold the truth, out of `rigs`.

    `low` and `high` are the 95 % Clopper–Pearson bounds of the true share.
    """

    hits: int
    rigs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share of the intervals that hold the truth."""
        return self.hits / self.rigs

    @property
    def probability(self) -> float:
        """Probability of so few hits, or fewer, if the true share is the smallest tolerated one."""
        return float(stats.binom.cdf(self.hits, self.rigs, TOLERATED))


def coverage(hits: int, rigs: int) -> Coverage:
    """Return a coverage with its binomial bounds.

    **Example**
    ```python
    >>> from vttig_jax.posterior import coverage
    >>> result = coverage(950, 1000)
    >>> round(result.share, 3), round(result.low, 3), round(result.high, 3)
    (0.95, 0.935, 0.963)

    ```
    """
    interval = stats.binomtest(hits, rigs).proportion_ci(0.95, "exact")
    return Coverage(hits, rigs, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Judged:
    """Intervals of one parameter over all rigs.

    **Arguments**
    - `coverage`: of the rigs that told the parameter. - `told`: share of these rigs.
    - `rms`: rms of (value − truth)/std; 1 if the standard errors are right.
    - `std`: mean standard error in `unit`. - `holds`: False if the intervals are too narrow.
    """

    name: str
    unit: str
    coverage: Coverage
    told: float
    rms: float
    std: float
    holds: bool

    def to_json(self) -> dict:
        """Return the JSON object of the parameter."""
        return {
            "unit": self.unit,
            "rigs": self.coverage.rigs,
            "share": self.coverage.share,
            "low95": self.coverage.low,
            "high95": self.coverage.high,
            "told": self.told,
            "rms_of_errors": self.rms,
            "mean_std": self.std,
            "holds": self.holds,
        }


@dataclass(frozen=True)
class Calibration(TextResult):
    """Coverage of the intervals of a fit on rigs like its own.

    **Arguments**
    - `source`: logs of the fit. - `parameters`: name → intervals of this parameter.
    - `rigs`, `seed`: number of rigs, and seed of the draws. - `seconds`: time of the computation.
    """

    source: str
    parameters: Mapping[str, Judged]
    rigs: int
    seed: int
    seconds: float

    @property
    def failed(self) -> tuple[str, ...]:
        """Parameters whose intervals are too narrow."""
        return tuple(name for name, one in self.parameters.items() if not one.holds)

    @property
    def is_calibrated(self) -> bool:
        """Whether all intervals hold as often as they claim."""
        return not self.failed

    def to_json(self) -> dict:
        """Return the object of schema `vttig.calibrate/2`."""
        return {
            "schema": "vttig.calibrate/2",
            "source": self.source,
            "calibrated": self.is_calibrated,
            "rigs": self.rigs,
            "seed": self.seed,
            "seconds": self.seconds,
            "failed": list(self.failed),
            "parameters": {name: one.to_json() for name, one in self.parameters.items()},
        }

    def __str__(self) -> str:
        head = key_values(
            [("rigs like this one", self.rigs), ("seed", self.seed)], title=self.source
        )
        rows = [
            (
                name,
                f"{100 * one.coverage.share:.1f}",
                f"{100 * one.coverage.low:.1f}–{100 * one.coverage.high:.1f}",
                f"{100 * one.told:.0f}",
                f"{one.rms:.2f}",
                f"{one.std:.2g}",
                one.unit,
                "holds" if one.holds else "TOO NARROW",
            )
            for name, one in self.parameters.items()
        ]
        titles = (
            "parameter",
            ("95 % interval holds", "%"),
            ("binomial", "%"),
            ("told", "%"),
            "rms error/std",
            "mean std",
            "unit",
            "",
        )
        verdict = "yes" if self.is_calibrated else f"NO; too narrow: {', '.join(self.failed)}"
        table = text_table(rows, titles, align="lrrrrrll")
        return "\n\n".join([head, table, f"calibrated: {verdict}"])


@one_blas_thread
def calibrate(
    fit: Fit,
    *,
    rigs: int = 400,
    seed: int = 0,
    progress: Callable[[int], None] = lambda rigs: None,
) -> Calibration:
    """Return how often the intervals of a fit hold the truth on rigs like this one.

    Every rig has the motion, the noise and the columns of the fit, and its coefficients are drawn
    from the posterior of the fit; its new rows are fitted by the same model. Outliers, the search
    for lines and the assignment of flanks are not repeated.

    **Arguments**
    - `fit`: a fit of logs; one from `read_fit` has no rows and is refused.
    - `rigs`: number of rigs. - `seed`: seed of the draws.
    - `progress`: called with the number of further rigs that are done.

    **Raises** `NoAnswerError` for a fit without a determined parameter, `ValueError` for wrong
    arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import calibrate
    >>> from vttig_jax.rig import PassMotion, paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    >>> result = calibrate(vttig_jax.fit(rig.log(), rig.pair), rigs=40)
    >>> result.is_calibrated, result.parameters["driving_eccentricity_mm"].coverage.rigs
    (True, 40)

    ```
    """
    require_x64("calibrate")
    if rigs < 1:
        raise ValueError(f"Argument `rigs` must be at least 1, but is {rigs!r}.")
    if not fit.core.rows:
        raise ValueError(
            "Argument `fit` must be a fit of logs, but is one from a folder, which keeps no rows;"
            " fit the logs again, or use `vttig calibrate RUN`."
        )
    start = time.perf_counter()
    settings = FitSettings() if fit.request is None else fit.request.settings

    def read(core) -> dict[str, Parameter]:
        return told_by(core, fit.pair, settings, fit.source)[1]

    like = LikeRigs(fit.core, fit.pair, settings.kinds)
    seen: dict[str, list[Judgement]] = {}
    units: dict[str, str] = {}
    for number in range(rigs):
        generator = np.random.default_rng([seed, number])
        beta = like.drawn(generator)
        truths, found = read(like.truth(beta)), read(like.refitted(beta, generator))
        for name, one in found.items():
            true = truths[name].value if name in truths else None
            if true is not None and (judged := _judged(one, true)) is not None:
                seen.setdefault(name, []).append(judged)
                units[name] = one.unit
        progress(1)
    if not seen:
        raise NoAnswerError("the fit tells no parameter whose intervals could be judged.")
    return Calibration(
        fit.source, _table(seen, units, rigs), rigs, seed, time.perf_counter() - start
    )


Judgement = tuple[float, bool, float]
"""Interval of a parameter of one rig: its error in standard errors, whether it holds the truth, and
its standard error."""


def _judged(found: Parameter, true: float) -> Judgement | None:
    """Return whether the interval of a parameter holds the truth.

    None for a parameter that the rig does not tell. An amplitude that is not significant has an
    upper limit, which is no equal-tailed interval and is left out, as is its phase.
    """
    if found.value is None or found.upper95 is not None:
        return None
    value, std, low, high = found.value, found.std, found.low95, found.high95
    assert std is not None and low is not None and high is not None  # all are given with a value
    if found.name.endswith("_phase_deg"):
        true = value + (true - value + 180.0) % 360.0 - 180.0
    return (value - true) / std, low <= true <= high, std


def _table(
    seen: Mapping[str, list[Judgement]], units: Mapping[str, str], rigs: int
) -> dict[str, Judged]:
    """Return the table; Holm's method judges all parameters together."""
    coverages = {
        name: coverage(sum(holds for _, holds, _ in own), len(own)) for name, own in seen.items()
    }
    narrow = set()
    ordered = sorted(coverages, key=lambda name: coverages[name].probability)
    for remaining, name in zip(range(len(ordered), 0, -1), ordered, strict=True):
        if coverages[name].probability > FAMILY_WISE / remaining:
            break
        narrow.add(name)
    return {
        name: Judged(
            name=name,
            unit=units[name],
            coverage=coverages[name],
            told=len(own) / rigs,
            rms=float(np.sqrt(np.mean([error**2 for error, _, _ in own]))),
            std=float(np.mean([std for _, _, std in own])),
            holds=name not in narrow,
        )
        for name, own in seen.items()
    }
