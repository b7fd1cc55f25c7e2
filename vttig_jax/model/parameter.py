"""Parameter of a fit: its value and interval, or the reason why it has none."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..base.units import ARCSEC, DEG, REV

BELOW = "below three standard errors"
UPPER = f"{BELOW}: an upper limit only"
LARGEST = {"arcsec": REV / ARCSEC, "deg": REV / DEG}
"""Unit → one revolution. An error of a gear is far smaller, so a wider interval says nothing."""

OPEN = "the interval is wider than one revolution, so that the log says nothing about the value"

_KEYS = ("value", "std", "low95", "high95", "unit", "determined", "significant", "reason")
_IF_KNOWN = ("upper95", "freedom")


@dataclass(frozen=True)
class Parameter:
    """Parameter of the result with its uncertainty.

    If the data do not determine the parameter, `determined` is False, `value` is None, and `reason`
    is given. A value below three standard errors is not `significant`: an amplitude then has an
    upper limit `upper95`, and its phase has no value. `low95` and `high95` are the bounds of the
    equal-tailed 95 % interval (Laplace approximation); for a phase they may be outside [0°, 360°).
    They are the quantile of Student's t with ν = `freedom` degrees of freedom times `std` away.
    """

    name: str
    unit: str
    value: float | None = None
    std: float | None = None
    low95: float | None = None
    high95: float | None = None
    determined: bool = False
    significant: bool = False
    reason: str | None = None
    upper95: float | None = None
    freedom: float | None = None

    def to_json(self) -> dict:
        """Return the fields in the JSON object of a fit, the last two only if they are known."""
        known = [name for name in _IF_KNOWN if getattr(self, name) is not None]
        return {name: getattr(self, name) for name in (*_KEYS, *known)}


def open_reasons(parameters: Iterable[Any]) -> list[str]:
    """Return lines with undetermined parameters and the reason, which several may share."""
    together: dict[str, list[str]] = {}
    for parameter in parameters:
        if not parameter.determined:
            together.setdefault(parameter.reason or "", []).append(parameter.name)
    return [f"{', '.join(names)}: {reason}" for reason, names in together.items()]
