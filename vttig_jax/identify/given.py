"""Flank model that the user gives: its parameters, their search, and the model that a fit makes.

The model is a pytree with a method `transmission_error(angle, flank)`, for example an `eqx.Module`.
Its leaves that are arrays of floating-point numbers are the parameters θ. Near the parameters θ₀ of
one fit the transmission error is

    m(φ₁; θ) = m(φ₁; θ₀) + Σ_j (θ_j − θ₀_j) ∂m/∂θ_j,

so every derivative is a column of the rows, and its coefficient is the step θ_j − θ₀_j. Levenberg
and Marquardt's method finds the start of these fits: it minimises |y − m(θ) − Z q| over the rows,
where linear least squares gives the best coefficients q of all other columns Z for every θ
(variable projection: Golub and Pereyra 1973).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from traceback import extract_tb
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real
from scipy.linalg import qr

from ..base.arrays import Numbers
from ..base.errors import NoAnswerError, UsageError
from ..base.numerics.counting import pieces
from ..base.units import DEG, REV
from ..kinematics.backlash_map import chunked
from ..kinematics.flank_error import FlankError
from ..kinematics.flank_model import FlankModel, GridOrders, ImplicitModel
from ..kinematics.harmonic import OrderModel
from ..model.columns import Assumptions, ColumnName, design_of
from ..model.mixed_fit import MixedFit, combined
from ..model.parameter import Parameter
from ..model.parameters import Quantities
from ..model.rows import SHAFTS, Extra, RowName, Rows, S, Shafts
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import Flank, HarmonicOrders
from .fit_settings import FitSettings

GIVEN_INSTEAD = "not fitted: the given flank model takes the place of the exact relation"

_TRIED = np.array([0.0, 1.0])  # rad; angles at which a model is tried, chosen values
_PER_TURN = 2048
"""Angles per driving turn from which the highest order is measured: orders below 1024 (chosen)."""

_TURNS = 16  # driving turns from which the highest order is measured, at most; chosen value
_SHARE = 1e-4
"""Least share of the largest power in a spectrum for which an order counts: 1 % in amplitude."""


_PIECE = 1 << 16
_RANK, _SETTLED, _MOST_FITS, _MOST_STEPS = 1e-6, 0.1, 12, 200


@dataclass(frozen=True, eq=False)
class GivenModel(Extra):
    """Flank model of the user with the values of its parameters in one pass over the logs.

    **Arguments**
    - `tree`: the model as the user gave it.
    - `names`: names of its parameters, "model" and the path of the leaf.
    - `values`: values of the parameters in this pass.
    - `highest_order`: highest order of the model, cycles per driving turn.
    - `open_reasons`: parameters that the logs do not tell, which keep their values, and why.
    """

    tree: Any
    names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    highest_order: float = 1.0
    open_reasons: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, model: Any) -> "GivenModel":
        """Check the model of the user, and return it with the values that its leaves hold.

        **Raises** `UsageError` for an object that is no flank model, for a model without
        parameters, for leaves that are neither parameters nor constants, and where the transmission
        error has the wrong shape or cannot be traced.
        """
        kind = type(model).__name__
        if isinstance(model, type):
            wrong = f"{model.__name__} is a class; give an instance of it, with the start values."
        elif not callable(getattr(model, "transmission_error", None)):
            wrong = f"a {kind} has no method `transmission_error(angle, flank)`; give an eqx.Module"
            wrong += " that has one."
        elif names := tuple(_names(model)):
            given = cls(model, names, np.asarray(_split(model)[0]))
            _require_shape(given)
            return given
        else:
            wrong = f"{kind} has no parameters; make at least one field an array of floating-point"
            wrong += " numbers, for example with converter=jnp.asarray."
        raise UsageError(wrong, where="model")

    @property
    def name(self) -> str:
        """Name of the class of the model."""
        return type(self.tree).__name__

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the parameters that the logs tell."""
        lost = dict(self.open_reasons)
        return tuple(name for name in self.names if name not in lost)

    def at(self, values: Any) -> "GivenModel":
        """Return the model with other values of the parameters."""
        return replace(self, values=np.asarray(values, np.float64))

    @property
    def fitted(self) -> Any:
        """The model of the user, with `values` in its leaves."""
        return _split(self.tree)[1](jnp.asarray(self.values))

    def on(self, angle: Float[np.ndarray, " n"], flank: Flank) -> Float[np.ndarray, "n columns"]:
        """Return the transmission error, rad, and its derivatives at driving angles, rad.

        **Raises** `NoAnswerError` naming the parameter, the flank and the angle where a value or a
        derivative is not finite.
        """
        table = chunked(lambda part: _linearised(self.tree, self.values, part, flank), angle)
        table = table.reshape(len(angle), 1 + len(self.names))
        bad = np.argwhere(~np.isfinite(table))
        if len(bad):
            row, column = (int(number) for number in bad[0])
            what = f"derivative by {self.names[column - 1]}" if column else "value"
            raise NoAnswerError(
                f"the flank model {self.name} has no finite {what} on flank {flank} at the driving"
                f" angle {angle[row] / DEG:.6g}°; write it so that it is smooth there, or start"
                " from other values.",
                where="model",
            )
        return table

    def with_derivatives(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns, less the transmission error."""
        moved, _ = shafts.delayed(delay_s)
        size = rows.samples.shape[1]
        kept = [0, *(1 + self.names.index(name) for name in self.told)]
        table = np.empty((len(rows.table), len(kept)))
        for flank in S:
            own = np.flatnonzero(rows.flank == flank)
            for part in pieces(len(own), max(1, _PIECE // size)):
                found = self.on(moved[rows.samples[own[part]]].ravel(), flank)
                found = found.reshape(-1, size, found.shape[1]).mean(1)
                table[own[part]] = found[:, kept]
        readings = rows.table[:, -1] - table[:, 0]
        rows = replace(rows, table=np.column_stack([rows.table[:, :-1], readings]))
        names = [RowName("given", name) for name in self.told]
        return rows.with_columns(dict(zip(names, table[:, 1:].T, strict=True)))

    def resolved(self, first: float, turns: float) -> "GivenModel":
        """Return the model with its `highest_order`, in cycles per driving turn.

        It is the highest frequency with at least 1e-4 of the largest power in the spectrum of the
        transmission error or of a derivative. The spectra are taken over `turns` driving turns, at
        most 16, from the driving angle `first`, rad.
        """
        count = int(_PER_TURN * np.clip(np.ceil(turns), 1, _TURNS))
        angle = first + np.arange(count) * REV / _PER_TURN
        highest = 1.0
        for flank in S:
            table = self.on(angle, flank)
            window = np.hanning(count)[:, None]
            table = (table - table.mean(axis=0)) * window
            power = np.abs(np.fft.rfft(table, axis=0)) ** 2
            large = np.any(power > _SHARE * power.max(axis=0), axis=1) & (power.max() > 0)
            highest = max(highest, float(np.flatnonzero(large).max(initial=0)) * _PER_TURN / count)
        return replace(self, highest_order=highest)


def error_of(
    model: Any, values: Float[Numbers, " p"], angle: Float[Numbers, " n"], flank: Flank
) -> Any:
    """Return the transmission error of a model with other values of its parameters, rad.

    The result is what the method of the user returns: one number per angle if the model is correct.
    """
    return _split(model)[1](jnp.asarray(values)).transmission_error(angle, flank)


@eqx.filter_jit
def _linearised(
    model: Any, values: Float[Numbers, " p"], angle: Float[Numbers, " n"], flank: Flank
) -> Float[Numbers, "n columns"]:
    """Return the transmission error (first column) and its derivatives by the parameters."""
    error = lambda some: error_of(model, some, angle, flank)  # noqa: E731
    return jnp.column_stack([error(values), jax.jacfwd(error)(jnp.asarray(values))])


def _split(model: Any) -> tuple[Float[Array, " p"], Callable[[Any], Any]]:
    """Return the values of the parameters, and the function that puts others in their place."""
    numbers, constants = eqx.partition(model, eqx.is_inexact_array)
    values, whole = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), numbers))
    return values, lambda values: eqx.combine(whole(values), constants)


def _names(model: Any) -> Iterator[str]:
    """Yield the name of every scalar parameter, for example "model.tilt" or "model.waves[2]".

    **Raises** `UsageError` for a leaf that may be meant as a parameter but is none.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(model):
        name = "model" + jax.tree_util.keystr(path)
        if eqx.is_inexact_array(leaf) and not np.iscomplexobj(leaf):
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


def _require_shape(given: GivenModel) -> None:
    """Raise `UsageError` unless the transmission error is real and has the shape of the angles."""
    for flank in S:
        method = f"`transmission_error` of {given.name}"
        try:
            constants = eqx.filter(given.tree, eqx.is_array_like, inverse=True)
            hash((jax.tree.structure(given.tree), *jax.tree.leaves(constants)))  # as JAX needs it
            found = jax.eval_shape(partial(error_of, given.tree, flank=flank), given.values, _TRIED)
        except Exception as error:
            last = extract_tb(error.__traceback__)[-1]
            place = f"{PurePath(last.filename).name}, line {last.lineno}"
            seen = f"({type(error).__name__}: {str(error).partition(chr(10))[0]}, in {place})"
            raise UsageError(
                f"{method} fails on flank {flank}, where JAX traces it {seen}; it is called as"
                " transmission_error(angle, flank): write it with jax.numpy and without conditions"
                " on the angle or a parameter, and static fields as tuples or other constants.",
                where="model",
            ) from error
        shape, dtype = getattr(found, "shape", None), getattr(found, "dtype", None)
        if shape != _TRIED.shape or dtype != np.float64:
            kind = "no array" if shape is None else f"{dtype} of shape {shape}"
            raise UsageError(
                f"{method} returns {kind} on flank {flank} for {len(_TRIED)} angles; return one"
                " float64 number an angle, in rad.",
                where="model",
            )


class _Misfit(eqx.Module):
    """Readings of rows less their projection on all other columns, whose basis is `columns`."""

    angles: tuple[Any, ...]
    readings: Float[Numbers, " rows"]
    columns: Float[Numbers, "rows q"]

    def slopes(self, given: GivenModel) -> tuple[Float[np.ndarray, "rows p"], np.ndarray]:
        """Return the derivatives beside the other columns, and their whole lengths."""
        parts = zip(self.angles, S, strict=True)
        whole = np.concatenate([given.on(angle, flank)[:, 1:] for angle, flank in parts])
        return whole - self.columns @ (self.columns.T @ whole), np.linalg.norm(whole, axis=0)


def prepared(
    model: Any, shafts: Sequence[Shafts], settings: FitSettings, *, one_zero: bool, where: str
) -> GivenModel:
    """Return the flank model of the user, ready to be fitted.

    **Raises** `UsageError` for an object that is no flank model, for settings of the exact relation
    and for logs without a common zero, whose angles have no common place in the model.
    """
    for name in ("perfect_encoders", "perfect_gears"):
        if getattr(settings, name):
            raise UsageError(
                f"{name} says what the exact relation contains, which `model` replaces; leave it"
                " out.",
                where="model",
            )
    if not one_zero:
        raise UsageError(
            "several logs with zeros of their own have no common angle at which to evaluate"
            " `model`; fit them one by one, or say same_zero=True if both encoders count whole"
            " turns from one zero in all of them.",
            where=where,
        )
    ends = [np.sort(one.driving[[r.start, r.stop - 1]]) for one in shafts for r in one.runs]
    first, last = max(ends, key=lambda pair: float(pair[1] - pair[0]), default=(0.0, REV))
    return GivenModel.of(model).resolved(float(first), float(last - first) / REV)


def searched(
    given: GivenModel,
    shafts: Sequence[Shafts],
    drive: Drive,
    orders: HarmonicOrders,
    assumed: Assumptions,
) -> GivenModel:
    """Return the flank model with the parameters of the smallest misfit of the rows.

    A parameter whose effect the other columns or other parameters explain leaves the parameters and
    keeps its value.
    """
    design = design_of(shafts, drive, orders, assumed=assumed, given=given)
    design = replace(design, given=None)  # rows as short as the flank model needs, without it
    columns = [c for c in design.columns if c.prior not in ("delay_parts", "gap_by_speed")]
    logs = design.rows(shafts)
    flank, angle = (np.concatenate([getattr(one, x) for one in logs]) for x in ("flank", "angle"))
    table = np.concatenate(combined(columns, logs, np.eye(len(columns) + 1)))
    table = table[np.argsort(flank, kind="stable")]  # as the angles: A, then B
    others, readings = table[:, :-1], table[:, -1]
    size = np.linalg.norm(others, axis=0)
    left, singular, _ = np.linalg.svd(others / np.where(size > 0, size, 1.0), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]]
    misfit = _Misfit(tuple(angle[flank == one] for one in S), readings, basis)
    slopes, whole = misfit.slopes(given)
    size = np.linalg.norm(slopes, axis=0)
    told = size > _RANK * whole
    unit = float(np.std(misfit.readings)) or 1.0
    scale = np.where(told, unit / np.where(told, size, 1.0), 0.0)
    values = np.asarray(_minimised(given.tree, given.values, scale, misfit))
    # The start stays where no parameters are better.
    return _told(given.at(values) if np.all(np.isfinite(values)) else given, misfit)


