"""Both flanks as the encoders see them, also where one was measured and the zeros lie anywhere."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from tests.identify.quick import quick_rig
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.backlash import backlash_map, contact_map
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.model.parameter import Parameter
from vttig_jax.pair.gear_pair import pair_from_spec, spec_of

ANGLES = np.linspace(0.0, 16 * REV, 500)
GAP_DEG = 0.038


@pytest.fixture(scope="module")
def fits():
    """Fits of one run with the driven encoder mounted at an angle: (flank, counts) → fit."""
    rig = quick_rig(3)
    log = rig.log(3)
    assert log.driven is not None
    spec = spec_of(rig.pair)
    layout = msgspec.structs.replace(spec.log, zero="reading")
    pair = pair_from_spec(msgspec.structs.replace(spec, log=layout))
    found = {}
    for flank, counts in ((None, 0), ("A", 0), ("A", 3_000), ("B", 3_000), (None, 3_000)):
        mounted = EncoderLog.from_arrays(
            log.time, log.driving.reading, log.driven.reading + counts, pair=pair
        )
        alone = {} if flank is None else {"flank": flank, "perfect_encoders": True}
        found[flank, counts] = fit(mounted, pair, **alone)
    return found


def flanks(fitted, **options):
    grid, contact = contact_map(fitted, **options)
    errors = [np.asarray(contact.transmission_error(ANGLES, flank)) for flank in ("A", "B")]
    return grid, errors


def test_both_flanks_are_the_model_of_the_map(fits):
    grid, (lower, upper) = flanks(fits[None, 0])
    np.testing.assert_allclose(upper - lower, grid.over(ANGLES), atol=1e-12)
    np.testing.assert_array_equal(grid.over(ANGLES), backlash_map(fits[None, 0]).over(ANGLES))


def test_one_flank_is_that_of_both_and_the_other_a_gap_away(fits):
    _, both = flanks(fits[None, 3_000])
    for place, flank in enumerate("AB"):
        grid, one = flanks(fits[flank, 3_000], constant_backlash_deg=GAP_DEG)
        np.testing.assert_allclose(one[place], both[place], atol=0.004 * DEG)
        np.testing.assert_allclose(one[1] - one[0], grid.over(ANGLES), atol=1e-12)
        assert np.median(one[place]) == pytest.approx(3_000 / 90_000 * REV, abs=0.1 * DEG)


def test_where_the_driven_encoder_reads_zero_changes_no_gap(fits):
    plain, _ = flanks(fits["A", 0], constant_backlash_deg=GAP_DEG)
    mounted, _ = flanks(fits["A", 3_000], constant_backlash_deg=GAP_DEG)
    np.testing.assert_allclose(mounted.over(ANGLES), plain.over(ANGLES), atol=1e-5 * DEG)
    by_formula = backlash_map(fits["A", 0], constant_backlash_deg=GAP_DEG)
    np.testing.assert_allclose(plain.over(ANGLES), by_formula.over(ANGLES), atol=5e-5 * DEG)


def test_no_constant_backlash_and_shafts_that_slip_are_no_answer(fits):
    with pytest.raises(NoAnswerError, match="--constant-backlash-deg"):
        contact_map(fits["A", 0])
    ratio = Parameter("ratio", "1", 0.5631, 1e-6, 0.563, 0.5632, determined=True, significant=True)
    with pytest.raises(NoAnswerError, match=r"turn at 0\.5631 and not at 9/16"):
        contact_map(replace(fits[None, 0], regressors=(ratio,)))
    steady = Parameter("ratio", "1", 0.5625, 1e-6, determined=True)
    contact_map(replace(fits[None, 0], regressors=(steady,)))
