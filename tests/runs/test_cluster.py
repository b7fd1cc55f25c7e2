"""Blocks of a sweep on two worker processes, one of which is killed."""

import os
import signal
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vttig_jax
from tests.control.scenarios import PAIR
from tests.control.sweep_files import assert_close, small_blocks, sweep_spec
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.runs import elsewhere, sweeps
from vttig_jax.runs.row_store import PARTS

distributed = pytest.importorskip("distributed", reason="needs the extra [dask]")

AXES = {"motion.reversal_deg": {"from": 200, "to": 350, "num": 32}}
FEW = {"motion.reversal_deg": [200.0, 250.0, 300.0, 360.0]}
"""As many lanes as the sweeps of `test_sweep.py` have, so that the compiled programs are shared."""

SMALL = 4
QUIET: dict[str, Any] = {"dashboard_address": None, "silence_logs": 50}
LOCAL: dict[str, Any] = {"protocol": "tcp://", "host": "127.0.0.1", **QUIET}


@pytest.mark.slow
def test_a_lost_worker_costs_nothing_but_time(tmp_path, monkeypatch):
    """Two processes that import JAX and compile, one of them twice: that takes its time."""
    small_blocks(SMALL, monkeypatch)
    spec = sweep_spec(AXES, controller="none")
    expected = vttig_jax.sweep(spec, PAIR)
    root = str(Path(__file__).parents[2])
    monkeypatch.setenv("PYTHONPATH", root)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **QUIET) as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            client.register_worker_callbacks(partial(small_blocks, SMALL))
            victim = next(iter(client.run(os.getpid).values()))
        killed: list[int] = []

        def kill() -> None:
            while not list((tmp_path / "swept" / PARTS).glob("[0-9]*.parquet")):
                time.sleep(0.01)
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        table = vttig_jax.sweep(spec, PAIR, out=tmp_path / "swept", dask=cluster.scheduler_address)
        killer.join()
    assert killed == [victim]
    for name in METRICS:  # workers compile with other options of XLA
        assert_close(table.columns[name], expected.columns[name])
    for name in ("case", "motion.reversal_deg", "outcome"):
        np.testing.assert_array_equal(table.columns[name], expected.columns[name])
    assert table.lane_steps == expected.lane_steps and table.devices == 2


def test_no_scheduler_and_no_extra_are_said(monkeypatch):
    monkeypatch.setattr(elsewhere, "_WAIT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense://1"):
        with pytest.raises(InputError, match="no scheduler answers") as caught:
            vttig_jax.sweep(sweep_spec(FEW), PAIR, dask=address)
        assert caught.value.where == address
    monkeypatch.setattr(elsewhere, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install vttig-jax\[dask\]"):
        vttig_jax.sweep(sweep_spec(FEW), PAIR, dask="tcp://127.0.0.1:9")


def _nothing(number: int, recipe: object) -> None:
    """Stand in for a block of cases."""


def test_a_lost_scheduler_is_said(monkeypatch):
    """Its futures are neither finished nor failed, and they hold no exception."""
    lost = SimpleNamespace(status="lost", exception=lambda: None)
    monkeypatch.setattr(sweeps, "_block", _nothing)
    monkeypatch.setattr(distributed, "as_completed", lambda *_, **__: iter([(lost, None)]))
    with (
        distributed.LocalCluster(n_workers=1, processes=False, **LOCAL) as cluster,
        pytest.raises(InputError, match="the scheduler was lost") as caught,
    ):
        vttig_jax.sweep(sweep_spec(FEW), PAIR, dask=cluster.scheduler_address)
    assert "None" not in caught.value.message
