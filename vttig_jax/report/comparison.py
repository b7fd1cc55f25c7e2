"""Differences between two runs, each with its interval and whether it counts."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..base.angles import difference_deg
from ..base.errors import UsageError
from ..base.files.text_tables import decimals, text_table
from ..base.results import TextResult
from ..model.parameter import Parameter
from ..model.parameters import SIGNIFICANT
from ..runs.map_table import RunTable
from ..runs.run import open_run
from .content import RunContent

HEADERS = ("quantity", "first", "second", "difference", "95 % interval", "counts", "unit")
_JUDGED = {
    "yes": "which counts: it is more than three standard errors",
    "perhaps": "which may be chance: it is less than three standard errors",
    "no": "which is no difference: the interval contains zero",
}


@dataclass(frozen=True)
class Difference:
    """One number of two runs, and second less first with its 95 % interval.

    The difference `counts` ("yes") if it is at least three standard errors, and "perhaps" if it is
    less but its interval does not contain zero. Without standard errors, or where the numbers
    cannot be compared, both interval and `counts` are None, and `reason` says why.
    """

    name: str
    unit: str
    first: float | None
    second: float | None
    difference: float | None = None
    std: float | None = None
    low95: float | None = None
    high95: float | None = None
    counts: Literal["yes", "perhaps", "no"] | None = None
    reason: str | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """Name, both numbers, difference, interval, whether it counts, and unit as text."""
        usual = max(abs(self.first or 0.0), abs(self.second or 0.0))
        places = decimals(self.std or 1e-2 * usual, usual)
        numbers = (self.first, self.second, self.difference, self.low95, self.high95)
        *three, low, high = ("–" if v is None else f"{v:z.{places}f}" for v in numbers)
        span = "–" if low == "–" else f"{low} … {high}"
        return self.name, *three, span, self.counts or self.reason or "", self.unit


@dataclass(frozen=True)
class Comparison(TextResult):
    """Two runs side by side: names of their folders, differences, and what they mean."""

    names: tuple[str, str]
    differences: tuple[Difference, ...]

    @property
    def verdict(self) -> tuple[str, str, str]:
        """Three sentences: the main number, what else differs, and what chance alone does."""
        judged = [one for one in self.differences if one.counts]
        others = [one.name for one in judged[1:] if one.counts == "yes"]
        if len(others) > 6:  # the table has all of them
            others[6:] = [f"and {len(others) - 6} more"]
        main = "The runs have no number in common that has an interval."
        if judged:
            name, one, other, change, span, counts, unit = judged[0].cells
            goes = "goes" if counts == "no" else "falls" if change.startswith("-") else "rises"
            main = f"From the first run to the second, {name} {goes} from {one} to {other} {unit}:"
            main += f" by {change} (95 % interval {span}), {_JUDGED[counts]}."
        return (
            main,
            f"Beside it, by more than three standard errors: {', '.join(others) or 'nothing'}.",
            f"{len(judged)} numbers were compared; by chance one in twenty leaves its interval.",
        )

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.compare/1`."""
        rows = [dict(vars(one)) for one in self.differences]
        head = {"schema": "vttig.compare/1", "runs": list(self.names)}
        return head | {"verdict": list(self.verdict), "differences": rows}

    def __str__(self) -> str:
        table = text_table([one.cells for one in self.differences], HEADERS, align="lrrrrll")
        heads = f"first   {self.names[0]}\nsecond  {self.names[1]}"
        return "\n\n".join(["\n".join(self.verdict), heads, table])


def compare_runs(*runs: "str | Path | RunContent") -> Comparison:
    """Compare two runs of one drive, for example before and after an adjustment.

    A difference d has the standard error s of both runs together, which are taken as independent,
    and the quantile of Student's t with the degrees of freedom of Welch and Satterthwaite. Phases
    are compared where the angles of both runs count from the zero of the encoders.

    **Arguments**
    - `runs`: two run folders, the first and the second.

    **Raises** `UsageError` for runs of drives with different ratios, and what `open_run` raises.
    """
    contents = [one if isinstance(one, RunContent) else RunContent(open_run(one)) for one in runs]
    fits, folders = [one.run.fit for one in contents], [str(one.run.folder) for one in contents]
    if fits[0].pair.ratio != fits[1].pair.ratio:
        ratios = " and ".join(str(fit.pair.ratio) for fit in fits)
        said = f"these are runs of drives with the ratios {ratios}; name two runs of one drive."
        raise UsageError(said, where=folders[1])
    ours, theirs = (_numbers(content) for content in contents)
    placed = all(fit.zero == "reading" for fit in fits)
    none = Parameter("", "")
    pairs = [(ours.get(k, none), theirs.get(k, none)) for k in dict.fromkeys((*ours, *theirs))]
    shown = [pair for pair in pairs if any(one.determined for one in pair)]
    return Comparison((folders[0], folders[1]), tuple(_difference(*p, placed) for p in shown))


def _numbers(content: RunContent) -> dict[str, Parameter]:
    """Return the numbers of a run by name, the gaps first; `determined` are those worth a row."""
    fit, found = content.run.fit, content.map
    gap = fit.checks.gap_over_angles_covered
    numbers = [Parameter("mean gap", "deg", gap.value, gap.std, determined=gap.determined)]
    if isinstance(found, RunTable) and (least := found.record.get("smallest_gap")):
        own = least["backlash_deg"]
        numbers += [Parameter("smallest gap", "deg", own["median"], own["std"], determined=True)]
    numbers += [*fit.parameters.values(), *fit.regressors]
    sizes = {f"peak to peak of flank {k}": v.peak_to_peak_deg for k, v in fit.flank_errors.items()}
    sizes["residual rms"] = fit.residual_rms_deg
    numbers += [Parameter(name, "deg", size, determined=True) for name, size in sizes.items()]
    for o in fit.orders:
        name = f"{o.shaft} {o.order:.5g} on flank {o.flank}"
        size = o.amplitude_arcsec, o.std_arcsec
        numbers.append(Parameter(name, "arcsec", *size, determined=o.significant))
    return {one.name: one for one in numbers}


def _difference(one: Parameter, other: Parameter, placed: bool) -> Difference:
    """Return second less first; angles are `placed` if both runs count them from one zero."""
    a, b, name = one.value, other.value, one.name or other.name
    head, cyclic = (name, one.unit or other.unit, a, b), "phase" in name
    if a is None or b is None:
        return Difference(*head, reason=f"only in the {'second' if a is None else 'first'}")
    if cyclic and not placed:
        return Difference(*head, reason="each run has a zero of its own")
    moved = float(difference_deg(b, a)) if cyclic else b - a
    if one.std is None or other.std is None:
        return Difference(*head, moved, reason="no interval")
    from scipy.special import stdtrit

    std = math.hypot(one.std, other.std)
    spread = sum(p.std**4 / p.freedom for p in (one, other) if p.std and p.freedom)
    reach = std * float(stdtrit(std**4 / spread if spread else 1e9, 0.975))
    size = abs(moved)
    counts = "no" if size <= reach else "yes" if size >= SIGNIFICANT * std else "perhaps"
    return Difference(*head, moved, std, moved - reach, moved + reach, counts)
