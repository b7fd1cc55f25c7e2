import struct

import pytest

import vttig_jax
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.plotting.dispatch import plot
from vttig_jax.plotting.save import figures, png

NAMES = ["te_fit.png", "orders.png", "residual.png", "backlash_map.png"]


@pytest.fixture(scope="module")
def grid(make_fit, paper_pair) -> BacklashMap:
    return BacklashMap(make_fit().model, None, paper_pair)


@pytest.fixture(scope="module")
def drawn(make_fit, grid) -> dict[str, bytes]:
    return figures(make_fit(), grid)


def test_pictures_are_1200_pixels_wide(drawn):
    assert list(drawn) == NAMES
    for data in drawn.values():
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">I", data[16:20]) == (1200,)


def test_the_same_fit_gives_the_same_bytes(make_fit, grid, drawn):
    assert figures(make_fit(), grid) == drawn
    other = figures(make_fit(residual_arcsec=5.0), None)
    assert other["te_fit.png"] != drawn["te_fit.png"]
    assert other["orders.png"] == drawn["orders.png"]


def test_the_bytes_hold_no_date_and_no_version(make_curve):
    data = png(plot(make_curve("A")))
    assert b"vttig_jax" in data
    assert b"Matplotlib" not in data and b"tIME" not in data


def test_a_log_of_one_direction_has_no_map(worm_fit):
    assert list(figures(worm_fit, None)) == NAMES[:3]


def test_a_real_log_of_one_direction_can_be_drawn(data_dir, tmp_path):
    table = tmp_path / "worm.toml"
    table.write_text(
        '[drive]\nratio = "1/225"\n[log]\ndriving = "driving_deg"\n'
        'transmission_error = "transmission_error_arcsec"\n'
        "[fit]\ndriving_orders = [1, 2, 3]\ndriven_orders = []\n"
    )
    pair = vttig_jax.load_pair(table)
    log = vttig_jax.read_log(data_dir / "worm_mount" / "ap_gt1100.csv", pair)
    fit = vttig_jax.fit(log, pair)
    with pytest.raises(NoAnswerError):
        backlash_map(fit)
    assert list(figures(fit, None)) == NAMES[:3]
