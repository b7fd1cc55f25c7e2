"""How slow a drift the logs show: the power of time that the information criterion asks for."""

from collections.abc import Sequence

from .own_terms import OwnTerms

AUTOMATIC_DRIFT = 2
"""Highest power of time that is chosen without being asked for."""


def drift_names(names: Sequence[str], order: int) -> list[str]:
    """Coefficients of the powers of time up to `order` among those of the own columns."""
    powers = {f"drift_{power}" for power in range(1, order + 1)}
    return [name for name in names if name.split("_of_")[0] in powers]


def choose_drift(own: OwnTerms, beside: Sequence[str] = ()) -> int:
    """Power of time, 0 to 2, by BIC with the coefficients `beside` in the model.

    All powers are judged under one noise, that of the highest: each with its own would trade drift
    for correlation.
    """
    if own.is_exact:
        return 0
    scores = [
        own.bic([*drift_names(own.names, order), *beside]) for order in range(AUTOMATIC_DRIFT + 1)
    ]
    return scores.index(min(scores))
