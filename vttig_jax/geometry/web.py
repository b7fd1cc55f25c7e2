"""What closes a gear between its teeth and its bore: end faces, bore and the cut faces of a sector.

The end face of a tooth is filled rung by rung between its right and its left side, the rim below by
going around the feet of the teeth and the bore at once; neither adds a point.
"""

import numpy as np
from jaxtyping import Float, Int

Triangles = Int[np.ndarray, "_ 3"]


def zipped(
    first: Int[np.ndarray, " n"],
    second: Int[np.ndarray, " m"],
    first_key: Float[np.ndarray, " n"],
    second_key: Float[np.ndarray, " m"],
) -> Triangles:
    """Triangles between two lines of points, advancing on that whose next edge comes first.

    They go first → its next → second, so that they are counter-clockwise where the second line
    lies to the left of the first.

    **Arguments**
    - `first`, `second`: indices of the points, in the same sense; one point is enough for a fan.
    - `first_key`, `second_key`: how far along each point is, by which the edges are ordered.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.geometry.web import zipped
    >>> zipped(np.array([0, 1, 2]), np.array([3, 4]), np.arange(3.0), np.array([0.0, 2.0]))
    array([[0, 1, 3],
           [1, 4, 3],
           [1, 2, 4]])

    ```
    """
    ends = (first_key[1:] + first_key[:-1]) / 2, (second_key[1:] + second_key[:-1]) / 2
    order = np.argsort(np.concatenate(ends), kind="stable")
    on_first = order < len(ends[0])
    a = np.concatenate([[0], np.cumsum(on_first)])[:-1]
    b = np.concatenate([[0], np.cumsum(~on_first)])[:-1]
    after = np.where(on_first, first[np.minimum(a + 1, len(first) - 1)], 0)
    after = np.where(on_first, after, second[np.minimum(b + 1, len(second) - 1)])
    return np.stack([first[a], after, second[b]], axis=-1)


def tooth_face(
    points: Float[np.ndarray, "columns 3"],
    columns: Int[np.ndarray, " columns"],
    joints: Int[np.ndarray, "9"],
) -> Triangles:
    """The end face of one tooth above the line between its feet, seen from +z.

    **Arguments**
    - `points`: one section.
    - `columns`: the point that stands for each.
    - `joints`: where the pieces begin and end; see `ToothGrid`.
    """
    foot, corner, middle, other_corner, other_foot = joints[[1, 3, 4, 5, 7]]
    radius = np.hypot(points[:, 0], points[:, 1])
    key = radius.copy()
    # Along the tip the radius tells nothing: count up to its middle.
    top = max(radius[corner], radius[other_corner])
    key[corner : middle + 1] = top + np.linspace(0.0, 1.0, middle - corner + 1)
    key[middle : other_corner + 1] = top + np.linspace(1.0, 0.0, other_corner - middle + 1)
    right = np.arange(foot, middle + 1)
    left = np.arange(other_foot, middle - 1, -1)
    return columns[zipped(right, left, key[right], key[left])]


def rim_face(
    points: Float[np.ndarray, "columns 3"],
    columns: Int[np.ndarray, " columns"],
    joints: Int[np.ndarray, "9"],
    inner: Int[np.ndarray, " k"],
    pitch: float,
    turned: float = 0.0,
) -> Triangles:
    """The end face of one pitch between the feet and the bore, seen from +z.

    **Arguments**
    - `points`, `columns`, `joints`: as for `tooth_face`.
    - `inner`: indices of the points on the bore, evenly from one space to the next; one for the
      axis.
    - `pitch`: angle between neighbouring teeth, rad.
    - `turned`: by which the points on the bore are turned counter-clockwise, rad.
    """
    foot, other_foot, last = joints[[1, 7, 8]]
    outer = np.concatenate([np.arange(foot + 1), np.arange(other_foot, last + 1)])
    x, y = points[outer, 0], points[outer, 1]
    cosine, sine = np.cos(turned), np.sin(turned)
    angle = np.arctan2(-(x * cosine + y * sine), y * cosine - x * sine)
    inner_angle = np.linspace(-pitch / 2, pitch / 2, len(inner))
    return zipped(columns[outer], inner, angle, inner_angle)


def real(triangles: Triangles) -> Triangles:
    """Those whose three points differ."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]
