"""Files and links that wait under the names of temporary files."""

import pytest

from vttig_jax.base.files import atomic_write
from vttig_jax.base.files.atomic_write import (
    open_new,
    remove_abandoned,
    replace_file,
    temporary_path,
)
from vttig_jax.base.files.run_folder import RunFolder


def test_temporary_names_are_random_and_short(tmp_path):
    target = tmp_path / ("n" * 240 + ".csv")
    names = {temporary_path(target).name for _ in range(100)}
    assert len(names) == 100 and all(len(name) < 150 for name in names)
    replace_file(target, b"new")
    assert target.read_bytes() == b"new" and list(tmp_path.iterdir()) == [target]


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (tmp_path / ".m.csv.tmp").symlink_to(precious)
    with RunFolder(tmp_path, results=("m.csv",)) as folder:
        folder.write_text("m.csv", "new")
    assert precious.read_text() == "mine" and (tmp_path / "m.csv").read_text() == "new"
    # Even a name that was guessed is not opened.
    guessed = tmp_path / "guessed"
    guessed.symlink_to(precious)
    with pytest.raises(FileExistsError):
        open_new(guessed)
    monkeypatch.setattr(atomic_write, "temporary_path", lambda target: guessed)
    with pytest.raises(FileExistsError):
        replace_file(tmp_path / "other", b"new")
    assert precious.read_text() == "mine"


def test_a_result_that_is_a_link_is_replaced_and_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (tmp_path / "m.csv").symlink_to(precious)
    with RunFolder(tmp_path, overwrite=True) as folder:
        folder.write_text("m.csv", "new")
    assert precious.read_text() == "mine" and not (tmp_path / "m.csv").is_symlink()


def test_only_the_files_of_the_same_target_are_abandoned(tmp_path):
    target = tmp_path / "posterior"
    own = [temporary_path(target), tmp_path / ".posterior.tmp"]
    others = [temporary_path(tmp_path / "posterior.h5"), tmp_path / ".posterior.mine.tmp"]
    for path in (*own, *others):
        path.write_text("half")
    remove_abandoned(target)
    assert sorted(tmp_path.iterdir()) == sorted(others)
