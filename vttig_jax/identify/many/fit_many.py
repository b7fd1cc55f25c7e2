"""Fits of many logs, each from a separate rig, in batches: one table row for each log."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ...base.errors import VttigError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread, usable_cores
from ...base.units import DEG
from ...logs.encoder_log import EncoderLog
from ...pair.gear_pair import Drive, Flank, GearPair
from ...pair.schema import HarmonicOrders
from ..model.harmonics import TermPlan
from ..model.identifiability import Identifiability
from ..preliminary.delay import Delay
from ..report.conditions import is_split, perfect_parts
from ..report.parameters import SHAFTS, Parameter, parameters_of
from ..settings import FitSettings
from ..solve.least_squares import Solution
from .batch_model import BatchModel, batch_model
from .batches import Call, Shapes, logs_at_once
from .codes import Code
from .fit_arrays import ArrayFit
from .preparation import (
    NeedsFitError,
    PreparedLog,
    batch_settings,
    prepare,
    require_one_rig,
)
from .table import OK, PARTS, Columns, FitTable, table_of

Row = dict[str, Any]

_MOST_THREADS = 4
"""Number of threads that prepare logs (chosen). More would not help, because only one thread at a
time runs Python code."""


def fit_many(
    logs: Iterable[EncoderLog],
    pair: GearPair | Drive,
    *,
    orders: HarmonicOrders | None = None,
    progress: Callable[[int], None] = lambda logs: None,
    **changes: Any,
) -> FitTable:
    """Identify the parameters of many logs, each of a rig of its own, in one table.

    Every log has the parameters and standard errors of `vttig_jax.fit` with the same settings.
    Logs of one design share compiled programs, also logs of unequal length. A log that cannot be
    fitted has a code and a reason in its row, and the others are fitted.

    **Arguments**
    - `logs`: logs that were read with `pair`; of a generator, only a batch is in memory at a time.
    - `pair`: the gear pair, or a drive without geometry, that all rigs are built to.
    - `orders`: harmonic orders to model; those of the pair by default.
    - `progress`: called with the number of further logs that are done.
    - Settings are keywords and hold for all logs: `delay` ("off" or seconds), `drift_order`
      (0 by default), `flank`, `perfect_encoders`, `perfect_gears`. The loss is least squares, and
      lines do not join the model.

    **Returns** a `FitTable`, whose rows have the order of the logs.

    **Raises** `LogError` for a log that was read for another rig, `ValueError` for wrong settings
    and without 64-bit floats, `TypeError` for a keyword that is no setting, and for `logs` and a
    `pair` that are none.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import PassMotion, paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    >>> table = vttig_jax.fit_many([rig.log(seed) for seed in range(3)], rig.pair)
    >>> table.columns["driving_eccentricity_mm"].round(3).tolist()
    [0.022, 0.022, 0.022]

    ```
    """
    require_x64("fit_many")
    _require_types(logs, pair)
    settings = batch_settings(changes)
    columns = fit_columns(
        map(_encoder_log, logs), pair, settings, orders or pair.fit, progress=progress
    )
    return FitTable(columns=columns, pair=pair.name, settings=settings_table(settings))


def _require_types(logs: Any, pair: Any) -> None:
    """Raise `TypeError` for arguments of `fit_many` that are no logs or no pair."""
    if not isinstance(pair, GearPair | Drive):
        raise TypeError(
            "Argument `pair` must be a gear pair or a drive, such as `vttig_jax.load_pair` returns,"
            f" but is a {type(pair).__name__}."
        )
    if not isinstance(logs, Iterable) or isinstance(logs, str):
        raise TypeError(
            f"Argument `logs` must be an iterable of encoder logs, but is a {type(logs).__name__}."
        )


def _encoder_log(log: Any) -> EncoderLog:
    """Return an encoder log of the argument `logs` of `fit_many`; raise `TypeError` for others."""
    if not isinstance(log, EncoderLog):
        raise TypeError(
            "Argument `logs` must hold encoder logs, such as `vttig_jax.read_log` returns, but"
            f" holds a {type(log).__name__}."
        )
    return log


class Unread(NamedTuple):
    """A log that could not be read or prepared for the fit: its name and the error."""

    name: str
    error: VttigError


@one_blas_thread
def fit_columns(
    logs: Iterable[EncoderLog | Unread],
    pair: GearPair | Drive,
    settings: FitSettings,
    orders: HarmonicOrders,
    *,
    shapes: Shapes | None = None,
    progress: Callable[[int], None] = lambda logs: None,
) -> Columns:
    """Return the columns of the table of fits.

    `shapes` are the array shapes for which programs are compiled already. `progress` is called with
    the number of further logs that are done.
    """
    batches = Batches(progress, settings, pair, shapes or Shapes())

    def ready(log: EncoderLog | Unread) -> PreparedLog | Unread:
        if isinstance(log, Unread):
            return log
        require_one_rig([log], pair)
        try:
            return prepare(log, pair, settings, orders)
        except VttigError as error:
            return Unread(log.source, error)

    for name, found in _in_turn(ready, logs):
        batches.add(name, found)
    return table_of(batches.finished(), parameter_names(pair))


def _in_turn(
    ready: Callable[[EncoderLog | Unread], PreparedLog | Unread],
    logs: Iterable[EncoderLog | Unread],
) -> Iterator[tuple[str, PreparedLog | Unread]]:
    """Yield (name of the log, result of `ready`) for every log, in the order of the logs.

    Several threads prepare logs at the same time, because NumPy releases Python's lock. Only a few
    logs are in memory at a time, so that a long series of logs is not read at once.
    """
    threads = min(usable_cores(), _MOST_THREADS)
    with ThreadPoolExecutor(threads) as pool:
        running: deque[tuple[str, Future[PreparedLog | Unread]]] = deque()
        try:
            for log in logs:
                name = log.name if isinstance(log, Unread) else log.source
                running.append((name, pool.submit(ready, log)))
                if len(running) > 2 * threads:
                    first, future = running.popleft()
                    yield first, future.result()
            while running:
                first, future = running.popleft()
                yield first, future.result()
        finally:
            for _, future in running:
                future.cancel()


def settings_table(settings: FitSettings) -> dict[str, Any]:
    """Return name → value of the settings that the user of a batch can choose."""
    names = ("flank", "perfect_encoders", "perfect_gears", "delay", "drift_order")
    return {name: msgspec.to_builtins(getattr(settings, name)) for name in names}


class _Key(NamedTuple):
    """Properties that all logs of one call must share.

    `octave` is the bit length of the number of samples: logs of one call differ in length by less
    than a factor of two, so that padding wastes little time.
    """

    flanks: tuple[Flank, ...]
    terms: TermPlan
    octave: int


class _Waiting(NamedTuple):
    """A prepared log that waits for its call: row in the table (from 0), name, and arrays."""

    place: int
    name: str
    log: PreparedLog


@dataclass(eq=False)
class Batches:
    """Queue of the compiled programs: waiting logs, the running call, and finished table rows.

    JAX runs a program in the background, while Python prepares further logs.

    **Arguments**
    - `waiting`: logs that wait. - `sizes`: number of logs per call, for each key.
    - `running`: logs of the running call, and this call. - `rows`: finished rows by their place.
    - `count`: number of logs that were added.
    """

    progress: Callable[[int], None]
    settings: FitSettings
    pair: GearPair | Drive
    shapes: Shapes
    waiting: dict[_Key, list[_Waiting]] = field(default_factory=dict)
    sizes: dict[_Key, int] = field(default_factory=dict)
    running: tuple[list[_Waiting], Call] | None = None
    rows: dict[int, Row] = field(default_factory=dict)
    count: int = 0

    def add(self, name: str, ready: PreparedLog | Unread) -> None:
        """Add a prepared log; if its group is then full, start a call of the programs for it."""
        place = self._placed()
        if isinstance(ready, Unread):
            self._refuse(place, name, ready.error)
            return
        scope = ready.identifiable
        key = _Key(scope.flanks, scope.terms, ready.shape.samples.bit_length())
        group = self.waiting.setdefault(key, [])
        group.append(_Waiting(place, name, ready))
        if len(group) == logs_at_once(1 << key.octave):
            self._send(key)

    def _placed(self) -> int:
        self.count += 1
        return self.count - 1

    def _refuse(self, place: int, name: str, error: VttigError) -> None:
        code = Code.NEEDS_FIT if isinstance(error, NeedsFitError) else Code.REFUSED
        self._keep([(place, _failed(name, code, str(error).removeprefix(f"{name}: ")))])

    def finished(self) -> list[Row]:
        """Fit the logs that still wait, and return all rows in the order of the logs."""
        for key in list(self.waiting):
            self._send(key)
        self._collect()
        return [self.rows[place] for place in range(self.count)]

    def _send(self, key: _Key) -> None:
        """Wait for the running call, and start a call for the waiting logs of `key`.

        Two calls at the same time would block each other in LAPACK; see `upper_and_inverse`.
        """
        group = self.waiting.pop(key)
        # A later batch has the same number of logs as the first, so that its program is reused.
        most = self.sizes.setdefault(key, logs_at_once(1 << key.octave, len(group)))
        scope, shape = group[0].log.identifiable, group[0].log.shape
        model = batch_model(self.pair, scope.terms, scope.flanks, shape, self.settings)
        for start in range(0, len(group), most):
            part = group[start : start + most]
            self._collect()
            call = Call.of(model, [one.log for one in part], self.shapes, most)
            self.running = (part, call)

    def _collect(self) -> None:
        if self.running is None:
            return
        group, call = self.running
        self.running = None
        found = call.result()
        rows = []
        for number, one in enumerate(group):
            own = ArrayFit(*(values[number] for values in found))
            rows.append((one.place, self._row(one, call.model, own)))
        self._keep(rows)

    def _row(self, one: _Waiting, model: BatchModel, found: ArrayFit) -> Row:
        code = Code(int(found.code))
        if code is not Code.OK:
            return _failed(one.name, code, f"{code.reason}.")
        parameters = parameters_of(
            self.pair,
            one.log.identifiable,
            _solution(model, found),
            self.settings,
            delay_of(self.settings),
        )
        row = _cells(parameters)
        return row | {
            "log": one.name,
            "code": OK,
            "flanks": "".join(one.log.identifiable.flanks),
            "conditional_on": " ".join(self._conditions(one.log.identifiable)),
            "undetermined": " ".join(
                name for name, parameter in parameters.items() if not parameter.determined
            ),
            "samples_used": float(one.log.arrays.on_flank.sum()),
            "noise_order": float(found.order),
            "noise_std_deg": float(found.std) / DEG,
        }

    def _conditions(self, identifiable: Identifiability) -> tuple[str, ...]:
        """Return the assumptions of a row, by the names that `Fit.conditional_on` has."""
        split = is_split(identifiable, self.settings)
        parts = perfect_parts(self.pair, split, self.settings)
        return parts if isinstance(self.settings.delay, str) else (*parts, "given_delay")

    def _keep(self, rows: list[tuple[int, Row]]) -> None:
        self.rows |= dict(rows)
        self.progress(len(rows))


def parameter_names(pair: GearPair | Drive) -> tuple[str, ...]:
    """Return the names of the parameters in the table: those of a fit without the delay."""
    size = "amplitude_arcsec" if isinstance(pair, Drive) else "eccentricity_mm"
    gears = [f"{shaft}_{kind}" for shaft in SHAFTS for kind in (size, "phase_deg")]
    kinds = ("encoder_arcsec", "encoder_phase_deg")
    encoders = [f"{shaft}_{kind}" for shaft in SHAFTS for kind in kinds]
    return (*gears, "constant_backlash_deg", *encoders)


def delay_of(settings: FitSettings) -> Delay:
    """Return the delay for the result of a batch, in which the delay is given or off."""
    if isinstance(settings.delay, str):
        return Delay("off", reason="not fitted: both channels are sampled at the same instant")
    return Delay("given", settings.delay, reason=f"given as {settings.delay:g} s, not fitted")


def _solution(model: BatchModel, found: ArrayFit) -> Solution:
    sides = len(model.sides)
    return Solution(
        names=model.names,
        values=np.asarray(found.values),
        covariance=np.asarray(found.covariance),
        determined=np.ones(len(model.names), bool),
        tied=np.zeros((sides, 0)),
        jacobian=np.zeros((sides, 0, len(model.names))),
        converged=True,
        steps=0,
    )


def _failed(name: str, code: Code, reason: str) -> Row:
    return {"log": name, "code": code.name.lower(), "reason": reason}


def _cells(parameters: Mapping[str, Parameter]) -> Row:
    """Return the table cells of all parameters; values that are not significant are included."""
    row: Row = {}
    for name, found in parameters.items():
        numbers = (found.value, found.std, found.low95, found.high95)
        row |= {name + part: number for part, number in zip(PARTS, numbers, strict=True)}
    return row
