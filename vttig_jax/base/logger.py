"""The logger of the package, whose records hold text that any handler can write."""

import logging

from .shown_text import one_line


class _Printable(logging.Filter):
    """Shows control characters and lone surrogates of foreign names by visible escapes.

    Handlers of other programs get the records too, and a lone surrogate is no text in UTF-8.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        record.msg, record.args = one_line(record.getMessage()), None
        return True


LOGGER = logging.getLogger("vttig_jax")
LOGGER.addFilter(_Printable())
