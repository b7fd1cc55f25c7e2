"""The numeric arrays of a MATLAB file (v4 to v7), with the names MATLAB gives them."""

import io
import warnings
from collections.abc import Callable, Iterator
from inspect import signature
from typing import Any

import numpy as np

from .mat_tags import check_tags

DEEPEST = 16
"""Levels of structs and cells that are looked into."""

MOST_CELLS = 1000
"""Cells and structs of one array that are looked into."""


def matlab_leaves(data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of every array of numbers in the bytes of a file.

    Fields of structs are `s.f`, of arrays of structs `s(2).f`, cells `c{2}`. Objects (tables,
    time series, functions), text, complex and sparse arrays are passed over. Damaged bytes raise
    whatever `scipy.io.loadmat` stumbles over.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadWarning, matfile_version

    if matfile_version(io.BytesIO(data))[0] == 1:  # 0 is v4, which has no tags
        check_tags(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # objects share the name "None"
        variables = loadmat(io.BytesIO(data), **_sparse_as(loadmat))
    for name, value in variables.items():
        if not name.startswith("__"):
            yield from _leaves(name, value, 0)


def _sparse_as(loadmat: Callable[..., dict]) -> dict[str, bool]:
    """What newer versions of SciPy want to be told of sparse arrays, which are passed over."""
    return {"spmatrix": False} if "spmatrix" in signature(loadmat).parameters else {}


def _leaves(path: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    # Objects and functions are subclasses of `ndarray`.
    if type(value) is not np.ndarray or depth > DEEPEST:
        return
    if value.dtype.kind in "biuf":
        yield path, value
    elif value.dtype.names and value.size <= MOST_CELLS:
        for k, record in enumerate(value.ravel(order="F"), 1):
            here = path if value.size == 1 else f"{path}({k})"
            for field in value.dtype.names:
                yield from _leaves(f"{here}.{field}", record[field], depth + 1)
    elif value.dtype == object and value.size <= MOST_CELLS:
        for k, cell in enumerate(value.ravel(order="F"), 1):
            yield from _leaves(f"{path}{{{k}}}", cell, depth + 1)
