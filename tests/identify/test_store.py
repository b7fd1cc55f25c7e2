"""A fit on disk and back."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from vttig_jax.base import InputError, UsageError
from vttig_jax.base.files.json_io import dumps
from vttig_jax.identify import Fit, backlash_map, fit, read_fit
from vttig_jax.identify.archive import arrays_digest, fit_arrays


def _write(result: Fit, folder: Path, without: str = "") -> None:
    arrays = {name: array for name, array in fit_arrays(result).items() if name != without}
    record = result.to_json() | {"arrays": arrays_digest(arrays)}
    (folder / "fit.json").write_text(dumps(record), encoding="utf-8")
    np.savez(folder / "summary.npz", allow_pickle=False, **arrays)


@pytest.mark.parametrize("flank", [None, "A"])
def test_round_trip(noisy_log, noisy_rig, noisy_fit, flank, tmp_path):
    result = fit(noisy_log, noisy_rig.pair, flank=flank) if flank else noisy_fit
    _write(result, tmp_path)
    again = read_fit(tmp_path, noisy_rig.pair)
    assert again.to_json() == result.to_json() and str(again) == str(result)
    assert again.parameters == result.parameters and again.orders == result.orders
    assert again.model.terms == result.model.terms
    assert again.covariance_names == result.covariance_names
    assert [one.flank for one in again.curves] == [one.flank for one in result.curves]
    for one, other in zip(numbers(result), numbers(again), strict=True):
        np.testing.assert_array_equal(one, other)
    grid = np.linspace(0, 30, 50)
    maps = [backlash_map(f, constant_backlash_deg=0.04).over(grid) for f in (result, again)]
    np.testing.assert_array_equal(maps[0], maps[1])
    assert all(array.dtype != object for array in fit_arrays(result).values())  # no pickle


def numbers(result: Fit) -> list[np.ndarray]:
    """All arrays of a fit."""
    found = [*jax.tree.leaves(result.model), result.covariance, result.values, *result.residuals]
    for one in result.curves:
        found += [one.driving_angle, one.transmission_error, one.time]
    return [np.asarray(one) for one in found]


def test_missing_files_are_named(noisy_fit, noisy_rig, tmp_path):
    _write(noisy_fit, tmp_path)
    (tmp_path / "fit.json").unlink()
    with pytest.raises(UsageError, match=r"fit\.json") as caught:
        read_fit(tmp_path, noisy_rig.pair)
    assert caught.value.where == str(tmp_path)
    with pytest.raises(UsageError, match=r"fit\.json and summary\.npz missing"):
        read_fit(tmp_path / "nowhere", noisy_rig.pair)


@pytest.mark.parametrize("damage", ["text", "field", "archive", "array"])
def test_a_damaged_fit_is_one_sentence(noisy_fit, noisy_rig, tmp_path, damage):
    _write(noisy_fit, tmp_path, without="cosine" if damage == "array" else "")
    record, archive = tmp_path / "fit.json", tmp_path / "summary.npz"
    if damage == "text":
        record.write_text(record.read_text(encoding="utf-8")[:500], encoding="utf-8")
    elif damage == "field":
        content = json.loads(record.read_text(encoding="utf-8"))
        del content["parameters"]["delay_s"]["unit"]
        record.write_text(json.dumps(content), encoding="utf-8")
    elif damage == "archive":
        archive.write_bytes(archive.read_bytes()[:200])
    with pytest.raises(InputError, match="is damaged") as caught:
        read_fit(tmp_path, noisy_rig.pair)
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value)
