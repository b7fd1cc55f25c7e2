"""What the log readers need to know of a gear pair or drive."""

from fractions import Fraction
from typing import Protocol, runtime_checkable

from ..pair.schema import Encoder, HarmonicOrders, LogLayout, UnitTable


@runtime_checkable
@runtime_checkable
class Shaft(Protocol):
    """One shaft: the tooth count of its gear, where it has one, and its encoder."""

    @property
    def teeth(self) -> int | None: ...  # noqa: D102

    @property
    def encoder(self) -> Encoder: ...  # noqa: D102


@runtime_checkable
@runtime_checkable
class TwoShafts(Protocol):
    """A pair file, a `GearPair` or a `Drive`: how the two columns of a log belong together."""

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