def _told(given: GivenModel, misfit: _Misfit) -> GivenModel:
    """Return the model whose names are the parameters that the rows tell."""
    slopes, whole = misfit.slopes(given)
    size = np.linalg.norm(slopes, axis=0)
    own = size > _RANK * whole
    scaled = slopes[:, own] / size[own]
    reasons: dict[str, str] = {}
    for place in np.flatnonzero(~own):
        reasons[given.names[place]] = (
            f"no sample depends on it; it stays at {given.values[place]:.6g}"
            if whole[place] <= 0
            else "offset, constant backlash or the free orders of the fit explain it as well; it"
            f" stays at {given.values[place]:.6g}"
        )
    if scaled.shape[1]:
        _, triangle, order = qr(scaled, mode="economic", pivoting=True)  # pyright: ignore
        for place in np.flatnonzero(own)[order[np.abs(np.diag(triangle)) < _RANK]]:
            reasons[given.names[place]] = "the data leave it open: other parameters explain it"
    return replace(given, open_reasons=tuple(reasons.items()))


@eqx.filter_jit
def _minimised(
    model: Any,
    start: Float[Numbers, " p"],
    scale: Float[Numbers, " p"],
    misfit: _Misfit,
) -> Float[Numbers, " p"]:
    """Return the parameters of the smallest misfit by Levenberg and Marquardt."""

    def left(scaled: Float[Numbers, " p"], _: None) -> Float[Numbers, " rows"]:
        own = start + scale * scaled
        error = [
            error_of(model, own, jnp.asarray(angle), flank)
            for angle, flank in zip(misfit.angles, S, strict=True)
        ]
        rest = misfit.readings - jnp.concatenate(error)
        return rest - misfit.columns @ (misfit.columns.T @ rest)

    solver, zero = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-9), jnp.zeros(len(start))
    found = optx.least_squares(left, solver, zero, max_steps=_MOST_STEPS, throw=False)
    return start + scale * found.value


