"""What a result has to state beside its numbers: machine, versions, threads, load."""

import datetime
import json
import os
import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
_PACKAGES = ("vttig-jax", "jax", "optimistix", "equinox", "numpy", "scipy")


def environment() -> dict[str, Any]:
    """Machine and versions; the load average tells whether others used the machine meanwhile."""
    return {
        "date": datetime.date.today().isoformat(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "cores_used": len(os.sched_getaffinity(0)),
        "blas_threads": os.environ.get("OPENBLAS_NUM_THREADS", "not set"),
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "python": platform.python_version(),
        **_versions(),
    }


def write(name: str, record: dict[str, Any]) -> None:
    """Write `record` with the environment as results/`name`."""
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps({"environment": environment(), **record}, indent=1, allow_nan=False)
    (RESULTS / name).write_text(text + "\n")


def _versions() -> dict[str, str]:
    """Versions of the packages that are installed; not every study needs all of them."""
    found = {}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()
