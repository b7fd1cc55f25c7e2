"""Kinds of noise: how the rows of a log are summarised for them, and their names in reports."""

from dataclasses import dataclass

from ..settings import HIGHEST_LAG, NoiseKind
from .flank_summary import FlankSummary
from .irregular_flank import IrregularFlank
from .lagged_flank import LaggedFlank


@dataclass(frozen=True)
class RowNoise:
    """One kind of noise of the rows.

    **Arguments**
    - `summary`: class of the flank summaries.
    - `highest_lag`: largest number of lags; 0 for noise that needs no lag products.
    - `name`: name of the noise model; `{order}` stands for its order.
    - `has_memory`: whether the rows may be correlated.
    """

    summary: type[FlankSummary]
    highest_lag: int
    name: str
    has_memory: bool = True


NOISE: dict[NoiseKind, RowNoise] = {
    "ar": RowNoise(LaggedFlank, HIGHEST_LAG, "AR({order})"),
    "white": RowNoise(LaggedFlank, 0, "white", has_memory=False),
    "ou": RowNoise(IrregularFlank, 0, "Ornstein–Uhlenbeck"),
}
"""Kind of noise in the settings → its `RowNoise`."""
