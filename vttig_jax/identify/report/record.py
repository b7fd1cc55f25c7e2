"""Typed records of a fit, and sequences of records that are computed when they are first read."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import msgspec

Item = TypeVar("Item")


class Record(msgspec.Struct, frozen=True):
    """Immutable record whose fields are the keys of its JSON object, in the same order."""

    def to_json(self) -> dict:
        """Return the JSON object of the record; numbers that are not finite become None."""
        return msgspec.json.decode(msgspec.json.encode(self, enc_hook=lambda value: value.tolist()))


class Later(Sequence[Item]):
    """Sequence that is computed when it is first read.

    After the computation the function is deleted, which frees the data that it refers to.

    **Arguments**
    - `compute`: function that returns the items.

    **Example**
    ```python
    >>> from vttig_jax.identify.report.record import Later
    >>> cycles = Later(lambda: [3.09, 9.41])
    >>> len(cycles), cycles[0]
    (2, 3.09)

    ```
    """

    def __init__(self, compute: Callable[[], Sequence[Item]]) -> None:
        self._compute: Callable[[], Sequence[Item]] | None = compute
        self._items: list[Item] = []

    def tolist(self) -> list[Item]:
        """Return the items."""
        if self._compute is not None:
            self._items, self._compute = list(self._compute()), None
        return self._items

    def __getitem__(self, index: Any) -> Any:
        return self.tolist()[index]

    def __len__(self) -> int:
        return len(self.tolist())
