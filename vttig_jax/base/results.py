"""What all results have in common: a picture, and a view of their text in a notebook."""

from html import escape
from typing import Any

from .facade import from_front_door


class TextResult:
    """A result whose `str` is a report; notebooks show it as preformatted text."""

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


class PlottedResult(TextResult):
    """A result with a report and a picture."""

    def plot(self, *name: str, **options: Any) -> Any:
        """Draw this result and return the matplotlib figure; see `vttig_jax.plot`."""
        return from_front_door("plot")(self, *name, **options)
