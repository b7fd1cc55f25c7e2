"""Structure and leaves of cases. A compiled program depends on the structure; the leaves, arrays of
numbers, are its inputs.
"""

from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import jax
import numpy as np

from ..simulation.case import Case
from ..simulation.simulate import periods_of

_FIELDS = tuple(one.name for one in fields(Case) if not one.metadata.get("static", False))
_MOST_PARTS = 1 << 16
"""Largest number of flattened parts that are remembered; a chosen value."""


class CaseStructure(NamedTuple):
    """Structure of cases that share one compiled program; it is hashable.

    - `parts`: structure of every field with numbers. - `substeps`, `noisy`: the static ones.
    """

    parts: tuple["_PartStructure", ...]
    substeps: int
    noisy: bool

    def case(self, leaves: tuple[Any, ...]) -> Case:
        """Return the case with these leaves."""
        rest = iter(leaves)
        parts = [
            jax.tree.unflatten(one.tree, [next(rest) for _ in one.shapes]) for one in self.parts
        ]
        named = dict(zip(_FIELDS, parts, strict=True))
        return Case(**named, substeps=self.substeps, noisy=self.noisy)


class CaseLeaves(NamedTuple):
    """Structure of one case, its leaves, and the number of controller periods in its run."""

    structure: CaseStructure
    leaves: tuple[Any, ...]
    periods: int


class _PartStructure:
    """Pytree structure of a part and shapes of its leaves; equal ones are one object."""

    def __init__(self, tree: Any, shapes: tuple[tuple[int, ...], ...]) -> None:
        self.tree, self.shapes = tree, shapes


_structure = lru_cache(None)(_PartStructure)


def leaves_of(case: Case | Mapping[str, Any], known: dict[int, Any] | None = None) -> CaseLeaves:
    """Return the structure and the leaves of a case, or of its fields by name.

    `known` remembers the flattened parts of other cases by their `id`, and the parts themselves so
    that no `id` is used again: many cases of a sweep have the same parts.
    """
    given, known = vars(case) if isinstance(case, Case) else case, {} if known is None else known
    parts = [given[name] for name in _FIELDS]
    flat = [known.get(id(part)) or _flattened(part, known) for part in parts]
    leaves = tuple(chain.from_iterable(one[1] for one in flat))
    structure = CaseStructure(tuple(one[2] for one in flat), given["substeps"], given["noisy"])
    return CaseLeaves(structure, leaves, periods_of(given["motion"], given["period"]))


def _flattened(part: Any, known: dict[int, Any]) -> tuple[Any, tuple[Any, ...], _PartStructure]:
    leaves, tree = jax.tree.flatten(part)
    arrays = np.ndarray, jax.Array  # an array of JAX, such as a large table, is not copied
    leaves = tuple(x if isinstance(x, arrays) else np.asarray(x) for x in leaves)
    if len(known) >= _MOST_PARTS:
        known.clear()
    shapes = tuple(leaf.shape for leaf in leaves)
    known[id(part)] = found = part, leaves, _structure(tree, shapes)
    return found
