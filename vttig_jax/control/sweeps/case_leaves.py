"""Structure and numbers of cases: what a compiled program depends on, and what it is given."""

from dataclasses import fields
from typing import Any, NamedTuple

import jax
import numpy as np

from ..simulation.build import CaseParts
from ..simulation.case import Case
from ..simulation.simulate import periods_of

_MOST_PARTS = 1 << 16
"""Number of parts whose numbers are kept: a chosen value."""


class CaseStructure(NamedTuple):
    """Structure of cases that share one compiled program; it is hashable.

    - `tree`: tree with all static choices. - `shapes`: shapes of the numbers.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]


class CaseLeaves(NamedTuple):
    """Structure of one case, its numbers in the order of the tree, and the length of its run.

    - `periods`: periods of the controller in a run. - `substeps`: steps of the plant in a period.
    """

    structure: CaseStructure
    leaves: tuple[Any, ...]
    periods: int
    substeps: int


def leaves_of(case: Case) -> CaseLeaves:
    """Split a case into its structure and its numbers."""
    leaves, tree = _flat(case)
    structure = CaseStructure(tree, tuple(leaf.shape for leaf in leaves))
    return CaseLeaves(structure, leaves, periods_of(case), case.substeps)


def _flat(tree: Any) -> tuple[tuple[Any, ...], Any]:
    leaves, structure = jax.tree.flatten(tree)
    return tuple(x if isinstance(x, np.ndarray) else np.asarray(x) for x in leaves), structure


class _FlatPart(NamedTuple):
    """Numbers of a part and the number of its structure; `part` is kept so that its id stays."""

    part: Any
    leaves: tuple[Any, ...]
    structure: int


class LeafCache:
    """Leaves of cases from those of their parts, each of which is taken apart only once.

    The cases of a sweep share most of their parts, and making a `Case` of them costs more than all
    else that a case needs.
    """

    def __init__(self) -> None:
        self._parts: dict[int, _FlatPart] = {}
        self._numbers: dict[Any, int] = {}
        self._structures: dict[Any, CaseStructure] = {}

    def leaves_of(self, parts: CaseParts) -> CaseLeaves:
        """Return what `leaves_of` returns for the case of these parts."""
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
"""Parts with numbers, in the order of the leaves of a case."""
