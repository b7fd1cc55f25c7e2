"""Structure and leaves of cases. A compiled program depends on the structure; the leaves, arrays of
numbers, are its inputs.
"""

from dataclasses import fields
from typing import Any, NamedTuple

import jax
import numpy as np

from ..simulation.build import CaseParts
from ..simulation.case import Case
from ..simulation.simulate import periods_of

_MOST_PARTS = 1 << 16
"""Largest number of parts of cases whose leaves are cached; a chosen value."""


class CaseStructure(NamedTuple):
    """Structure of cases that share one compiled program; it is hashable.

    - `tree`: pytree structure with all static choices. - `shapes`: shapes of the leaves.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]


class CaseLeaves(NamedTuple):
    """Structure of one case, its leaves in the order of the pytree, and the length of its run.

    - `periods`: periods of the controller in a run. - `substeps`: steps of the plant in a period.
    """

    structure: CaseStructure
    leaves: tuple[Any, ...]
    periods: int
    substeps: int


def leaves_of(case: Case) -> CaseLeaves:
    """Return the structure and the leaves of a case."""
    leaves, tree = _flat(case)
    structure = CaseStructure(tree, tuple(leaf.shape for leaf in leaves))
    return CaseLeaves(structure, leaves, periods_of(case), case.substeps)


def _flat(tree: Any) -> tuple[tuple[Any, ...], Any]:
    leaves, structure = jax.tree.flatten(tree)
    arrays = np.ndarray, jax.Array  # an array of JAX, such as a large table, is not copied
    return tuple(x if isinstance(x, arrays) else np.asarray(x) for x in leaves), structure


class _FlatPart(NamedTuple):
    """Leaves of a part of a case, and a number that identifies its structure.

    `part` is stored so that its `id`, the key in the cache, is not reused.
    """

    part: Any
    leaves: tuple[Any, ...]
    structure: int


class LeafCache:
    """Cache that assembles the leaves of a case from the leaves of its parts.

    The cases of a sweep share most of their parts, and each part is flattened only once. Building a
    `Case` object for every case would take more time than everything else.
    """

    def __init__(self) -> None:
        self._parts: dict[int, _FlatPart] = {}
        self._numbers: dict[Any, int] = {}
        self._structures: dict[Any, CaseStructure] = {}

    def leaves_of(self, parts: CaseParts) -> CaseLeaves:
        """Return the same as the function `leaves_of` for the case with these parts."""
        flat = [self._flat_part(getattr(parts, name)) for name in _DYNAMIC]
        key = (*(part.structure for part in flat), parts.substeps, parts.noisy)
        structure = self._structures.get(key)
        if structure is None:
            structure = self._structures[key] = leaves_of(Case(**parts._asdict())).structure
        leaves = tuple(leaf for part in flat for leaf in part.leaves)
        return CaseLeaves(structure, leaves, periods_of(parts), parts.substeps)

    def _flat_part(self, part: Any) -> _FlatPart:
        known = self._parts.get(id(part))
        if known is None:
            leaves, tree = _flat(part)
            shapes = tree, tuple(leaf.shape for leaf in leaves)
            number = self._numbers.setdefault(shapes, len(self._numbers))
            if len(self._parts) >= _MOST_PARTS:
                self._parts.clear()
            known = self._parts[id(part)] = _FlatPart(part, leaves, number)
        return known


_DYNAMIC = tuple(
    field.name
    for field in fields(Case)
    if not field.metadata.get("static", False) and field.name in CaseParts._fields
)
"""Names of the fields of a case that hold numbers, in the order of its leaves."""
