"""The layout of block rows: places, widths, and one log put among several."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.identify.model.column_layout import OFFSET, ColumnLayout

FREE, TIED = ((2, 0), (0, 2), (45, 0)), ((1, 0), (0, 1))
OWN = ((OFFSET, "drift_1", "delay"), (OFFSET,), (OFFSET, "delay"))
THREE = ColumnLayout(FREE, TIED, OWN)

_NAMES = ["drift_1", "drift_2", "delay", "ratio", "torque_0"]
_OWN = st.lists(
    st.lists(st.sampled_from(_NAMES), unique=True).map(lambda names: (OFFSET, *names)),
    min_size=1,
    max_size=4,
).map(tuple)


def _labels(columns: ColumnLayout) -> list:
    """What stands in every column, spelled out in the documented order."""
    harmonics = lambda terms: [(axis, term) for term in terms for axis in "cs"]  # noqa: E731
    own = [(name, log) for log, names in enumerate(columns.own) for name in names]
    return [*harmonics(columns.free), *own, *harmonics(columns.tied), "y"]


def test_widths_of_three_logs():
    assert THREE.width == 6 + 6 + 4 + 1 == len(_labels(THREE))
    assert (THREE.free_width, THREE.own_width) == (6, 6)
    assert THREE.own_slice == slice(6, 12)
    assert ColumnLayout(FREE, TIED).own == ((OFFSET,),)


@given(own=_OWN)
def test_places_are_where_the_labels_say(own):
    columns = ColumnLayout(FREE, TIED, own)
    labels = _labels(columns)
    assert len(labels) == columns.width
    for position, term in enumerate(FREE + TIED):
        place = columns.cosine(position)
        assert labels[place : place + 2] == [("c", term), ("s", term)]
    for name, log in columns.names:
        assert labels[columns.index(name, log)] == (name, log)
    assert labels[columns.own_slice] == columns.names


@given(own=_OWN)
def test_embedding_puts_every_column_of_a_log_in_its_place(own):
    columns = ColumnLayout(FREE, TIED, own)
    wide = _labels(columns)
    for log in range(len(own)):
        narrow = _labels(columns.of_log(log))
        matrix = columns.embedding(log)
        assert matrix.shape == (len(wide), len(narrow))
        # Alone, a log is number 0.
        own = columns.of_log(log).names
        expected = [(x[0], log) if x in own else x for x in narrow]
        rows, cells = np.nonzero(matrix)
        assert [wide[row] for row in rows] == [expected[cell] for cell in cells]
        np.testing.assert_array_equal(matrix.T @ matrix, np.eye(len(narrow)))


def test_columns_of_other_logs_are_zero():
    row = np.arange(1.0, THREE.of_log(1).width + 1)
    wide = THREE.embedding(1) @ row
    others = [THREE.index(name, log) for name, log in THREE.names if log != 1]
    np.testing.assert_array_equal(wide[others], 0.0)
    assert wide[THREE.index(OFFSET, 1)] == 7.0
    np.testing.assert_array_equal(THREE.embedding(1).T @ wide, row)


def test_a_column_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="not in list"):
        THREE.index("drift_1", 1)
