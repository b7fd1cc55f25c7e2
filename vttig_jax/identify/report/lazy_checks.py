"""Checks of a fit by name, the costly ones carried out when they are first read."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any


class Checks(Mapping[str, Any]):
    """What is known beside the parameters, by name, ready for JSON.

    Nothing else in a fit depends on the `later` ones. They keep the block rows of the logs in
    memory until all of them have been read; a report and a run folder read them all.

    **Arguments**
    - `known`: checks that are there already. - `later`: functions that carry out the others.

    **Example**
    ```python
    >>> from vttig_jax.identify import Checks
    >>> checks = Checks({"solver_steps": 7}, {"lines": lambda: []})
    >>> list(checks), checks["lines"]
    (['solver_steps', 'lines'], [])

    ```
    """

    def __init__(
        self, known: Mapping[str, Any], later: Mapping[str, Callable[[], Any]] | None = None
    ) -> None:
        self._names = (*known, *(later or {}))
        self._known = dict(known)
        self._later = dict(later or {})

    def __getitem__(self, name: str) -> Any:
        if name in self._later:
            self._known[name] = self._later[name]()
            del self._later[name]
        return self._known[name]

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"Checks({', '.join(self._names)})"
