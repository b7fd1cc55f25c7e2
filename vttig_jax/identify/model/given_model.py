"""Flank model that the user gives: its parameters, their names, and its values with derivatives.

The model is a pytree with a method `transmission_error(angle, flank)`, for example an `eqx.Module`.
Its leaves that are arrays of floating-point numbers are the parameters θ. The fit passes over the
logs several times. Near the parameters θ₀ of one pass the transmission error is

    m(φ₁; θ) = m(φ₁; θ₀) + Σ_j (θ_j − θ₀_j) ∂m/∂θ_j,

so every derivative is a column of the block rows, and its coefficient is the step θ_j − θ₀_j.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from traceback import extract_tb
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.arrays import Numbers
from ...base.errors import NoAnswerError, UsageError
from ...base.units import DEG, REV
from ...kinematics.backlash_map import chunked
from ...kinematics.flank_model import flank_index
from ...pair.gear_pair import Flank
from .column_layout import GIVEN

_TRIED = np.array([0.0, 1.0])  # rad; angles at which a model is tried, chosen values
_PER_TURN = 2048
"""Angles per driving turn from which the highest order is measured: orders below 1024 (chosen)."""

_TURNS = 16  # driving turns from which the highest order is measured, at most; chosen value
_SHARE = 1e-4
"""Least share of the largest power in a spectrum for which an order counts: 1 % in amplitude."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Transmission error of a given model, rad, and its derivatives: one column per parameter."""

    value: Float[np.ndarray, " n"]
    slopes: Float[np.ndarray, "n p"]


@dataclass(frozen=True, eq=False)
class GivenModel:
    """Flank model of the user with the values of its parameters in one pass over the logs.

    **Arguments**
    - `tree`: the model as the user gave it.
    - `names`: names of its parameters, "model" and the path of the leaf.
    - `values`: values of the parameters in this pass.
    - `highest_order`: highest order of the model, cycles per driving turn.
    """

    tree: Any
    names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    highest_order: float = 1.0

    @classmethod
    def of(cls, model: Any) -> "GivenModel":
        """Check the model of the user, and return it with the values that its leaves hold.

        **Raises** `UsageError` for an object that is no flank model, for a model without
        parameters, for leaves that are neither parameters nor constants, and where the transmission
        error has the wrong shape or cannot be traced.
        """
        if isinstance(model, type):
            raise UsageError(
                f"{model.__name__} is a class; give an instance of it, with the start values.",
                where="model",
            )
        if not callable(getattr(model, "transmission_error", None)):
            raise UsageError(
                f"a {type(model).__name__} has no method `transmission_error(angle, flank)`; give"
                " an eqx.Module that has one.",
                where="model",
            )
        names = tuple(_names(model))
        if not names:
            raise UsageError(
                f"{type(model).__name__} has no parameters; make at least one field an array of"
                " floating-point numbers, for example with converter=jnp.asarray.",
                where="model",
            )
        _require_hash(model)
        given = cls(model, names, np.concatenate([_numbers(leaf) for leaf in _parameters(model)]))
        _require_shape(given)
        return given

    @property
    def name(self) -> str:
        """Name of the class of the model."""
        return type(self.tree).__name__

    def at(self, values: Float[np.ndarray, " p"]) -> "GivenModel":
        """Return the model with other values of the parameters."""
        return replace(self, values=np.asarray(values, np.float64))

    def updated(self, names: Sequence[str], values: Float[np.ndarray, " q"]) -> "GivenModel":
        """Return the model with `values` for the parameters `names`; other names are ignored."""
        found = dict(zip(names, values, strict=True))
        kept = zip(self.names, self.values, strict=True)
        return self.at(np.array([found.get(name, value) for name, value in kept]))

    @property
    def fitted(self) -> Any:
        """The model of the user, with `values` in its leaves."""
        return _with_values(self.tree, np.asarray(self.values), np.asarray)

    def on(self, angle: Float[np.ndarray, " n"], flank: Flank, where: str = "") -> Linearised:
        """Return the transmission error, rad, and its derivatives at driving angles, rad.

        `where` is the source of the angles for a message; its samples are then counted from 1.

        **Raises** `NoAnswerError` naming the parameter, the flank and the angle where a value or a
        derivative is not finite.
        """
        side = flank_index(flank)
        table = chunked(lambda part: _linearised(self.tree, self.values, part, side), angle)
        table = table.reshape(len(angle), 1 + len(self.names))
        bad = np.argwhere(~np.isfinite(table))
        if len(bad):
            row, column = (int(number) for number in bad[0])
            what = f"derivative by {self.names[column - 1]}" if column else "value"
            raise NoAnswerError(
                f"the flank model {self.name} has no finite {what} on flank {flank} at the driving"
                f" angle {angle[row] / DEG:.6g}°{f' (sample {row + 1})' if where else ''}; write it"
                " so that it is smooth there, or start from other values.",
                where=where or "model",
            )
        return Linearised(table[:, 0], table[:, 1:])

    def resolved(self, first: float, turns: float) -> "GivenModel":
        """Return the model with its `highest_order`, in cycles per driving turn.

        It is the highest frequency with at least 1e-4 of the largest power in the spectrum of the
        transmission error or of a derivative. The spectra are taken over `turns` driving turns, at
        most 16, from the driving angle `first`, rad.
        """
        count = int(_PER_TURN * np.clip(np.ceil(turns), 1, _TURNS))
        angle = first + np.arange(count) * REV / _PER_TURN
        highest = 1.0
        for flank in ("A", "B"):
            found = self.on(angle, flank)
            table = np.column_stack([found.value, found.slopes])
            window = np.hanning(count)[:, None]
            table = (table - table.mean(axis=0)) * window
            power = np.abs(np.fft.rfft(table, axis=0)) ** 2
            large = np.any(power > _SHARE * power.max(axis=0), axis=1) & (power.max() > 0)
            highest = max(highest, float(np.flatnonzero(large).max(initial=0)) * _PER_TURN / count)
        return replace(self, highest_order=highest)


