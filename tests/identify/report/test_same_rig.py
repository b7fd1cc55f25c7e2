"""When first orders of two logs contradict one rig: far in standard errors and in size."""

import re

import msgspec
import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.identify.report.checks import Disagreement
from vttig_jax.identify.report.comparisons.same_rig import refuse_different_rigs

pytestmark = pytest.mark.smoke

APART = Disagreement(
    log=2,
    shaft="driving",
    flank="B",
    first_arcsec=40.0,
    this_arcsec=24.0,
    difference_arcsec=16.0,
    std_arcsec=1.0,
)
"""Orders that differ by sixteen standard errors and by 40 % of the larger one."""


REFUSED = r"^second.csv: the driving shaft has a first order of .* on flank B.* in first.csv"


def _refusal(differences: list[Disagreement]) -> str:
    """The message of the refusal; empty if the logs are accepted."""
    try:
        refuse_different_rigs(differences, ["first.csv", "second.csv"])
    except LogError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({}, True),
        ({"std_arcsec": 2.0}, False),  # eight standard errors are not more than eight
        ({"std_arcsec": 1.9}, True),
        ({"std_arcsec": 3.0}, False),
        ({"first_arcsec": 80.0, "this_arcsec": 64.0}, False),  # 20 % are not more than 20 %
        ({"first_arcsec": 79.0, "this_arcsec": 63.0}, True),
        ({"first_arcsec": 63.0, "this_arcsec": 79.0}, True),
        ({"first_arcsec": 64.0, "this_arcsec": 90.0}, False),
    ],
)
def test_only_orders_far_apart_in_both_senses_are_refused(changes, refused):
    said = _refusal([msgspec.structs.replace(APART, **changes)])
    assert bool(re.match(REFUSED, said)) == refused == bool(said)


def test_logs_that_agree_are_of_one_rig():
    assert _refusal([]) == ""
