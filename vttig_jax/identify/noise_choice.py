"""What is assumed of the noise of the rows before it is estimated."""

from dataclasses import dataclass
from typing import Literal

HIGHEST_LAG = 16
"""Highest autoregressive order."""


@dataclass(frozen=True)
class NoiseChoice:
    """Kind of the noise, and what it has in common.

    **Arguments**
    - `kind`: "ar", an autoregression whose order follows the logs; "white" for none; "ou", an
      Ornstein–Uhlenbeck process, for rows at unequal times.
    - `stationary_in`: "time" makes rows of equal duration, "angle" rows of equal driving angle.
    - `of`: "rig" for one noise everywhere, "plateau" for one of its own at every speed.

    **Raises** `ValueError` naming the argument.
    """

    kind: Literal["ar", "white", "ou"] = "ar"
    stationary_in: Literal["time", "angle"] = "time"
    of: Literal["rig", "plateau"] = "rig"

    def __post_init__(self):
        known = {
            "kind": ("ar", "white", "ou"),
            "stationary_in": ("time", "angle"),
            "of": ("rig", "plateau"),
        }
        for name, words in known.items():
            if getattr(self, name) not in words:
                listed = " or ".join(f'"{word}"' for word in words)
                raise ValueError(
                    f"Argument `{name}` must be {listed}, but is {getattr(self, name)!r}."
                )
