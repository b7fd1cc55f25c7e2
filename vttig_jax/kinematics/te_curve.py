"""Measured or computed transmission error of one flank over the driving angle."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..base.files.text_tables import key_values
from ..base.units import DEG, REV
from ..pair.gear_pair import Flank

Samples = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class TECurve:
    """Uninterrupted sequence of transmission errors on one flank.

    **Arguments**
    - `flank`: "A" (driving angle increases) or "B" (driving angle decreases).
    - `driving_angle`: φ₁ in rad, shape (n,).
    - `transmission_error`: TE = φ₂ − i φ₁ in rad, shape (n,).
    - `time`: times of the samples in s, shape (n,).
    """

    flank: Flank
    driving_angle: Samples
    transmission_error: Samples
    time: Samples

    def __len__(self) -> int:
        return len(self.driving_angle)

    def part(self, points: slice | Bool[np.ndarray, " n"]) -> "TECurve":
        """Return the curve of the points that the slice or mask `points` selects."""
        arrays = (self.driving_angle, self.transmission_error, self.time)
        return TECurve(self.flank, *(values[points] for values in arrays))

    @property
    def peak_to_peak(self) -> float:
        """Largest minus smallest TE, rad; 0 without points. Noise biases it upwards."""
        return float(np.ptp(self.transmission_error)) if len(self) else 0.0

    def __str__(self) -> str:
        rows = [("points", f"{len(self)}")]
        if len(self):
            first, last = self.driving_angle[0], self.driving_angle[-1]
            rows += [
                ("driving angle", f"{first / DEG:.3f}° … {last / DEG:.3f}°"),
                ("turns", f"{abs(last - first) / REV:.3f}"),
                ("peak to peak", f"{self.peak_to_peak / DEG:.5f}°"),
            ]
        return key_values(rows, title=f"transmission error, flank {self.flank}")