def given_column(name: str) -> ColumnName:
    """Return the name of the column of a parameter of a flank model."""
    return ColumnName(RowName("given", name))


def fitted_given(
    given: GivenModel,
    shafts: Sequence[Shafts],
    fit: Callable[..., MixedFit],
    after: MixedFit | None = None,
) -> tuple[MixedFit, GivenModel]:
    """Fit the mixed model with the derivatives of a flank model until its parameters stand still.

    `fit` is a function of the logs, the flank model and the fit before.

    **Raises** `NoAnswerError` if they do not settle.
    """
    moved = {}
    for _ in range(_MOST_FITS):
        core = fit(shafts, given=given, after=after)
        moved = {
            name: core.posterior.one(core.posterior.row(given_column(name)), moved=True)
            for name in given.told
        }
        if all(abs(one.value) <= _SETTLED * one.std for one in moved.values()):
            return core, given
        steps = [moved[name].value if name in moved else 0.0 for name in given.names]
        given = given.at(given.values + steps)
        shafts, after = core.shafts, core
    worst = max(moved, key=lambda name: abs(moved[name].value) / moved[name].std)
    raise NoAnswerError(
        f"the flank model {given.name} does not settle: {worst} still moves by"
        f" {abs(moved[worst].value) / moved[worst].std:.3g} standard errors in fit {_MOST_FITS};"
        " start it from other values, or give it fewer parameters.",
        where="model",
    )


