"""Checks of a fit by name; expensive checks are computed when they are first read."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any


class Checks(Mapping[str, Any]):
    """Checks of a fit by name, in the form of its JSON object.

    No other part of a fit depends on the `later` checks. They keep the block rows of the logs in
    memory until all of them have been read. A report and a run folder read all of them.

    **Arguments**
    - `known`: computed checks. - `later`: functions that compute the other checks.

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
