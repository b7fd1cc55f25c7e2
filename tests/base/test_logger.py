import logging

import pytest

from vttig_jax.base.logger import LOGGER

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize(
    ("foreign", "shown"),
    [("a\x1b[31m", r"a\x1b[31m"), ("\udced\udcff", r"\udced\udcff"), ("two\nlines", r"two\nlines")],
)
def test_any_handler_can_write_a_record(caplog, foreign, shown):
    """Other loggers are untouched: their records hold the text as it came."""
    with caplog.at_level(logging.INFO):
        LOGGER.info("%s: read", foreign)
        logging.getLogger("other").info("%s: read", foreign)
    ours, other = (record.getMessage() for record in caplog.records)
    assert ours == f"{shown}: read" and ours.isprintable() and ours.encode("utf-8")
    assert other == f"{foreign}: read"
