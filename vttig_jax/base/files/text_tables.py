"""Plain text tables for `__str__` and the command line, with two spaces between columns."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

from ..shown_text import one_line, shown_name

_ALIGNMENTS = {"l": "left", "r": "right", "c": "center"}


def text_table(
    rows: Iterable[Sequence[Any]],
    headers: Sequence[str | tuple[str, str]],
    *,
    align: str | None = None,
) -> str:
    """Format rows under headers.

    **Arguments**
    - `rows`: contents of the cells; None is printed as "–".
    - `headers`: text, or (text, unit), which is printed as "text [unit]".
    - `align`: one letter (`l`, `r` or `c`) for each column; by default the first column is aligned
      left and the others right.

    **Example**
    ```python
    >>> from vttig_jax.base import text_table
    >>> print(text_table([("driving", "0.0226"), ("driven", None)], ["gear", ("e", "mm")]))
    gear     e [mm]
    driving  0.0226
    driven        –

    ```
    """
    letters = "l" + "r" * (len(headers) - 1) if align is None else align
    if len(letters) != len(headers) or not set(letters) <= set(_ALIGNMENTS):
        raise ValueError(
            f"Argument `align` must have one letter of l, r, c for each of the {len(headers)}"
            f" headers, but it is {align!r}."
        )
    titles = [
        one_line(name if isinstance(name, str) else f"{name[0]} [{name[1]}]") for name in headers
    ]
    # The titles are the first row, because `tabulate` aligns its own headers differently.
    cells = [titles, *([_cell(value) for value in row] for row in rows)]
    return _plain(cells, colalign=[_ALIGNMENTS[letter] for letter in letters])


def key_values(pairs: Iterable[tuple[str, Any]], *, title: str | None = None) -> str:
    """Format one name and value per line, indented below `title` if it is given.

    **Example**
    ```python
    >>> from vttig_jax.base.files.text_tables import key_values
    >>> print(key_values([("teeth", "45 / 80"), ("module", "2 mm")], title="gear pair"))
    gear pair
      teeth   45 / 80
      module  2 mm

    ```
    """
    table = _plain([(_cell(name), _cell(value)) for name, value in pairs])
    if title is None:
        return table
    return "\n".join([shown_name(title), *(f"  {line}" for line in table.splitlines())])


def listed(title: str, sentences: Sequence[str]) -> list[str]:
    """Return a list with one text: the title and below it the sentences, one per line.

    The list is empty if there are no sentences.
    """
    rows = [f"  {one_line(sentence)}" for sentence in sentences]
    return ["\n".join([f"{title}:", *rows])] if rows else []


def _cell(value: Any) -> str:
    return "–" if value is None else one_line(str(value))


def _plain(cells: Sequence[Sequence[str]], **options: Any) -> str:
    from tabulate import tabulate

    table = tabulate(cells, tablefmt="plain", disable_numparse=True, **options)
    return "\n".join(line.rstrip() for line in table.splitlines())


def decimals(std: float, value: float) -> int:
    """Return the number of decimals for two digits of `std`, or for eight of `value` if it is 0.

    **Example**
    ```python
    >>> from vttig_jax.base.files.text_tables import decimals
    >>> decimals(0.0123, 1.5), decimals(0.0, 250.0), decimals(0.0, 0.0)
    (3, 5, 3)

    ```
    """
    size = std if std > 0 else abs(value) * 1e-6
    return 3 if size == 0 else min(max(1 - math.floor(math.log10(size)), 0), 12)
