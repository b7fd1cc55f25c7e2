import hashlib

import numpy as np
import pytest
from scipy.io import savemat

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.delimited import TextTable
from vttig_jax.logs.readers.nested import NestedTable
from vttig_jax.logs.readers.open_table import open_table


def test_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes("t,φ\n0,1\n".encode("cp1253"))
    table, digest, notes = open_table(path, encoding="cp1253")
    assert isinstance(table, TextTable) and table.names == ("t", "φ") and notes == ()
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "cp1252" in open_table(path)[2][0]
    assert open_table(path, delimiter=",", requested=["#1", None, "φ"])[0].names[0] == "t"


def test_text_without_a_header(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("1;2,5\n3;4,5\n")
    table, _, _ = open_table(path, decimal=",", requested=[None, "#2", "#1"])
    assert table.names == ("#1", "#2") and table.columns([1])[0].tolist() == [2.5, 4.5]
    for asked in ([], ["#row", "name", None]):
        with pytest.raises(LogError, match="without a header"):
            open_table(path, requested=asked)


def test_matlab_by_its_ending(tmp_path):
    path = tmp_path / "log.MAT"
    savemat(path, {"t": np.arange(3.0)}, appendmat=False)
    table, digest, notes = open_table(path, requested=["t", "#row"])
    assert isinstance(table, NestedTable) and table.names == ("t",) and notes == ()
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(LogError, match="no column #2; give an array name such as t"):
        open_table(path, requested=["#2"])
