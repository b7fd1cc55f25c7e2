"""Change of controller settings in a case that is already built."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

from ...base.units import REV
from ..controllers.smooth import SmoothAccelerationController, SmoothPredictiveController

_Owner = TypeVar("_Owner")

_FIELDS = {
    "judgement.bandwidth_hz": ("observer", "bandwidth_hz", 1.0),
    "judgement.threshold_rad_s2": ("controller", "threshold", 1.0),
    "judgement.least_rpm": ("controller", "least_speed", REV / 60.0),
    "judgement.horizon_s": ("controller", "horizon", 1.0),
    "judgement.margin_mm": ("controller", "margin", 1.0),
}
"""Dotted key → part of a case or window, its field for the key, and factor from key to field."""


def with_settings(owner: _Owner, settings: Mapping[str, Any]) -> _Owner:
    """Return a case, or a window of tuning, with new values for some keys of [judgement].

    JAX may trace the values, so derivatives with respect to them work. They are not checked.

    **Arguments**
    - `owner`: case, or window (the part of a run around the turn, which `tune` simulates).
    - `settings`: dotted key → value in the unit of the key.

    **Raises** `ValueError` for a key that the controller of the case does not use.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import build_case, parse_scenario_spec, with_settings
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> spec = parse_scenario_spec({"pair": "pair.toml", "eccentricities": rig})
    >>> case = with_settings(build_case(spec, paper_pair()), {"judgement.margin_mm": 0.02})
    >>> float(case.controller.margin)
    0.02

    ```
    """
    for name, value in settings.items():
        if name not in _FIELDS:
            raise ValueError(
                f"Argument `settings` must have keys among {', '.join(_FIELDS)}, but has {name!r}."
            )
        part, field, factor = _FIELDS[name]
        changed = _changed(getattr(owner, part), field, value * factor, name)
        owner = replace(owner, **{part: changed})  # type: ignore[type-var]
    return owner


def _changed(part: Any, field: str, value: Any, name: str) -> Any:
    if isinstance(part, (SmoothAccelerationController, SmoothPredictiveController)):
        return replace(part, hard=_changed(part.hard, field, value, name))
    if field not in {one.name for one in fields(part)}:
        raise ValueError(
            f"Argument `settings` must have keys that the case uses, but its"
            f" {type(part).__name__} has no {name!r}."
        )
    return replace(part, **{field: value})
