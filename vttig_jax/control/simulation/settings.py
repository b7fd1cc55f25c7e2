"""Change of controller settings in a case that is already built."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from ..fields import number_fields

_Owner = TypeVar("_Owner")


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
    >>> float(case.controller.margin_mm)
    0.02

    ```
    """
    for name, value in settings.items():
        field = name.removeprefix("judgement.")
        for place in ("observer", "controller"):
            part = getattr(owner, place)
            if field != name and field in {one.name for one in number_fields(part)}:
                changed = {place: replace(part, **{field: value})}
                owner = replace(owner, **changed)  # type: ignore[type-var]
                break
        else:
            raise ValueError(
                f"Argument `settings` must have keys that the case uses, but neither"
                f" {type(owner.observer).__name__} nor {type(owner.controller).__name__} has"  # type: ignore[attr-defined]
                f" {name!r}."
            )
    return owner
