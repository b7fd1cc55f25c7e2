"""A result may stand beside other files, and no command writes over one of them."""

import shutil


def _fit(vttig, folder, *more):
    return vttig("fit", folder / "log.csv", "--pair", folder / "pair.toml", "--out", folder, *more)


def test_a_result_may_stand_beside_the_log(vttig, rig_folder, tmp_path):
    folder = shutil.copytree(rig_folder, tmp_path / "thesis")
    (folder / "thesis.tex").write_text("text")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert _fit(vttig, folder, "--no-figures")[0] == 0
    assert (folder / "fit.json").exists()
    assert {name: (folder / name).read_bytes() for name in before} == before


def test_a_picture_of_another_origin_stays(vttig, rig_folder, tmp_path):
    folder = shutil.copytree(rig_folder, tmp_path / "thesis")
    (folder / "figures").mkdir()
    (folder / "figures" / "te_fit.png").write_text("mine")
    code, _, err = _fit(vttig, folder)
    assert code == 2 and "te_fit.png: already exists" in err
    assert (folder / "figures" / "te_fit.png").read_text() == "mine"
    assert not (folder / "fit.json").exists()


def test_the_demo_writes_over_no_log(vttig, tmp_path):
    (tmp_path / "log.csv").write_text("mine")
    code, _, err = vttig("demo", "--out", tmp_path)
    assert code == 2 and "log.csv: already exists" in err
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
    assert (tmp_path / "log.csv").read_text() == "mine"
