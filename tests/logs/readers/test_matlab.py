import io

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import eye

from vttig_jax.logs.readers.binary.matlab import MOST_CELLS, matlab_leaves


def leaves(variables, **options):
    file = io.BytesIO()
    savemat(file, variables, **options)
    return {name: array.tolist() for name, array in matlab_leaves(file.getvalue())}


@pytest.mark.parametrize(
    "options", [{}, {"format": "4"}, {"do_compression": True}, {"oned_as": "column"}]
)
def test_plain_arrays(options):
    found = leaves({"t": np.arange(3.0), "x": np.array([[1.5, 2], [3, 4]])}, **options)
    assert np.ravel(found["t"]).tolist() == [0, 1, 2] and found["x"] == [[1.5, 2], [3, 4]]


def test_structs_arrays_of_structs_and_cells():
    signals = np.array([({"v": [1.0, 2.0]},), ({"v": [3.0, 4.0]},)], dtype=[("d", "O")])
    cell = np.empty(2, object)
    cell[0], cell[1] = np.array([5.0, 6.0]), "text"
    found = leaves({"rec": {"a": {"b": [7.0, 8.0]}}, "s": signals, "c": cell})
    assert found == {
        "rec.a.b": [[7.0, 8.0]],
        "s(1).d.v": [[1.0, 2.0]],
        "s(2).d.v": [[3.0, 4.0]],
        "c{1}": [[5.0, 6.0]],
    }


def test_what_is_passed_over():
    many = np.empty(MOST_CELLS + 1, object)
    many[:] = [np.array([1.0])] * len(many)
    found = leaves(
        {"text": "abc", "z": np.array([1j, 2]), "s": eye(3).tocsc(), "many": many, "x": [1.0, 2.0]}
    )
    assert list(found) == ["x"]


def test_whole_numbers_stay_whole():
    file = io.BytesIO()
    savemat(file, {"n": np.array([2**60 + 1, 1]), "f": np.array([0.5, 1]), "b": [True, False]})
    kinds = {name: array.dtype.kind for name, array in matlab_leaves(file.getvalue())}
    assert kinds == {"n": "i", "f": "f", "b": "u"}
