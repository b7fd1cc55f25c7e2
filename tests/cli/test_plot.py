"""`vttig plot`: one picture of a run."""

import pytest
from matplotlib.figure import Figure

import vttig_jax

STARTS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.portable
@pytest.mark.parametrize(("name", "form"), [("te", "pdf"), ("map", "svg"), ("orders", "png")])
def test_a_picture(vttig_json, run_folder, tmp_path, name, form):
    out = tmp_path / f"picture.{form}"
    code, record = vttig_json("plot", run_folder, name, "--out", out)
    assert (code, record["picture"], record["name"]) == (0, str(out), name)
    assert out.read_bytes().startswith(STARTS[form])


def test_python_draws_it_on_given_axes(run_folder):
    _, given = Figure().subplots(2, 1)
    vttig_jax.enable_x64()
    assert vttig_jax.open_run(run_folder).fit.plot("map", ax=given) is given.get_figure()
    assert "hunting period of 16 turns" in given.get_title(loc="left") and len(given.lines) > 1


def test_what_cannot_be_drawn(vttig, run_folder, tmp_path):
    out = tmp_path / "x.png"
    assert vttig("plot", run_folder, "map", "--out", tmp_path / "x.gif")[0] == 2
    code, _, err = vttig("plot", run_folder, "trace", "--out", out)
    assert code == 2 and "vttig sample" in err and not out.exists()
    out.write_bytes(b"")
    code, _, err = vttig("plot", run_folder, "te", "--out", out)
    assert code == 2 and "--overwrite" in err and out.read_bytes() == b""
