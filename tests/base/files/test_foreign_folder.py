"""Folders into which a command writes results, and folders of others."""

import pytest

from vttig_jax.base.errors import UsageError
from vttig_jax.base.files.foreign_folder import RESULTS, refuse_foreign
from vttig_jax.cli.verbs.gears import contact
from vttig_jax.control.sweeps import store
from vttig_jax.runs import many_fits, posterior_run, run, run_file

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize("names", [[], [".DS_Store"], [".git"], [".lock"], [".posterior.h5.lock"]])
def test_a_new_and_an_empty_folder_pass(tmp_path, names):
    refuse_foreign(tmp_path / "new", overwrite=False)
    for name in names:
        (tmp_path / name).touch()
    refuse_foreign(tmp_path, overwrite=False)


@pytest.mark.parametrize(
    "names", [["fit.json", "notes.txt"], ["sweep.json", "parts"], [".new-a1b2", "summary.npz"]]
)
def test_folders_with_results_and_those_that_a_kill_left_pass(tmp_path, names):
    for name in names:
        (tmp_path / name).touch()
    refuse_foreign(tmp_path, overwrite=False)


def test_names_that_a_command_writes_are_refused_with_two_ways_out(tmp_path):
    for name in ("thesis.tex", "log.csv"):
        (tmp_path / name).touch()
    refuse_foreign(tmp_path, overwrite=False)
    for name in ("figures", "map.csv"):
        (tmp_path / name).touch()
    with pytest.raises(UsageError) as caught:
        refuse_foreign(tmp_path, overwrite=False)
    told = caught.value.message
    assert "this folder holds figures and map.csv, which the command writes" in told
    assert str(tmp_path / "run") in told and "--overwrite" in told
    refuse_foreign(tmp_path, overwrite=True)
    with pytest.raises(UsageError, match=r"holds log\.csv"):
        refuse_foreign(tmp_path, overwrite=False, written=("log.csv",))


def test_a_file_in_the_way_is_left_to_the_writer(tmp_path):
    (tmp_path / "out").touch()
    refuse_foreign(tmp_path / "out", overwrite=False)


def test_the_marks_are_the_names_that_the_writers_use():
    assert {
        run_file.CHECKPOINT,
        posterior_run.REPORT,
        run.SWEEP,
        store.TABLE,
        store.HEADER,
        many_fits.NAMES.table,
        many_fits.NAMES.header,
        contact.TABLE,
    } <= RESULTS
