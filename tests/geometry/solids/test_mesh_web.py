import numpy as np
import pytest

from vttig_jax.geometry.solids.closing_faces import nondegenerate, triangle_strip


def area(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    u, v = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


@pytest.mark.parametrize(("first", "second"), [(5, 5), (2, 9), (9, 2), (4, 1), (1, 4)])
def test_two_lines_are_filled_counter_clockwise(first, second):
    """Right and left side of a strip 2 wide and 3 high (or a triangle)."""
    right = np.linspace(0, 3, first) if first > 1 else np.array([1.5])
    left = np.linspace(0, 3, second) if second > 1 else np.array([1.5])
    points = np.concatenate(
        [np.stack([np.ones_like(right), right], 1), np.stack([-np.ones_like(left), left], 1)]
    )
    index = np.arange(len(points))
    triangles = triangle_strip(index[:first], index[first:], right, left)
    assert len(triangles) == first + second - 2
    areas = area(points, triangles)
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(6.0 if min(first, second) > 1 else 3.0)


def test_triangles_with_a_point_twice_are_dropped():
    triangles = np.array([[0, 1, 2], [0, 0, 1], [1, 2, 2], [3, 1, 3]])
    np.testing.assert_array_equal(nondegenerate(triangles), [[0, 1, 2]])
