"""A posterior in words and a table, ending with the word of the diagnosis."""

from ..base.errors import NoAnswerError
from ..base.tables import key_values, text_table
from .draws import PosteriorParameter
from .posterior import Posterior


def posterior_text(posterior: Posterior) -> str:
    """What the draws say: parameters, the smallest gap, priors, and whether to trust them."""
    ensembles, steps, walkers = posterior.draws.shape[:3]
    counted = f"{ensembles} ensembles × {steps} steps × {walkers} walkers"
    head = key_values(
        [
            ("log", posterior.fit.source),
            ("draws", f"{counted}, seed {posterior.seed}"),
            *_gap(posterior),
        ],
        title=f"posterior of {posterior.fit.pair.name or 'fit'}",
    )
    parameters = list(posterior.parameters.values())
    rows = [_row(p) for p in parameters if p.determined]
    table = text_table(
        rows, ["parameter", "mean", "median", "std", "95 % interval", "unit"], align="lrrrrr"
    )
    parts = [head, table]
    parts += _listed("undetermined", _reasons(parameters))
    parts += _listed("priors", list(posterior.prior))
    if posterior.fit.conditional_on:
        conditions = ", ".join(posterior.fit.conditional_on).replace("_", " ")
        parts.append(f"conditional on: {conditions}")
    parts.append(str(posterior.diagnosis))
    return "\n\n".join(parts)


def _gap(posterior: Posterior) -> list[tuple[str, str]]:
    try:
        return posterior.smallest_gap.rows()
    except NoAnswerError as error:
        return [("smallest gap", f"not known: {error.message}")]


def _reasons(parameters: list[PosteriorParameter]) -> list[str]:
    """Undetermined parameters, those of one reason together."""
    together: dict[str, list[str]] = {}
    for parameter in parameters:
        if not parameter.determined:
            together.setdefault(parameter.reason or "", []).append(parameter.name)
    return [f"{', '.join(names)}: {reason}" for reason, names in together.items()]


def _listed(title: str, lines: list[str]) -> list[str]:
    return ["\n".join([f"{title}:", *(f"  {line}" for line in lines)])] if lines else []


def _row(parameter: PosteriorParameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", "", p.unit]
    places = decimals(p.std or 0.0, p.value)
    number = lambda x: "" if x is None else f"{x:.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        shown = [f"< {number(p.upper95)}", number(p.median), number(p.std), "upper limit"]
        return [p.name, *shown, p.unit]
    mark = "" if p.significant else " (not significant)"
    span = f"{number(p.low95)} … {number(p.high95)}"
    return [p.name, number(p.value) + mark, number(p.median), number(p.std), span, p.unit]


def decimals(std: float, value: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    import math

    size = std if std > 0 else abs(value) * 1e-6
    return 3 if size == 0 else min(max(1 - math.floor(math.log10(size)), 0), 12)
