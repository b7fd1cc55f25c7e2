"""Scenario file with every default value, as `vttig simulate --print-defaults` prints it."""

from typing import Literal, get_args, get_origin

import tomli_w

from ...base.files.toml_io import Key, keys
from .spec import ScenarioSpec

_HEAD = """\
# Every key of a scenario: its default, its [unit] ([1]: a pure number) and its meaning.
# A key after # has no default; a key marked "required" must be given. The values of
# both are examples: the rig of the paper (its Table 2).
"""
_SWEEP = """\
# Only in a sweep file: [sweep] names keys of a scenario by their dotted names, slowest first.
# Each has { from, to, num } with both ends or a list of values; keys in zip advance together.
# [sweep]
# "motion.reversal_deg" = { from = 360, to = 5760, num = 1000 }
# controller = ["none", "acceleration", "predictive"]
# "motion.speed_rpm" = [30.0, 60.0]
# "motion.ramp_s" = [1.0, 0.5]
# zip = [["motion.speed_rpm", "motion.ramp_s"]]
"""
_LAST_TABLES = ("rig", "sweep")


def default_toml() -> str:
    """Return a scenario file with the default, unit and meaning of every key.

    The text is valid TOML. If the keys marked as required are uncommented, it is a complete
    scenario. The table [rig], which replaces [eccentricities], and the table [sweep] of a sweep
    file follow as comments at the end.

    **Example**
    ```python
    >>> from vttig_jax.control.scenario.defaults import default_toml
    >>> print(default_toml().splitlines()[4])
    plant = "rigid"              # play | rigid | elastic: model of the driven shaft and the contact

    ```
    """
    top = list(keys(ScenarioSpec))
    parts = [_HEAD + _lines([entry for entry in top if entry.table is None])]
    for entry in top:
        if entry.table is not None and entry.name not in _LAST_TABLES:
            header = f"[{entry.name}]  # {entry.meaning}\n"
            parts.append(header + _lines(list(keys(entry.table))))
    rig = next(entry for entry in top if entry.name == "rig")
    assert rig.table is not None
    header = f"# Instead of [eccentricities]: {rig.meaning}.\n# [rig]\n"
    parts.append(header + _lines(list(keys(rig.table)), hidden=True))
    return "\n".join([*parts, _SWEEP])


def _lines(table: list[Key], hidden: bool = False) -> str:
    """Return one line of TOML per key with aligned comments.

    If `hidden`, all keys are commented out; otherwise only those without a default.
    """
    starts = []
    for entry in table:
        absent = entry.required or entry.default is None
        value = entry.examples[0] if absent else entry.default
        hide = "# " if absent or hidden else ""
        starts.append(hide + tomli_w.dumps({entry.name.rpartition(".")[2]: value}).strip())
    width = max(map(len, starts))
    return "".join(
        f"{start:{width}}  # {_comment(key)}\n" for start, key in zip(starts, table, strict=True)
    )


def _comment(entry: Key) -> str:
    literals = [kind for kind in entry.types if get_origin(kind) is Literal]
    choices = [choice for kind in literals for choice in get_args(kind)]
    parts = [
        "required: " * entry.required,
        f"[{entry.unit}] " * bool(entry.unit),
        " | ".join(choices) + ": " * bool(choices),
        entry.meaning,
    ]
    return "".join(parts)
