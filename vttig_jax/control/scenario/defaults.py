"""What `vttig simulate --print-defaults` prints: a scenario file of nothing but defaults."""

from typing import Any, Literal, get_args, get_origin

import tomli_w

from ...base.files.toml_io import Key, keys
from .spec import ScenarioSpec

_HEAD = """\
# Every key of a scenario: its default, its [unit] ([1]: a pure number) and what it means.
# A key behind # has no default; where it says "required" it must be given. The values shown for
# these are an example: the rig of the paper (its Table 2).
"""
_SWEEP = """\
# Only in a sweep file: [sweep] holds keys of a scenario by their dotted names, first slowest.
# Each has { from, to, num }, ends included, or a list of values; those in zip go together.
# [sweep]
# "motion.reversal_deg" = { from = 360, to = 5760, num = 1000 }
# controller = ["none", "acceleration", "predictive"]
# "motion.speed_rpm" = [30.0, 60.0]
# "motion.ramp_s" = [1.0, 0.5]
# zip = [["motion.speed_rpm", "motion.ramp_s"]]
"""
_AT_THE_END = ("rig", "sweep")


def default_toml() -> str:
    """A scenario file with every key, its default, unit and meaning.

    It is valid TOML; with the keys marked as required uncommented it is a whole scenario. What
    stands instead of [eccentricities] and what belongs to a sweep file follow at the end, behind #.

    **Example**
    ```python
    >>> from vttig_jax.control.scenario.defaults import default_toml
    >>> print(default_toml().splitlines()[4])
    plant = "rigid"              # play | rigid | elastic: what the driven shaft does inside the gap

    ```
    """
    top = list(keys(ScenarioSpec))
    parts = [_HEAD + _lines([one for one in top if one.table is None])]
    for one in top:
        if one.table is not None and one.name not in _AT_THE_END:
            header = f"[{one.name}]  # {one.meaning}\n"
            parts.append(header + _lines(list(keys(one.table))))
    rig = next(one for one in top if one.name == "rig")
    assert rig.table is not None
    header = f"# Instead of [eccentricities]: {rig.meaning}.\n# [rig]\n"
    parts.append(header + _lines(list(keys(rig.table)), hidden=True))
    return "\n".join([*parts, _SWEEP])


def _lines(table: list[Key], hidden: bool = False) -> str:
    """One line a key, the comments below each other; `hidden` puts all keys behind #."""
    starts = []
    for one in table:
        absent = one.required or one.default is None
        value = one.examples[0] if absent else one.default
        hide = "# " if absent or hidden else ""
        starts.append(hide + tomli_w.dumps({one.name.rpartition(".")[2]: value}).strip())
    width = max(map(len, starts))
    return "".join(
        f"{start:{width}}  # {_comment(one)}\n" for start, one in zip(starts, table, strict=True)
    )


def _comment(one: Key) -> str:
    choices = [choice for kind in one.types for choice in _choices(kind)]
    parts = [
        "required: " * one.required,
        f"[{one.unit}] " * bool(one.unit),
        " | ".join(choices) + ": " * bool(choices),
        one.meaning,
    ]
    return "".join(parts)


def _choices(kind: Any) -> tuple[str, ...]:
    return get_args(kind) if get_origin(kind) is Literal else ()
