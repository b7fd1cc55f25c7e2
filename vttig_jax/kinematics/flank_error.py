"""Peak-to-peak value and rms of the transmission error of one flank."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..base.units import ARCSEC, DEG, REV
from ..pair.gear_pair import Flank
from .backlash_map import chunked
from .flank_model import FlankModel, flank_index
from .harmonic import OrderModel, linearised_series
from .hunting_coverage import Spans

POINTS_PER_PERIOD = 32
"""Points in a period of the highest order: they miss at most 0.5 % of its amplitude (chosen)."""

_MOST_POINTS = 2**18  # most points in all (chosen); the phases of a longer travel come again


@dataclass(frozen=True)
class FlankError:
    """Size of the transmission error of a flank, whatever its mean is.

    **Arguments**
    - `peak_to_peak_deg`: largest value minus smallest value, ° of the driven gear.
    - `rms_deg`: rms of the differences from the mean, °.
    - `turns`: driving turns over which both were computed.
    - `significant`: whether the error is larger than its noise.
    """

    peak_to_peak_deg: float
    rms_deg: float
    turns: float
    significant: bool = True

    def to_json(self) -> dict[str, Any]:
        """Return the object of one flank in `transmission_error` of a fit."""
        return dict(vars(self))

    def __str__(self) -> str:
        peaks, rms = self.peak_to_peak_deg, self.rms_deg
        arcsec = [f"{value * DEG / ARCSEC:.2f}″" for value in (peaks, rms)]
        return (
            f"{peaks:.5f}° peak to peak, {rms:.5f}° rms ({', '.join(arcsec)})"
            f"{'' if self.significant else ', not above its noise'}"
        )


def flank_error(
    error: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]],
    spans: Spans,
    highest_order: float,
) -> FlankError:
    """Return the size of a transmission error over driving angles.

    The points have equal distances over all `spans` together, 32 in a period of the highest order.

    **Arguments**
    - `error`: function that returns TE of one flank, rad, at driving angles in rad.
    - `spans`: disjoint intervals of the driving angle, rad; rows are start and stop.
    - `highest_order`: highest order of `error`, cycles per driving turn.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.base import ARCSEC
    >>> from vttig_jax.kinematics.flank_error import flank_error
    >>> turn = np.array([[0.0, 2 * np.pi]])
    >>> print(flank_error(lambda angle: 5 * ARCSEC * np.sin(3 * angle), turn, 3.0))
    0.00278° peak to peak, 0.00098° rms (10.00″, 3.54″)

    ```
    """
    ends = np.cumsum(spans[:, 1] - spans[:, 0])
    turns = float(ends[-1]) / REV
    count = min(math.ceil(POINTS_PER_PERIOD * max(highest_order, 1.0) * turns), _MOST_POINTS)
    travelled = np.arange(count) / count * ends[-1]
    part = np.minimum(np.searchsorted(ends, travelled, side="right"), len(ends) - 1)
    values = error(spans[part, 1] - (ends[part] - travelled))
    return size_of(values, turns)


def size_of(error: Float[np.ndarray, " n"], turns: float, significant: bool = True) -> FlankError:
    """Return the size of values of TE, rad, at equal distances over `turns` driving turns."""
    return FlankError(float(np.ptp(error)) / DEG, float(error.std()) / DEG, turns, significant)


def errors_at(
    model: FlankModel, flank: Flank, driving_angle: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return TE of `flank`, rad, at driving angles in rad; series are not compiled by JAX."""
    if not isinstance(model, OrderModel):
        return chunked(lambda angles: _transmission_error(model, angles, flank), driving_angle)
    side, ratio = flank_index(flank), float(model.ratio)
    parts = [np.asarray(part)[side] for part in (model.offset, model.cosine, model.sine)]
    return chunked(
        lambda angles: linearised_series(ratio, model.terms, parts, angles)[0], driving_angle
    )


@eqx.filter_jit
def _transmission_error(
    model: FlankModel, driving_angle: Float[ArrayLike, " n"], flank: Flank
) -> Float[Array, " n"]:
    return model.transmission_error(driving_angle, flank)
