import numpy as np
import pytest

from vttig_jax.kinematics.backlash_map import chunked

pytestmark = pytest.mark.smoke


def test_chunks_equal_the_whole():
    for length in (0, 1, 8191, 8192, 8193, 20000):
        grid = np.linspace(-1.0, 5.0, length)
        found = chunked(lambda piece: np.sin(piece) + piece**2, grid)
        np.testing.assert_array_equal(found, np.sin(grid) + grid**2)


def test_every_chunk_has_one_size_and_finite_padding():
    sizes, finite = [], []

    def note(piece):
        sizes.append(len(piece))
        finite.append(bool(np.all(piece > 0)))
        return piece

    chunked(note, np.arange(1.0, 10001.0))
    assert sizes == [8192, 8192] and all(finite)
