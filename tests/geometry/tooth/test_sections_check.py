"""Gears that have no tooth surface are refused with one sentence and a cure."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.geometry.surface_teeth import tooth
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.checks import check_tooth
from vttig_jax.geometry.tooth import Taper


def test_thin_end_names_the_section():
    steep = Taper(math.tan(math.radians(12.0)))
    with pytest.raises(PairError) as caught:
        check_tooth(tooth(recession=(steep, steep)))
    assert str(caught.value) == (
        "thickness: the tooth is -1.110 mm thick on the reference circle at z = 10 mm; make the"
        " face narrower (the tooth vanishes at z = 7.5 mm), the helix angles smaller or the"
        " profile shift larger."
    )
    check_tooth(tooth(recession=(steep, steep)), [-10.0, 7.0])


def test_recessions_that_are_none():
    for recession in (
        Taper(math.nan),
        lambda z: 1 / z,
        lambda z: 0.1,
        lambda z: np.sin(z),
        lambda z: z if z[0] > 0 else -z,
    ):
        with np.errstate(divide="ignore"), pytest.raises(PairError) as caught:
            check_tooth(tooth(recession=(recession, Taper(0.0))))
        assert caught.value.where == "recession of the left flank"
        assert caught.value.exit_code == 3


def test_numbers_that_are_no_gear():
    for changes, where in (
        ({"module_mm": 0.0}, "module_mm"),
        ({"module_mm": math.nan}, "module_mm"),
        ({"pressure_angles_deg": np.array([20.0, 95.0])}, "pressure_angles_deg"),
        ({"addendum_mm": -1.0}, "addendum_mm"),
        ({"dedendum_mm": math.inf}, "dedendum_mm"),
        ({"fillet_radius_mm": -0.1}, "fillet_radius_mm"),
        ({"fillet_radius_mm": math.nan}, "fillet_radius_mm"),
        ({"dedendum_mm": 46.0}, "root radius"),
        ({"profile_shift_mm": -5.0}, "tip radius"),
    ):
        changes = {key: np.asarray(value, float) for key, value in changes.items()}
        with pytest.raises(PairError) as caught:
            check_tooth(replace(tooth(), **changes))
        assert caught.value.where == where
