import hashlib

import numpy as np
import pytest
from scipy.io import savemat

from vttig_jax.logs.readers.open_table import open_table


def test_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes("t,φ\n0,1\n".encode("cp1253"))
    table = open_table(path, encoding="cp1253")
    assert table.names == ("t", "φ") and table.notes == ()
    assert table.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "cp1252" in open_table(path).notes[0]
    assert open_table(path, delimiter=",", requested=["#1", None, "φ"]).names[0] == "t"


@pytest.mark.parametrize("requested", [[], ["#row", "name", None], [None, "#2", "#1"]])
def test_text_without_a_header(tmp_path, requested):
    path = tmp_path / "log.txt"
    path.write_text("1;2,5\n3;4,5\n")
    table = open_table(path, decimal=",", requested=requested)
    assert table.names == ("#1", "#2") and table.columns([1])[0].tolist() == [2.5, 4.5]


def test_matlab_by_its_ending(tmp_path):
    path = tmp_path / "log.MAT"
    savemat(path, {"t": np.arange(3.0)}, appendmat=False)
    table = open_table(path, requested=["t", "#row"])
    assert table.names == ("t",) and table.notes == () and table.line_of is None
    assert table.digest == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("comment", ["", "# pause\n"])
def test_a_closed_table_still_tells_its_lines(tmp_path, comment):
    path = tmp_path / "log.csv"
    path.write_text(f"t,a\n0,1\n{comment}1,2\n2,3\n")
    table = open_table(path)
    _, values = table.columns([0, 1])
    line_of = table.line_of
    table.close()
    assert line_of is not None and [line_of(row) for row in range(3)][::2] == [2, 4 + bool(comment)]
    assert values.tolist() == [1.0, 2.0, 3.0]
