# ruff: noqa: E402 -- threads, import hook and 64-bit mode are set before the imports they affect
"""Setup and fixtures of all tests: 64-bit mode, checked annotations, threads, the paper's rig."""

import atexit
import ctypes
import gc
import os
import shutil
import tempfile

# The thread pools of linear algebra read these variables once, when numpy is imported.
for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# Test workers, notebooks and commands in separate processes share the compiled programs.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _programs = tempfile.mkdtemp(prefix="vttig-tests-")
    atexit.register(shutil.rmtree, _programs, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _programs
    # Most programs are small and compile in 30 ms; reading one from the folder takes a few ms.
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import jax
import jaxtyping
import pytest
from hypothesis import settings

from tests import checked_annotations

# This precedes the first import of the package: from here on, its annotations are checked at run
# time, at the first calls of every function in every test. The command line is not checked, because
# it imports some types only when a command runs, and beartype cannot resolve their names.
_PACKAGE = Path(__file__).resolve().parents[1] / "vttig_jax"
_ROOMS = {path.parent.name for path in _PACKAGE.glob("*/__init__.py")} - {"report", "cli"}
checked_annotations.install([f"vttig_jax.{room}" for room in sorted(_ROOMS)])

import scipy.linalg  # noqa: F401 -- its BLAS must be loaded before its threads are limited
from threadpoolctl import threadpool_limits

import vttig_jax

# In a single process, plugins import numpy before the variables above are set.
threadpool_limits(int(os.environ["OPENBLAS_NUM_THREADS"]), user_api="blas")
vttig_jax.enable_x64()
# Broadcasting between arrays of different rank is an error: the code adds axes explicitly.
jax.config.update("jax_numpy_rank_promotion", "raise")

from vttig_jax.pair.gear_pair import Eccentricities, Gear, GearPair

SELECTIONS = ("smoke", "portable")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Ignore test files that contain no test with the marker that the option -m selects."""
    marker = config.option.markexpr
    if marker not in SELECTIONS or not collection_path.match("test_*.py"):
        return None
    return f"pytest.mark.{marker}" not in collection_path.read_text(encoding="utf-8") or None


settings.register_profile(
    "vttig", derandomize=True, deadline=None, max_examples=25, database=None, print_blob=False
)
settings.load_profile("vttig")


_MOST = 0.35
"""Share of the machine's memory above which a test worker discards its compiled programs."""


_OBJECTS = 50_000
"""New objects after which Python searches for unused cycles, as in the command `vttig`."""


def pytest_collection_finish() -> None:
    """Exclude what exists before the first test, such as modules, from searches for unused cycles.

    With Python's threshold of 700 new objects, these searches take a twentieth of the time.
    """
    gc.freeze()
    gc.set_threshold(_OBJECTS, *gc.get_threshold()[1:])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Check annotations at the first calls of each function in this test and in its fixtures."""
    checked_annotations.next_test()


@pytest.fixture(scope="module", autouse=True)
def bounded_memory() -> Iterator[None]:
    """Discard the compiled programs after a module if the worker uses more than `_MOST`."""
    yield
    usage = Path("/proc/self/statm")
    if not usage.exists():  # not Linux: a worker grows to some 6 GB
        return
    if int(usage.read_text().split()[1]) > _MOST * os.sysconf("SC_PHYS_PAGES"):
        jax.clear_caches()
        gc.collect()
        with suppress(AttributeError):  # a C library without this function returns memory itself
            ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(scope="session")
def paper_pair() -> GearPair:
    """Gear pair of Table 1 of the paper."""
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
    """Eccentricities of Table 2 of the paper, and the constant backlash of its rig."""
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
    """Switch off the checks of annotations, which a user does not have either.

    This is for tests of errors for wrong arguments, and for studies that repeat code hundreds of
    times that other tests run with checks: the checks double the time of code on small arrays.
    """
    yield from _without_annotation_checks()


@pytest.fixture(scope="module")
def unchecked_module() -> Iterator[None]:
    """Switch off the checks of annotations for modules that run whole commands and examples.

    Other tests run each part of these commands with checks.
    """
    yield from _without_annotation_checks()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of measured logs beside the repository; without it, the test is skipped."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the measured logs are not on this machine (looked for {folder})")
    return folder
