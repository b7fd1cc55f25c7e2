"""Settings of a controller that can be tuned, and their bounds; this module needs no jax."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from msgspec import Meta

from ...base.files.toml_io import Key
from ..scenario.axes import unknown_key
from ..scenario.spec import ECCENTRICITIES, KEYS, ScenarioSpec, believed_map

_BOTH = ("judgement.bandwidth_hz", "judgement.least_rpm", "judgement.margin_mm")
SETTINGS: Mapping[str, tuple[str, ...]] = {
    "acceleration": ("judgement.threshold_rad_s2", *_BOTH),
    "predictive": ("judgement.horizon_s", *_BOTH),
    "feedforward": ("map.constant_backlash_deg", "judgement.jump_s"),
}
"""Controller → its numeric settings."""

REACH = 1000.0
"""Largest factor by which the search changes a positive number from its start; a chosen value."""

Limits = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class FreeKey:
    """Tuned number.

    **Arguments**
    - `name`, `unit`: name and unit of the key. - `start`: value in the scenario.
    - `low`, `high`: bounds of the number. - `positive`: whether the number must be above 0.
    """

    name: str
    unit: str
    start: float
    low: float
    high: float
    positive: bool

    def moved(self, value: float, step: float, size: float) -> float:
        """Return a value one step on, within the bounds.

        A number that must be positive is multiplied by exp(step), any other grows by step · size.
        """
        free = value * math.exp(step) if self.positive else value + step * size
        return min(max(free, self.low), self.high)

    def at_limit(self, value: float) -> bool:
        """Return whether a value lies at a bound."""
        near = 1e-6 * (self.high - self.low if not self.positive else value)
        return value - self.low < near or self.high - value < near


def free_keys(
    spec: ScenarioSpec, free: Sequence[str] | None = None, limits: Limits | None = None
) -> tuple[FreeKey, ...]:
    """Return the keys to tune, by default all numeric settings of the controller.

    **Raises** `ValueError` for no key, for a key that appears twice, is unknown, takes no number,
    is no setting of this controller or an axis of the sweep, and for limits without its value.
    """
    settings = SETTINGS[spec.controller]
    axes = () if spec.sweep is None else tuple(spec.sweep.axes)
    if isinstance(free, str):
        raise ValueError(f"Argument `free` must be a list of keys, but is one text: {free!r}.")
    default = settings[:1] if spec.controller == "feedforward" else settings
    names = [name for name in default if name not in axes] if free is None else list(free)
    if not names:
        raise ValueError(f"Argument `free` must name a key to tune: {', '.join(settings)}.")
    for name in names:
        _check(name, spec.controller, axes)
        if names.count(name) > 1:
            raise ValueError(f"Argument `free` must name `{name}` once, but does so twice.")
    bounds = dict(limits or {})
    if fixed := [name for name in bounds if name not in names]:
        raise ValueError(
            f"Argument `limits` must be for keys that are free, but `{fixed[0]}` is not; free are"
            f" {', '.join(names)}."
        )
    for name in names:
        if _start(spec, name) is None:
            raise ValueError(
                f"Argument `free` names `{name}`, but the scenario has no start for it: write its"
                " value, because the gap of a map has no number of its own."
            )
    return tuple(_free(KEYS[name], _start(spec, name), bounds.get(name)) for name in names)


def _check(name: str, controller: str, axes: Sequence[str]) -> None:
    if name not in KEYS:
        raise ValueError(f"Argument `free`: {unknown_key(name, KEYS)}")
    if float not in KEYS[name].types and int not in KEYS[name].types:
        raise ValueError(
            f"Argument `free` must name keys that take a number, but `{name}` takes none."
        )
    if name not in SETTINGS[controller]:
        raise ValueError(
            f"Argument `free` must name settings of the controller, but `{name}` is none of"
            f" {controller}; it is set by {', '.join(SETTINGS[controller])}."
        )
    if name in axes:
        raise ValueError(
            f"Argument `free` must name keys that the sweep does not vary, but `{name}` is an axis"
            " of the sweep; remove one of them."
        )


def _start(spec: ScenarioSpec, name: str) -> Any:
    """Return the value of a key in the scenario, or None; a gap in [map] starts at the true one."""
    table, _, field = name.rpartition(".")
    value = getattr(getattr(spec, table), field)
    if value is None and believed_map(spec) == ECCENTRICITIES:
        value = getattr(spec.eccentricities, field)
    return value


def _free(key: Key, start: float, limits: tuple[float, float] | None) -> FreeKey:
    # A key without a default is a union with None, inside of which the annotation stands.
    parts = [part for kind in (key.kind, *get_args(key.kind)) for part in get_args(kind)]
    meta = next(part for part in parts if isinstance(part, Meta))
    positive = meta.gt is not None and meta.gt >= 0
    low, high = float(meta.gt if meta.ge is None else meta.ge), float(meta.le)  # type: ignore[arg-type]
    if limits is not None:
        first, last = limits
        inside = (low < first if positive else low <= first) and last <= high
        if not (inside and first <= start <= last and first < last):
            raise ValueError(
                f"Argument `limits` of `{key.name}` must be a range around its value {start:g}"
                f" within {low:g} … {high:g}, but is {first:g} … {last:g}."
            )
        low, high = float(first), float(last)
    elif positive:
        low, high = max(low, start / REACH), min(high, start * REACH)
    return FreeKey(name=key.name, unit=key.unit, start=start, low=low, high=high, positive=positive)