def given_quantities(core: MixedFit, told: Quantities, given: GivenModel) -> Quantities:
    """Return the numbers of a fit with those of its flank model."""
    rows = [core.posterior.row(given_column(name)) for name in given.told]
    values = dict(zip(given.names, given.values, strict=True))
    told = told.joined(given.told, rows, [values[name] for name in given.told])
    shift = told.shift.copy()
    if (angles := core.scope.covered).size and len(core.scope.flanks) == 2:
        error = [given.on(angles, flank)[:, 0].mean() for flank in S]
        for name in ("gap_over_angles_covered", "backlash_plus_delay"):
            if name in told.names:
                shift[told.at(name)] += error[1] - error[0]
    return replace(told, shift=shift)


def given_parameters(
    parameters: dict[str, Parameter], told: Quantities, pair: GearPair | Drive, given: GivenModel
) -> dict[str, Parameter]:
    """Return the parameters of a fit with those of its flank model under their names."""
    found: list[Parameter] = []
    for name, one in parameters.items():
        if name.startswith(SHAFTS):  # amplitudes and phases
            unit = one.unit
            if isinstance(pair, GearPair) and name.endswith("_amplitude_arcsec"):
                name, unit = name.replace("amplitude_arcsec", "eccentricity_mm"), "mm"
            one = Parameter(name, unit, reason=GIVEN_INSTEAD)
        found.append(one)
    lost = dict(given.open_reasons)
    for name in given.names:
        open_one = Parameter(name, "as given", reason=lost.get(name))
        found.append(open_one if name in lost else told.scalar(name, "as given"))
    return {one.name: one for one in found}


