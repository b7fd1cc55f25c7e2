"""A thousand logs of 18 000 samples, fitted in batches, beside SciPy in a loop.

    python -m benchmarks.many_fits [--logs 1000] [--peers 5] [--platform cpu]

Every log is of the rig of the paper with encoders, pitch orders and mesh, forward and back at 120
rpm: 40 columns on two flanks. First the parameters of the batch are compared with those of
`vttig_jax.fit` (the gate, 0.01 standard errors). Then these are timed, in process time and in
wall time:

- arrays: `fit_batch` of arrays that were prepared before, compiled; and its compilation;
- logs: `vttig_jax.fit_many` of encoder logs, which finds flanks, slips and outliers too;
- SciPy: `scipy.optimize.least_squares` (trf, exact Jacobian) on the samples of one log after the
  other: two offsets, amplitude and phase of gears and encoders to first order, and the free orders
  of each flank; white noise.

The noise of a log is drawn from its number; eight noises are drawn with the rig's exact kinematics
and the others are their sums with further noise. Writes results/many_fits.json.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from scipy.optimize import least_squares

import vttig_jax
from vttig_jax.identify import LogArrays, fit_batch, prepared
from vttig_jax.rig import PassMotion, paper_rig

from .environment import write

LAGS = 8
"""Lags that the noise of these logs needs; `fit_many` counts them itself."""

CHUNK = 50  # logs of a call of the compiled program
DRAWN = 8  # logs with exact kinematics
MOTION = PassMotion(speed_rpm=120.0, reversal_deg=2835.0, dwell_s=0.3, ramp_s=0.3)
"""18 157 samples at 1987 Hz."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--peers", type=int, default=5, help="logs that SciPy fits")
    parser.add_argument("--platform", choices=("cpu", "gpu"), default="cpu")
    chosen = parser.parse_args()
    jax.config.update("jax_platforms", chosen.platform if chosen.platform == "cpu" else "cuda")
    vttig_jax.enable_x64()
    rig = paper_rig(0, MOTION)
    logs = [rig.log(seed) for seed in range(DRAWN)]
    model, arrays = prepared(logs, rig.pair, lags=LAGS)
    batches = [_batch(arrays, start, chosen.logs) for start in range(0, chosen.logs, CHUNK)]
    fit = jax.jit(lambda logs: fit_batch(model, logs))
    record: dict[str, Any] = {"logs": chosen.logs, "samples": model.shape.samples}
    record["compile"], compiled = _timed(lambda: fit.lower(batches[0]).compile())
    record["gate_standard_errors"] = _gate(compiled(batches[0]), logs, rig.pair)
    assert record["gate_standard_errors"] < 0.01
    record["arrays"], found = _timed(lambda: [jax.block_until_ready(compiled(b)) for b in batches])
    codes = np.concatenate([np.asarray(one.code) for one in found])[: chosen.logs]
    assert not codes.any(), np.unique(codes)
    few = logs * max(1, min(chosen.logs, 64) // DRAWN)
    vttig_jax.fit_many(few, rig.pair)
    record["logs_each"], _ = _timed(lambda: vttig_jax.fit_many(few, rig.pair), len(few))
    single = {"delay": "off", "drift_order": 0, "loss": "square", "lines": "report"}
    some = logs[: chosen.peers]
    record["fit_each"], _ = _timed(
        lambda: [vttig_jax.fit(log, rig.pair, **single) for log in some], len(some)
    )
    peers = [
        _Peer(np.asarray(model.orders), jax.tree.map(lambda x, k=k: x[k], arrays))
        for k in range(DRAWN)
    ]
    record["scipy_each"], _ = _timed(
        lambda: [peer.solved() for peer in peers[: chosen.peers]], chosen.peers
    )
    each = record["arrays"]["process_s"] / chosen.logs
    record["scipy_over_arrays"] = record["scipy_each"]["process_s"] / each
    record["fit_over_arrays"] = record["fit_each"]["process_s"] / each
    record["device"] = str(jax.devices()[0])
    write("many_fits.json", record)
    for name, value in record.items():
        print(f"{name}: {value}")


def _timed(work: Callable[[], Any], share: int = 1) -> tuple[dict[str, float], Any]:
    """Process and wall time of one of `share` equal parts of the work, and its result."""
    process, wall = time.process_time(), time.perf_counter()
    result = work()
    spent = time.process_time() - process, time.perf_counter() - wall
    return {"process_s": spent[0] / share, "wall_s": spent[1] / share}, result


def _gate(found: Any, logs: list, pair: Any) -> float:
    """Largest difference from `vttig_jax.fit` of the drawn logs, in standard errors."""
    worst = 0.0
    for number, log in enumerate(logs):
        options = {"delay": "off", "drift_order": 0, "loss": "square", "lines": "report"}
        single = vttig_jax.fit(log, pair, **options)
        std = np.sqrt(np.diag(single.covariance))
        worst = max(worst, float(np.abs((found.values[number] - single.values) / std).max()))
    return worst


def _batch(arrays: LogArrays, start: int, logs: int) -> LogArrays:
    """Logs number `start` … of the batch: drawn ones, and these with further noise."""
    numbers = np.arange(start, start + CHUNK) % max(logs, CHUNK)
    batch = jax.tree.map(lambda x: np.asarray(x)[numbers % DRAWN], arrays)
    driven = np.array(batch.driven)
    for place, number in enumerate(numbers.tolist()):
        if number >= DRAWN:
            driven[place] += 1e-5 * np.random.default_rng(number).normal(size=driven.shape[1])
    return batch._replace(driven=driven)


class _Peer:
    """Least squares of the samples of one log: 10 parameters and 30 free columns a flank."""

    def __init__(self, orders: np.ndarray, log: LogArrays) -> None:
        error = log.driven - 9 / 16 * log.driving
        self.flanks = []
        for sign, mask in zip((1.0, -1.0), log.on_flank, strict=True):
            phase = orders[:, :1] * log.driving[mask] + orders[:, 1:] * log.driven[mask]
            columns = np.concatenate([np.cos(phase), np.sin(phase)]).T
            self.flanks.append((sign, columns, error[mask]))
        self.terms = len(orders)

    def solved(self) -> Any:
        """The solution from small amplitudes."""
        start = np.full(self._width, 1e-4)
        exact: Any = self._jacobian
        return least_squares(self._residual, start, jac=exact, method="trf", x_scale="jac")

    @property
    def _width(self) -> int:
        free = 2 * (self.terms - 4)
        return 10 + 2 * free

    def _residual(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [self._flank(values, place)[0] - self.flanks[place][2] for place in (0, 1)]
        )

    def _jacobian(self, values: np.ndarray) -> np.ndarray:
        return np.concatenate([self._flank(values, place)[1] for place in (0, 1)])

    def _flank(self, values: np.ndarray, place: int) -> tuple[np.ndarray, np.ndarray]:
        """Prediction and Jacobian; the first orders are amplitude · sin(angle + phase)."""
        sign, columns, _ = self.flanks[place]
        terms, free = self.terms, self.terms - 4
        jacobian = np.zeros((len(columns), self._width))
        predicted = np.full(len(columns), values[0])
        jacobian[:, 0] = 1.0
        if place == 1:
            predicted += values[1]
            jacobian[:, 1] = 1.0
        for number in range(4):
            shaft = free + number % 2
            cosine, sine = columns[:, shaft], columns[:, terms + shaft]
            # Gears act on the flanks with opposite sense, encoders with the same.
            turned = 0.35 * sign if number < 2 else 0.0
            amplitude, phase = values[2 + 2 * number : 4 + 2 * number]
            wave = sine * np.cos(phase + turned) + cosine * np.sin(phase + turned)
            slope = cosine * np.cos(phase + turned) - sine * np.sin(phase + turned)
            predicted += amplitude * wave
            jacobian[:, 2 + 2 * number] = wave
            jacobian[:, 3 + 2 * number] = amplitude * slope
        own = np.concatenate([columns[:, :free], columns[:, terms : terms + free]], axis=1)
        cells = slice(10 + 2 * free * place, 10 + 2 * free * (place + 1))
        jacobian[:, cells] = own
        return predicted + own @ values[cells], jacobian


if __name__ == "__main__":
    main()
