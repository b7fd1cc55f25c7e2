"""What an encoder shows and the shaft angle it stands for."""

import math
from dataclasses import dataclass

from ..base.units import DEG, REV
from .schema import Encoder


@dataclass(frozen=True)
class ShaftReading:
    """A shaft angle from a reading of its encoder, φ = `radians_per_unit` · (reading − `origin`).

    **Arguments**
    - `unit`: "counts", or "rad" where nothing says how many counts make a revolution.
    - `radians_per_unit`: sign and scale included, as for a log.
    - `origin`: the reading at which φ is zero, in `unit`.

    **Example**
    ```python
    >>> from vttig_jax.pair import ShaftReading, shaft_reading
    >>> from vttig_jax.pair import Encoder
    >>> shaft = shaft_reading(Encoder(counts_per_rev=3600, sign=-1), origin_rad=0.0)
    >>> round(shaft.angle(900), 4), round(shaft.angle_of_deg(90.0), 4)
    (-1.5708, -1.5708)

    ```
    """

    unit: str
    radians_per_unit: float
    origin: float

    def angle(self, reading: float | int) -> float:
        """φ in rad of a reading in `unit`."""
        return self.radians_per_unit * (reading - self.origin)

    def angle_of_deg(self, reading_deg: float) -> float:
        """φ in rad of a reading in degrees of the shaft, in the sense in which its encoder counts.

        The scale of a log column is in such degrees already.
        """
        sense = math.copysign(1.0, self.radians_per_unit)
        return sense * reading_deg * DEG - self.radians_per_unit * self.origin


def shaft_reading(encoder: Encoder, origin_rad: float, scale: float = 1.0) -> ShaftReading:
    """How the readings of an encoder become angles.

    **Arguments**
    - `origin_rad`: the reading at which φ is zero as an angle of the encoder, before its sign and
      before `scale`.
    - `scale`: of the log's column, `driving_scale` or `driven_scale`.
    """
    if encoder.counts_per_rev is None:
        return ShaftReading("rad", encoder.sign * scale, origin_rad)
    count = REV / encoder.counts_per_rev
    return ShaftReading("counts", encoder.sign * scale * count, origin_rad / count)