class FittedModel(ImplicitModel):
    """Sum of a given flank model with its fitted parameters, and of the free orders and offsets.

    The given model is a function of the driving angle, and the orders are functions of both shaft
    angles.
    """

    ratio: Float[Numbers, ""]
    orders: OrderModel
    arrays: Any
    constants: Any = eqx.field(static=True)
    given_order: float = eqx.field(static=True)

    @property
    def name(self) -> str:
        """Name of the class of the given model."""
        return type(self.fitted).__name__

    @property
    def fitted(self) -> Any:
        """The model of the user with its fitted parameters."""
        return eqx.combine(self.arrays, self.constants)

    @property
    def grid_orders(self) -> GridOrders:
        """Orders of both parts."""
        return (self.given_order, 0), *self.orders.grid_orders

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """Return TE of `flank`, rad, for given angles of both shafts."""
        flat = jnp.ravel(driving_angle)
        given = jnp.reshape(self.fitted.transmission_error(flat, flank), jnp.shape(driving_angle))
        return given + self.orders.at_both_angles(driving_angle, driven_angle, flank)


def fitted_model(told: Quantities, given: GivenModel, orders: OrderModel) -> FittedModel:
    """Return the flank model of a fit from the given model at the solution and the free orders."""
    found = dict(zip(told.names, told.mean, strict=True))
    values = zip(given.names, given.values, strict=True)
    given = given.at([found.get(name, value) for name, value in values])
    numbers = jax.tree.map(
        lambda leaf: jnp.asarray(leaf) if hasattr(leaf, "dtype") else leaf, given.fitted
    )
    arrays, constants = eqx.partition(numbers, eqx.is_array)
    return FittedModel(orders.ratio, orders, arrays, constants, given.highest_order)


class StoredModel(FlankModel):
    """Placeholder for a given flank model, because a run folder does not store its code.

    Every use of it raises an error. `errors` are the sizes of the transmission error that the fit
    has stored.

    **Raises** `UsageError` with the name of the class and the cure.
    """

    ratio: Float[Numbers, ""]
    name: str = eqx.field(static=True)
    errors: tuple[tuple[Flank, FlankError], ...] = eqx.field(static=True, default=())

    @property
    def grid_orders(self) -> GridOrders:
        """Raise `UsageError`, because the model is not known."""
        self.refuse()

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """Raise `UsageError`, because the model is not known."""
        self.refuse()

    def refuse(self, where: str = "model") -> NoReturn:
        """Raise `UsageError` with the name of the model and the cure."""
        raise UsageError(
            f"this fit is of the flank model {self.name}, whose code a run folder does not hold;"
            " repeat the fit in Python with `vttig_jax.fit(…, model=…)` and use its result.",
            where=where,
        )
