import logging

import pytest

from vttig_jax.base.logger import LOGGER

pytestmark = pytest.mark.smoke


class Kept(logging.Handler):
    """Keeps the messages that it is given."""

    def __init__(self):
        super().__init__(logging.INFO)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


@pytest.mark.parametrize(
    ("foreign", "shown"),
    [
        pytest.param("a\x1b[31m", r"a\x1b[31m", id="escape"),
        pytest.param("\udced\udcff", r"\udced\udcff", id="surrogates"),
        pytest.param("two\nlines", r"two\nlines", id="lines"),
    ],
)
def test_any_handler_can_write_a_record(monkeypatch, foreign, shown):
    """Records of another logger, which has no such filter, hold the text as it came."""
    kept, other = Kept(), logging.Logger("other")
    other.addHandler(kept)
    monkeypatch.setattr(LOGGER, "handlers", [kept])
    for logger in (LOGGER, other):
        logger.error("%s: read", foreign)
    assert kept.messages == [f"{shown}: read", f"{foreign}: read"]
    assert kept.messages[0].isprintable() and kept.messages[0].encode("utf-8")
