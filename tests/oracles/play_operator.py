"""The play operator in plain Python: turn by turn in closed form, and sample by sample.

The driven shaft stands still unless a flank pushes it. Pushed, it stands at i φ₁ + TE_A(φ₁) while
φ₁ rises and at i φ₁ + TE_B(φ₁) while it falls; both grow with φ₁, because TE changes far slower
than i φ₁. So only the angles where the motion turns matter, not the way between them.
"""

from collections.abc import Sequence

import numpy as np

from .flank_formulas import Wall


def by_turns(
    walls: tuple[Wall, Wall], ratio: float, corners: Sequence[float], angle: float, start: float
) -> float:
    """φ₂ where φ₁ has gone through `corners` and then to `angle`; φ₂ is `start` at the first."""
    place = start
    for begin, end in zip(corners, [*corners[1:], angle], strict=True):
        if end > begin:
            place = max(place, ratio * end + walls[0](end)[0])
        elif end < begin:
            place = min(place, ratio * end + walls[1](end)[0])
    return place


def by_samples(
    walls: tuple[Wall, Wall], ratio: float, angles: np.ndarray, start: float
) -> np.ndarray:
    """φ₂ at every angle of a finely sampled motion; it is clipped between the flanks there."""
    place, path = start, []
    for angle in angles:
        low, high = (ratio * angle + wall(angle)[0] for wall in walls)
        place = min(max(place, low), high)
        path.append(place)
    return np.array(path)
