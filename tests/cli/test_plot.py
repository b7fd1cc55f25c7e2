"""`vttig plot`: one picture of a run."""

import pytest
from matplotlib.figure import Figure

import vttig_jax

STARTS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.portable
@pytest.mark.parametrize(("name", "form"), [("te", "pdf"), ("map", "svg"), ("orders", "png")])
def test_a_picture(found, run_folder, tmp_path, name, form):
    out = tmp_path / f"picture.{form}"
    record = found("plot", run_folder, name, "--out", out)
    assert (record["picture"], record["name"]) == (str(out), name)
    assert out.read_bytes().startswith(STARTS[form])


def test_python_draws_it_on_given_axes(run_folder):
    _, given = Figure().subplots(2, 1)
    vttig_jax.enable_x64()
    assert vttig_jax.open_run(run_folder).fit.plot("map", ax=given) is given.get_figure()
    assert "hunting period of 16 turns" in given.get_title(loc="left") and len(given.lines) > 1


def test_what_cannot_be_drawn(refused, run_folder, tmp_path):
    out = tmp_path / "x.png"
    refused(2, "", "plot", run_folder, "map", "--out", tmp_path / "x.gif")
    refused(2, "vttig sample", "plot", run_folder, "trace", "--out", out)
    assert not out.exists()
    out.write_bytes(b"")
    refused(2, "--overwrite", "plot", run_folder, "te", "--out", out)
    assert out.read_bytes() == b""
