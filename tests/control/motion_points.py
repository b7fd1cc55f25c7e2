"""Points of a motion for many tests at one price."""

from typing import Any

import jax
import numpy as np

from vttig_jax.control.motion.motion import MotionPoint

ROOM = 4096


def at(motion: Any, time: Any) -> MotionPoint:
    """Point of a motion at any times as NumPy arrays.

    JAX always sees the same shape, so that every operation is compiled once for all motions.
    """
    time = np.asarray(time, float)
    flat = time.ravel()
    blocks = [flat[start : start + ROOM] for start in range(0, flat.size, ROOM)]
    points = [motion.at(np.pad(block, (0, ROOM - block.size))) for block in blocks]

    def joined(*parts: Any) -> np.ndarray:
        return np.concatenate(parts)[: flat.size].reshape(time.shape)

    return jax.tree.map(joined, *points)