def error_of(
    model: Any, values: Float[Numbers, " p"], angle: Float[Numbers, " n"], side: int
) -> Any:
    """Return the transmission error of a model with other values of its parameters, rad.

    `side` is 0 for flank A and 1 for flank B. The result is what the method of the user returns:
    one number per angle if the model is correct.
    """
    own = _with_values(model, jnp.asarray(values), lambda part: part)
    return own.transmission_error(angle, "AB"[side])


@eqx.filter_jit
def _linearised(
    model: Any, values: Float[Numbers, " p"], angle: Float[Numbers, " n"], side: int
) -> Float[Numbers, "n columns"]:
    """Return the transmission error (first column) and its derivatives by the parameters."""
    error = lambda some: error_of(model, some, angle, side)  # noqa: E731
    return jnp.column_stack([error(values), jax.jacfwd(error)(jnp.asarray(values))])


def _is_parameter(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic) and jnp.issubdtype(
        leaf.dtype, jnp.floating
    )


def _parameters(model: Any) -> list[Any]:
    return [leaf for leaf in jax.tree.leaves(model) if _is_parameter(leaf)]


def _numbers(leaf: Any) -> Float[np.ndarray, " count"]:
    return np.asarray(leaf, np.float64).ravel()


def _with_values(model: Any, values: Any, convert: Callable[[Any], Any]) -> Any:
    """Return the model with the parameters taken one after the other from the vector `values`.

    `convert` is applied to the new value of every leaf.
    """
    leaves, tree = jax.tree.flatten(model)
    start, found = 0, []
    for leaf in leaves:
        if _is_parameter(leaf):
            count = int(np.prod(leaf.shape))
            found.append(convert(values[start : start + count].reshape(leaf.shape)))
            start += count
        else:
            found.append(leaf)
    return jax.tree.unflatten(tree, found)


def _names(model: Any) -> Iterator[str]:
    """Yield the name of every scalar parameter, for example "model.tilt" or "model.waves[2]".

    **Raises** `UsageError` for a leaf that may be meant as a parameter but is none.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(model):
        name = GIVEN + jax.tree_util.keystr(path)
        if _is_parameter(leaf):
            places = np.ndindex(np.shape(leaf))
            yield from (
                f"{name}[{', '.join(map(str, place))}]" if place else name for place in places
            )
        elif isinstance(leaf, float | complex) or np.iscomplexobj(leaf):
            kind = "a Python float" if isinstance(leaf, float) else "a complex number"
            raise UsageError(
                f"the leaf is {kind}, so that it is unclear whether it is fitted; make it an array"
                " of floating-point numbers to fit it, or a static field to keep it.",
                where=name,
            )


def _require_hash(model: Any) -> None:
    """Raise `UsageError` for a model with a constant that has no hash, which JAX needs."""
    try:
        hash(jax.tree.structure(model))
        for leaf in jax.tree.leaves(model):
            if not isinstance(leaf, jax.Array | np.ndarray):
                hash(leaf)
    except TypeError as error:
        raise UsageError(
            f"a static field of {type(model).__name__} has no hash ({error}); write it as a tuple"
            " or another constant.",
            where="model",
        ) from None


def _failure(error: Exception, flank: str) -> str:
    """Return what an error in a function of the user says and where, and the cure."""
    last = extract_tb(error.__traceback__)[-1]
    place = f"{PurePath(last.filename).name}, line {last.lineno}"
    seen = f"({type(error).__name__}: {str(error).partition(chr(10))[0]}, in {place})"
    if isinstance(error, jax.errors.JAXTypeError) or "truth value" in str(error):
        return (
            f"cannot be traced by JAX on flank {flank} {seen}; write it with jax.numpy and without"
            " conditions on the angle or a parameter"
        )
    return f"fails on flank {flank} {seen}; it is called as transmission_error(angle, flank)"


def _require_shape(given: GivenModel) -> None:
    """Raise `UsageError` unless the transmission error is real and has the shape of the angles."""
    for side, flank in enumerate("AB"):
        tried = lambda values, angle, side=side: error_of(given.tree, values, angle, side)  # noqa: E731
        try:
            found = jax.eval_shape(tried, given.values, _TRIED)
        except Exception as error:
            raise UsageError(
                f"`transmission_error` of {given.name} {_failure(error, flank)}.", where="model"
            ) from error
        shape, dtype = getattr(found, "shape", None), getattr(found, "dtype", None)
        if shape != _TRIED.shape or dtype != np.float64:
            raise UsageError(
                f"`transmission_error` of {given.name} returns {_kind(shape, dtype)} on flank"
                f" {flank} for {len(_TRIED)} angles; return one float64 number an angle, in rad.",
                where="model",
            )


def _kind(shape: Any, dtype: Any) -> str:
    return "no array" if shape is None else f"{dtype} of shape {tuple(shape)}"
