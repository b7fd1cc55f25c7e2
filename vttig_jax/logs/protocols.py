"""Protocols of a gear pair or drive, as needed by the log readers."""

from fractions import Fraction
from typing import Protocol, runtime_checkable

from ..pair.schema import Encoder, HarmonicOrders, LogLayout, UnitTable


@runtime_checkable
class Shaft(Protocol):
    """Shaft with its encoder and the tooth count of its gear, or None without a gear."""

    @property
    def teeth(self) -> int | None: ...  # noqa: D102

    @property
    def encoder(self) -> Encoder: ...  # noqa: D102


@runtime_checkable
class TwoShafts(Protocol):
    """Pair file, `GearPair` or `Drive`: ratio, shafts, and the layout and units of a log."""

    @property
    def ratio(self) -> Fraction: ...  # noqa: D102

    @property
    def driving(self) -> Shaft: ...  # noqa: D102

    @property
    def driven(self) -> Shaft: ...  # noqa: D102

    @property
    def log(self) -> LogLayout: ...  # noqa: D102

    @property
    def unit(self) -> UnitTable: ...  # noqa: D102

    @property
    def fit(self) -> HarmonicOrders: ...  # noqa: D102
