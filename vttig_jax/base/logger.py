"""The logger of the package, whose records hold text that any handler can write."""

import logging

from .shown_text import one_line


class _Printable(logging.Filter):
    """Replaces control characters and lone surrogates in messages by visible escapes.

    Handlers of other programs get the records too, and UTF-8 cannot encode a lone surrogate.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        record.msg, record.args = one_line(record.getMessage()), None
        return True


LOGGER = logging.getLogger("vttig_jax")
LOGGER.addFilter(_Printable())
