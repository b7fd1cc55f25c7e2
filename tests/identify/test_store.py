"""A fit on disk and back."""

import json
import re

import jax
import numpy as np
import pytest

from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.base.files.json_io import dumps
from vttig_jax.identify.archive import arrays_digest, fit_arrays, read_fit
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit


def _write(result: Fit, folder) -> None:
    arrays = fit_arrays(result)
    record = result.to_json() | {"arrays": arrays_digest(arrays)}
    (folder / "fit.json").write_text(dumps(record), encoding="utf-8")
    _write_arrays(arrays, folder)


def _write_arrays(arrays: dict[str, np.ndarray], folder) -> None:
    np.savez(folder / "summary.npz", allow_pickle=False, **arrays)


@pytest.mark.parametrize("flank", [None, "A"])
def test_round_trip(noisy_log, noisy_rig, flank, tmp_path):
    result = fit(noisy_log, noisy_rig.pair, flank=flank)
    _write(result, tmp_path)
    again = read_fit(tmp_path, noisy_rig.pair)
    assert again.to_json() == result.to_json()
    assert str(again) == str(result)
    assert again.parameters == result.parameters
    assert again.orders == result.orders
    assert again.model.terms == result.model.terms
    before, after = jax.tree.leaves(result.model), jax.tree.leaves(again.model)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    for name in ("covariance", "values"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.covariance_names == result.covariance_names
    for one, other in zip(result.curves, again.curves, strict=True):
        assert one.flank == other.flank
        for name in ("driving_angle", "transmission_error", "time"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for one, other in zip(result.residuals, again.residuals, strict=True):
        np.testing.assert_array_equal(one, other)
    grid = np.linspace(0, 30, 50)
    maps = [backlash_map(f, constant_backlash_deg=0.04).over(grid) for f in (result, again)]
    np.testing.assert_array_equal(maps[0], maps[1])


def test_no_pickle_is_written(noisy_fit):
    assert all(array.dtype != object for array in fit_arrays(noisy_fit).values())


@pytest.mark.parametrize("name", ["fit.json"])
def test_a_missing_file_is_named(noisy_fit, noisy_rig, tmp_path, name):
    _write(noisy_fit, tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(UsageError, match=re.escape(name)) as caught:
        read_fit(tmp_path, noisy_rig.pair)
    assert caught.value.where == str(tmp_path)


def test_a_folder_that_is_not_there(noisy_rig, tmp_path):
    with pytest.raises(UsageError, match=r"fit\.json and summary\.npz missing"):
        read_fit(tmp_path / "nowhere", noisy_rig.pair)


@pytest.mark.parametrize("damage", ["text", "field", "archive", "array"])
def test_a_damaged_fit_is_one_sentence(noisy_fit, noisy_rig, tmp_path, damage):
    _write(noisy_fit, tmp_path)
    record, archive = tmp_path / "fit.json", tmp_path / "summary.npz"
    if damage == "text":
        record.write_text(record.read_text(encoding="utf-8")[:500], encoding="utf-8")
    elif damage == "field":
        content = json.loads(record.read_text(encoding="utf-8"))
        del content["parameters"]["delay_s"]["unit"]
        record.write_text(json.dumps(content), encoding="utf-8")
    elif damage == "archive":
        archive.write_bytes(archive.read_bytes()[:200])
    else:
        arrays = fit_arrays(noisy_fit)
        del arrays["cosine"]
        _write_arrays(arrays, tmp_path)
    with pytest.raises(InputError, match="is damaged") as caught:
        read_fit(tmp_path, noisy_rig.pair)
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value)
