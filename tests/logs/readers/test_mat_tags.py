import contextlib
import io
import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from scipy.io.matlab import matfile_version

from vttig_jax.logs.readers.binary.matlab import HEADER, check_tags

DATA = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"


def sound(path):
    """Whether SciPy reads a file, and its tags are what is checked."""
    try:
        scipy.io.loadmat(path)
    except Exception:
        return False
    return matfile_version(io.BytesIO(path.read_bytes()))[0] == 1


@pytest.mark.filterwarnings("ignore")
def test_files_that_scipy_reads_pass():
    """The files SciPy is tested with, written by MATLAB 5 to 7.5 and others."""
    stored = [path for path in sorted(DATA.glob("*.mat")) if sound(path)]
    if not stored:
        pytest.skip("this SciPy comes without its test data")
    for path in stored:
        check_tags(path.read_bytes())


def saved(**options):
    file = io.BytesIO()
    scipy.io.savemat(file, {"rec": {"t": np.arange(5) / 7, "z": np.array([1j, 2])}}, **options)
    return file.getvalue()


def test_sound_files():
    for data in (saved(), saved(do_compression=True), saved()[:HEADER]):
        check_tags(data)


@pytest.mark.parametrize(
    ("find", "change", "words"),
    [
        (struct.pack("<II", 9, 40), struct.pack("<II", 20, 40), "no array of numbers"),
        (struct.pack("<II", 9, 40), struct.pack("<II", 9, 400), "beyond the end"),
        (struct.pack("<III", 6, 8, 6), struct.pack("<III", 6, 8, 6 | 0x800), "no array"),
        (struct.pack("<III", 6, 8, 6), struct.pack("<III", 6, 8, 99), "class 99"),
        (struct.pack("<III", 6, 8, 6), struct.pack("<III", 6, 4, 6), "no flags"),
    ],
)
def test_damage_is_seen(find, change, words):
    data = saved()
    assert find in data
    data = data.replace(find, change, 1)
    with pytest.raises(ValueError, match=words):
        check_tags(data)


@given(st.binary(max_size=64))
def test_any_bytes_end_in_one_error_or_none(content):
    with contextlib.suppress(ValueError):
        check_tags(saved()[:HEADER] + content)


def test_other_elements_at_the_top():
    data = saved()
    with pytest.raises(ValueError, match="type 3 at byte 128"):
        check_tags(data[:HEADER] + b"\x03" + data[HEADER + 1 :])
