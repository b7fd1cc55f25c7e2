# ruff: noqa: E402 -- threads, import hook and 64-bit mode are set before what they govern
"""What every test shares: double precision, checked annotations, quiet threads, the paper's rig."""

import atexit
import ctypes
import gc
import os
import shutil
import tempfile

# The linear algebra pools read these once, when numpy is imported.
for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# Workers, notebooks and commands in processes of their own share what one of them has compiled.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _programs = tempfile.mkdtemp(prefix="vttig-tests-")
    atexit.register(shutil.rmtree, _programs, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _programs
    # Most programs are small and compile in 30 ms; to read one back takes a few.
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import jax
import jaxtyping
import pytest
from hypothesis import settings

from tests import checked_annotations

# Before the first import of the package: its annotations are checked at run time from here on,
# at the first calls of every function in every test.
# The command line names types it imports only when a verb runs, which beartype cannot resolve.
ROOMS = (
    "base",
    "pair",
    "kinematics",
    "geometry",
    "logs",
    "rig",
    "identify",
    "posterior",
    "control",
    "plotting",
    "runs",
)
checked_annotations.install([f"vttig_jax.{room}" for room in ROOMS])

import scipy.linalg  # noqa: F401 -- its BLAS is there before the threads are limited
from threadpoolctl import threadpool_limits

import vttig_jax

# In a single process, plugins import numpy before the variables above are set.
threadpool_limits(int(os.environ["OPENBLAS_NUM_THREADS"]), user_api="blas")
vttig_jax.enable_x64()
# Arrays of different rank do not broadcast: the code names the axes that it adds.
jax.config.update("jax_numpy_rank_promotion", "raise")

from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.pair.gear_pair import Gear, GearPair

SELECTIONS = ("smoke", "portable")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import test files that have no test of the selection that is asked for."""
    marker = config.option.markexpr
    if marker not in SELECTIONS or not collection_path.match("test_*.py"):
        return None
    return f"pytest.mark.{marker}" not in collection_path.read_text(encoding="utf-8") or None


settings.register_profile(
    "vttig", derandomize=True, deadline=None, max_examples=25, database=None, print_blob=False
)
settings.load_profile("vttig")


_MOST_BYTES = 3 << 30
"""Memory beyond which a worker of the tests lets go of the programs it has compiled."""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Check the annotations at the first calls of this test, those of its fixtures included."""
    checked_annotations.next_test()


@pytest.fixture(scope="module", autouse=True)
def bounded_memory() -> Iterator[None]:
    """Forget compiled programs, some megabytes each, when they have become many."""
    yield
    usage = Path("/proc/self/statm")
    if not usage.exists():  # not Linux: a worker grows to some 6 GB
        return
    if int(usage.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > _MOST_BYTES:
        jax.clear_caches()
        gc.collect()
        with suppress(AttributeError):  # a C library that gives memory back by itself
            ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(scope="session")
def paper_pair() -> GearPair:
    """Table 1 of the paper."""
    return GearPair(
        Gear(45, 3.0, 3.0, 20.0),
        Gear(80, 3.0, 3.0, 20.0),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=125.12,
        name="VTTIG rig",
    )


@pytest.fixture(scope="session")
def paper_rig() -> Eccentricities:
    """Table 2 of the paper with its constant backlash."""
    return Eccentricities(
        driving_mm=0.0226,
        driving_phase_deg=49.5,
        driven_mm=0.0273,
        driven_phase_deg=79.3,
        constant_backlash_deg=0.038,
    )


def _without_annotation_checks() -> Iterator[None]:
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Annotations are not checked, as for a user.

    For tests of what a wrong argument then meets, and for studies that repeat hundreds of times
    what other tests run with checks: the checks double the time of code on small arrays.
    """
    yield from _without_annotation_checks()


@pytest.fixture(scope="module")
def unchecked_module() -> Iterator[None]:
    """As `unchecked`, for modules that run whole commands and examples as a user does.

    Other tests check each part of what they call.
    """
    yield from _without_annotation_checks()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of measured logs beside the repository; the test is skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the measured logs are not on this machine (looked for {folder})")
    return folder
