"""A row of the table of laws, and how the lengths inside its arguments are found."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax

POWER = {"rad": 0, "1": 0, "mm": 1, "1/mm": -1}
"""Power of the length scale by unit."""

MODEL_LENGTHS = {"centre_distance", "base_sum", "driving_offset", "driven_offset"}
"""Fields in mm whose names do not end with `_mm`."""


@dataclass(frozen=True)
class Law:
    """`function(*arguments)` covers `covers`; `kinks` are further arguments to stand on.

    The laws of a `slow` function take so long to compile that only `-m slow` tests them.
    """

    covers: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    unit: str
    kinks: dict[str, tuple[Any, ...]]
    variant: str = ""
    first_is_length: bool = False
    slow: bool = False

    def __str__(self) -> str:
        return f"{self.covers}-{self.variant}" if self.variant else self.covers

    def scale(self, arguments: tuple[Any, ...], factor: float) -> tuple[Any, ...]:
        """Multiply every length among the arguments by `factor`."""
        first, *others = arguments
        return (first * factor if self.first_is_length else first, *scaled(others, factor))


def scaled(tree: Any, factor: float) -> Any:
    """Multiply the leaves that are lengths by their field names."""

    def one(path, leaf):
        name = getattr(path[-1], "name", "")
        return leaf * factor if name.endswith("_mm") or name in MODEL_LENGTHS else leaf

    return jax.tree_util.tree_map_with_path(one, tree)
