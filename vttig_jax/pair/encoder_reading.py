"""Conversion of an encoder reading to the angle of its shaft."""

import math
from dataclasses import dataclass

from ..base.units import DEG, REV
from .schema import Encoder


@dataclass(frozen=True)
class ShaftReading:
    """Linear relation of shaft angle and reading, φ = `radians_per_unit` · (reading − `origin`).

    **Arguments**
    - `unit`: unit of the reading: "counts", or "rad" if the counts per revolution are unknown.
    - `radians_per_unit`: factor in rad per `unit` with the sign and scale of the log channel.
    - `origin`: reading at which φ is zero, in `unit`.

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
        """Return φ in rad for a reading in `unit`."""
        return self.radians_per_unit * (reading - self.origin)

    def angle_of_deg(self, reading_deg: float) -> float:
        """Return φ in rad for a reading in degrees of the shaft.

        `reading_deg` increases with the counts of the encoder. The scale of the log column is
        already applied to it.
        """
        sign = math.copysign(1.0, self.radians_per_unit)
        return sign * reading_deg * DEG - self.radians_per_unit * self.origin


def shaft_reading(encoder: Encoder, origin_rad: float, scale: float = 1.0) -> ShaftReading:
    """Return the relation of shaft angle and reading for an encoder.

    **Arguments**
    - `origin_rad`: reading at which φ is zero, in rad of the encoder, before its sign and `scale`
      are applied.
    - `scale`: scale of the log column, `driving_scale` or `driven_scale` of the pair file.
    """
    if encoder.counts_per_rev is None:
        return ShaftReading("rad", encoder.sign * scale, origin_rad)
    count = REV / encoder.counts_per_rev
    return ShaftReading("counts", encoder.sign * scale * count, origin_rad / count)
