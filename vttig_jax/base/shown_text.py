r"""Text for people: control characters of foreign names are shown, and long names are cut.

Names of pairs, files and columns can hold any characters. A terminal obeys control characters in
them, and characters that change the direction of text make a name look like another one. Here they
become visible escapes such as `\x1b`. Everything that the command line prints passes `one_line` or
`lines`; names in tables, titles and pictures pass `shown_name`.
"""

import re
import unicodedata

MOST = 200
"""Characters that are shown of one foreign name; chosen value."""

_FORMULA = ("=", "+", "-", "@")
_QUOTE = re.compile("`([^`]*)`")
_LONG_WORD = re.compile(rf"[^\s`]{{{MOST + 1},}}")


def shown_name(name: object, most: int = MOST) -> str:
    r"""Return a foreign name in one line of at most `most` characters, with visible escapes.

    **Example**
    ```python
    >>> from vttig_jax.base.shown_text import shown_name
    >>> print(shown_name("rig\x1b[31m"), shown_name("n" * 1000, most=8))
    rig\x1b[31m nnnnnnn…

    ```
    """
    return _cut(escaped(str(name)[: most + 1]), most)


def name_of_file(path: object) -> str:
    r"""Return the name of a file as UTF-8 can hold it.

    Bytes of a name that are no UTF-8 become escapes such as `\udcff`.
    """
    return str(path).encode("utf-8", "backslashreplace").decode()


def one_line(text: str) -> str:
    """Return a sentence as one line: no control character in it, and no word or quote too long."""
    return _shortened(escaped(text))


def lines(text: str) -> str:
    """Return a text of several lines, each as `one_line` returns it."""
    if text.isascii() and text.replace("\n", "").isprintable() and len(text) <= MOST:
        return text
    return "\n".join(one_line(line) for line in text.split("\n"))


def escaped(text: str) -> str:
    """Return a text with a visible escape in place of every character that is not visible.

    These are control and format characters (also those of direction), separators of lines, lone
    surrogates and characters that are not assigned. Spaces of all kinds stay.
    """
    if text.isprintable():
        return text
    return "".join(
        mark
        if mark.isprintable() or unicodedata.category(mark) == "Zs"
        else mark.encode("unicode_escape").decode("ascii")
        for mark in text
    )


def csv_cell(text: str) -> str:
    r"""Return a foreign text as a cell of CSV: with visible escapes, and never a formula.

    Spreadsheets compute a cell that begins with `=`, `+`, `-` or `@`; an apostrophe in front makes
    it a text.

    **Example**
    ```python
    >>> from vttig_jax.base.shown_text import csv_cell
    >>> print(csv_cell("=1+1"), csv_cell("a=1\n"))
    '=1+1 a=1\n

    ```
    """
    shown = escaped(text)
    return f"'{shown}" if shown.startswith(_FORMULA) else shown


def _shortened(text: str) -> str:
    if len(text) <= MOST:
        return text
    text = _QUOTE.sub(lambda found: f"`{_cut(found[1], MOST)}`", text)
    return _LONG_WORD.sub(lambda found: _cut(found[0], MOST), text)


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
