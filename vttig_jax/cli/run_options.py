"""The options of one `vttig fit`, as they are given, kept in `run.toml` and given again."""

import sys
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

from ..base.errors import UsageError
from .fit_options import (
    HIGHEST_DRIFT,
    LONGEST_DELAY_S,
    DelayWord,
    FlankName,
    LossName,
    NoiseIn,
    NoiseKind,
    NoiseOf,
    RegressorName,
)
from .options import roles_of

if TYPE_CHECKING:
    from ..logs.encoder_log import EncoderLog

MOST_PIECES = 300
"""Of a drift spline over one log."""

_Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]
_Seconds = Annotated[float, Meta(ge=-LONGEST_DELAY_S, le=LONGEST_DELAY_S)]


class RunOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of `vttig fit` by the names of its parameters; columns as texts ROLE=NAME.

    An option an older run does not have takes its default.

    **Raises** `UsageError` for options that exclude each other.
    """

    columns: tuple[str, ...] = ()
    decimal: Annotated[str, Meta(pattern="^[.,]$")] | None = None
    sample_rate: _Positive | None = None
    flank: FlankName | None = None
    perfect_encoders: bool = False
    perfect_gears: bool = False
    delay: DelayWord | _Seconds = "auto"
    loss: LossName = "auto"
    regressors: tuple[RegressorName, ...] = ()
    free_ratio: bool = False
    drift_order: Annotated[int, Meta(ge=0, le=HIGHEST_DRIFT)] | None = None
    drift_knots: _Positive | None = None
    same_zero: bool | None = None
    use_readings: bool = False
    noise: NoiseKind = "ar"
    noise_in: NoiseIn = "time"
    noise_of: NoiseOf = "rig"

    def check(self, logs: int, *, readings: bool) -> None:
        """Refuse options that contradict each other or say nothing about this many logs."""
        roles_of(self.columns)
        if self.drift_order is not None and self.drift_knots is not None:
            raise UsageError(
                "--drift-order and --drift-knots exclude each other; give one of them."
            )
        if self.perfect_encoders and self.perfect_gears:
            raise UsageError(
                "--perfect-encoders and --perfect-gears together leave nothing to fit; give one."
            )
        if "speed" in self.regressors and self.delay not in ("auto", "off"):
            raise UsageError(
                "--regressor speed and --delay are the same term, as a delay shifts by its seconds"
                " times the speed; give one of them."
            )
        if self.use_readings and not readings:
            raise UsageError("--use-readings needs --backlash-readings FILE.")
        if self.same_zero is not None and logs == 1:
            name = "--same-zero" if self.same_zero else "--own-zero"
            raise UsageError(f"{name} compares several logs, but there is one; leave it out.")

    def check_drift(self, log: "EncoderLog") -> None:
        """Refuse a spline of so many pieces that it would follow the gears, and take for ever."""
        if self.drift_knots is None:
            return
        duration_s = float(log.time[-1] - log.time[0])
        if duration_s > MOST_PIECES * self.drift_knots:
            raise UsageError(
                f"--drift-knots {self.drift_knots:g} cuts its {duration_s:.4g} s into more than"
                f" {MOST_PIECES} pieces, no longer a drift; give"
                f" {duration_s / MOST_PIECES:.2g} or more.",
                where=log.source,
            )

    def reading(self) -> dict[str, Any]:
        """Keywords of `read_log`."""
        return {
            "columns": roles_of(self.columns),
            "decimal": self.decimal,
            "sample_rate_hz": self.sample_rate,
        }

    def fitting(self) -> dict[str, Any]:
        """Keywords of `fit`."""
        return {
            "flank": self.flank,
            "encoder_terms": not self.perfect_encoders,
            "gear_terms": not self.perfect_gears,
            "delay": self.delay,
            "loss": self.loss,
            "regressors": tuple(dict.fromkeys(self.regressors)),
            "free_ratio": self.free_ratio,
            "drift_order": self.drift_order,
            "drift_knots_s": self.drift_knots,
            "same_zero": self.same_zero,
            "use_readings": self.use_readings,
            "noise": self.noise,
            "noise_in": self.noise_in,
            "noise_of": self.noise_of,
        }

    def table(self) -> dict[str, Any]:
        """The TOML table of `run.toml`; what has no value is left out."""
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in fields.items()
            if value is not None
        }
