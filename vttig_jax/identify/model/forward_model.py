"""Forward model: the harmonics of a log as a function of the physical parameters."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers
from ...kinematics.flank_model import flank_index
from ...pair.gear_pair import Drive, Flank, GearPair
from .column_layout import OFFSET, ColumnLayout, own_parameters
from .harmonics import SECOND_ORDER, TermPlan
from .torus import GEARS, Torus, errors_and_slopes, grid

_FIRST = ((1, 0), (0, 1))


class ForwardModel(eqx.Module):
    """Map from the physical parameters to the coefficients of the own and tied columns.

    The columns are those of `ColumnLayout`. In this module, "tied coefficients" and the axis "tied"
    of an array mean the own columns of all logs, followed by the columns of the tied harmonics.
    Each flank has its own coefficients.

    The parameters are a vector with the names `names`: lengths in mm, angles in rad, eccentricities
    and encoder errors in Cartesian form (x + jy = amplitude · exp(j phase)). The first parameters
    are linear (offsets, drift, delay, regressors and others): coefficients = `linear` · first
    parameters + the contribution of a subclass.
    """

    names: eqx.AbstractVar[tuple[str, ...]]
    linear: eqx.AbstractVar[Float[Numbers, "p flanks tied"]]

    @abstractmethod
    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Return the tied coefficients of every measured flank, rad."""

    @abstractmethod
    def linearised(
        self, parameters: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "flanks tied"], Float[np.ndarray, "flanks tied p"]]:
        """Return the tied coefficients and their derivatives with respect to the parameters.

        Nothing is compiled for this model alone.
        """

    def linear_part(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Return the contribution of the parameters that only scale a column."""
        return jnp.einsum("p,pft->ft", parameters[: self.linear.shape[0]], self.linear)


class PairRelation(ForwardModel):
    """Forward model of two eccentric gears by the exact relation, with eccentric encoders.

    The relation is explicit if both shaft angles are given. It is evaluated on a grid of both
    angles and projected on the tied harmonics. Encoder errors add + E₂ sin(φ₂ + ε₂) −
    i E₁ sin(φ₁ + ε₁) on both flanks.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    flanks: tuple[Flank, ...] = eqx.field(static=True)
    linear: Float[Numbers, "p flanks tied"]
    torus: Torus
    basis: Float[Numbers, "tied grid"]

    @property
    def sides(self) -> list[int]:
        """Index of every measured flank: 0 for A, 1 for B."""
        return [flank_index(flank) for flank in self.flanks]

    @property
    def places(self) -> list[int]:
        """Index in `GEARS` of every eccentricity coordinate; these are the last parameters."""
        return [GEARS.index(name) for name in self.names[len(self.linear) :]]

    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Return the tied coefficients of every measured flank, rad."""
        places = np.array(self.places, np.intp)
        gears = jnp.zeros(len(GEARS)).at[places].set(parameters[len(self.linear) :])
        turned = self.torus.errors(gears, self.flanks)
        return turned @ self.basis.T + self.linear_part(parameters)

    def linearised(
        self, parameters: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "flanks tied"], Float[np.ndarray, "flanks tied p"]]:
        """Return the tied coefficients and their derivatives with respect to the parameters.

        Nothing is compiled for this model alone.
        """
        first = len(self.linear)
        gears = np.zeros(len(GEARS))
        gears[self.places] = parameters[first:]
        errors, slopes = map(np.asarray, errors_and_slopes(self.torus, gears))
        linear = np.moveaxis(np.asarray(self.linear), 0, -1)
        curved = np.einsum("tg,fgp->ftp", self.basis, slopes[self.sides][..., self.places])
        tied = errors[self.sides] @ np.asarray(self.basis).T + linear @ parameters[:first]
        return tied, np.concatenate([linear, curved], axis=-1)


class LinearRelation(ForwardModel):
    """Forward model in which every parameter scales a column.

    It describes a drive without geometry, and encoders on perfect gears.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    linear: Float[Numbers, "p flanks tied"]

    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Return the tied coefficients of every measured flank, rad."""
        return self.linear_part(parameters)

    def linearised(
        self, parameters: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "flanks tied"], Float[np.ndarray, "flanks tied p"]]:
        """Return the tied coefficients and their derivatives with respect to the parameters.

        Nothing is compiled for this model alone.
        """
        slopes = np.moveaxis(np.asarray(self.linear), 0, -1)
        return slopes @ parameters, slopes


def relation_of(
    pair: GearPair | Drive,
    terms: TermPlan,
    columns: ColumnLayout,
    flanks: tuple[Flank, ...],
    *,
    encoder_terms: bool,
    gear_terms: bool,
) -> ForwardModel:
    """Return the forward model of a pair or drive with errors of gears, encoders or both.

    `gear_terms` and `encoder_terms` state which errors have parameters. Without tied harmonics,
    for example with a given flank model, every parameter only scales a column.
    """
    if not gear_terms:
        return encoder_relation(terms, columns, flanks, float(pair.ratio))
    if isinstance(pair, Drive) or not terms.tied:
        return drive_relation(terms, columns, flanks)
    return pair_relation(pair, terms, columns, flanks, encoder_terms=encoder_terms)


def pair_relation(
    pair: GearPair,
    terms: TermPlan,
    columns: ColumnLayout,
    flanks: tuple[Flank, ...],
    *,
    encoder_terms: bool,
) -> PairRelation:
    """Return the forward model of a gear pair.

    A shaft whose first order is not tied has no parameters of its gear and of its encoder.
    """
    names, linear = _common(columns, flanks)
    ratio = float(pair.ratio)
    if encoder_terms:
        _add_encoders(
            names, linear=linear, terms=terms, columns=columns, flanks=len(flanks), ratio=ratio
        )
    gears = tuple(f"{shaft}_{axis}" for shaft in _tied_shafts(terms) for axis in "xy")
    return PairRelation(
        names=(*names, *gears),
        flanks=flanks,
        linear=np.stack(linear),
        torus=Torus(
            ratio=np.asarray(ratio),
            centre_distance=np.asarray(pair.centre_distance_mm),
            base_sum=np.asarray(pair.base_radii.sum(axis=0)),
        ),
        basis=_projection(terms, columns),
    )


def drive_relation(
    terms: TermPlan, columns: ColumnLayout, flanks: tuple[Flank, ...]
) -> LinearRelation:
    """Return the forward model of a drive without geometry.

    The first order of a shaft has a common part and a difference between the flanks. The common
    part gives the amplitude of the drive. Half the difference is added on flank B and subtracted on
    flank A, so that the difference B − A is the variable backlash.
    """
    names, linear = _common(columns, flanks)
    halves = np.array([-0.5 if flank == "A" else 0.5 for flank in flanks])
    kinds = {"": np.ones(len(flanks))}
    if len(flanks) == 2:
        kinds["_difference"] = halves
    first = _first_order_columns(terms, columns)
    for kind, sides in kinds.items():
        for shaft in _tied_shafts(terms):
            cosine, sine = first[shaft]
            names += [f"{shaft}_x{kind}", f"{shaft}_y{kind}"]
            linear += [np.outer(sides, column) for column in (sine, cosine)]
    return LinearRelation(names=tuple(names), linear=np.stack(linear))


def encoder_relation(
    terms: TermPlan, columns: ColumnLayout, flanks: tuple[Flank, ...], ratio: float
) -> LinearRelation:
    """Return the forward model of two encoders on perfect gears, the same on both flanks."""
    names, linear = _common(columns, flanks)
    _add_encoders(
        names, linear=linear, terms=terms, columns=columns, flanks=len(flanks), ratio=ratio
    )
    return LinearRelation(names=tuple(names), linear=np.stack(linear))


def _common(
    columns: ColumnLayout, flanks: tuple[Flank, ...]
) -> tuple[list[str], list[Float[np.ndarray, "flanks tied"]]]:
    """Return the parameters that every forward model has: their names and coefficients.

    They are the offsets, the constant backlash and the coefficients of the other own columns.
    """
    width = columns.own_width + 2 * len(columns.tied)
    several = len(columns.own) > 1
    names: list[str] = []
    linear: list[np.ndarray] = []
    constant = np.zeros(width)
    for place, (name, log) in enumerate(columns.names):
        if name == OFFSET:
            constant[place] = 1.0
            names.append(f"{OFFSET}_of_{log + 1}" if several else OFFSET)
            linear.append(np.stack([np.eye(width)[place]] * len(flanks)))
    if len(flanks) == 2:
        names.append("constant_backlash")
        linear.append(np.stack([constant if flank == "B" else 0 * constant for flank in flanks]))
    own, matrix = own_parameters(columns)
    rows = [k for k, (name, _) in enumerate(columns.names) if name != OFFSET]
    for column, name in enumerate(own):
        spread = np.zeros(width)
        spread[rows] = matrix[:, column]
        names.append(name)
        linear.append(np.stack([spread] * len(flanks)))
    return names, linear


def _add_encoders(
    names: list[str],
    linear: list[Float[np.ndarray, "flanks tied"]],
    terms: TermPlan,
    columns: ColumnLayout,
    flanks: int,
    ratio: float,
) -> None:
    """Append the parameters of the encoder errors to `names` and `linear`.

    The driven encoder adds E₂ sin(φ₂ + ε₂) = E₂ₓ sin φ₂ + E₂ᵧ cos φ₂. The driving encoder adds the
    same for its shaft, multiplied by −i.
    """
    first = _first_order_columns(terms, columns)
    for shaft in _tied_shafts(terms):
        gain = -ratio if shaft == "driving" else 1.0
        cosine, sine = first[shaft]
        names += [f"{shaft}_encoder_x", f"{shaft}_encoder_y"]
        linear += [np.stack([gain * column] * flanks) for column in (sine, cosine)]


def _tied_shafts(terms: TermPlan) -> list[str]:
    return [h.shaft for h in terms.tied if h.term in _FIRST]


def _first_order_columns(
    terms: TermPlan, columns: ColumnLayout
) -> dict[str, tuple[Float[np.ndarray, " tied"], Float[np.ndarray, " tied"]]]:
    """Return shaft → two unit vectors, which select the columns of its first order.

    The first vector selects the cosine column among the own and tied columns, the second one the
    sine column. Shafts whose first order is not tied are left out.
    """
    unit = np.eye(columns.own_width + 2 * len(columns.tied))
    places = {
        harmonic.shaft: columns.own_width + 2 * index
        for index, harmonic in enumerate(terms.tied)
        if harmonic.term in _FIRST
    }
    return {shaft: (unit[place], unit[place + 1]) for shaft, place in places.items()}


def _projection(terms: TermPlan, columns: ColumnLayout) -> Float[np.ndarray, "tied grid"]:
    """Return the matrix that maps TE values on the grid of the torus to the tied coefficients.

    A row of the matrix is one of the own columns of all logs or one column of a tied harmonic. The
    product of a row and the TE values (rad) is a Fourier coefficient: the mean for the offset of
    every log, and the cosine or sine coefficient for a tied harmonic. The rows of other own
    columns, such as drift, are zero. If the tooth counts give two harmonics the same frequency,
    their coefficients are added, because the log cannot separate them either.
    """
    driving, driven = grid()
    points = len(driving)
    matrix = np.zeros((columns.own_width + 2 * len(columns.tied), points))
    for place, (name, _) in enumerate(columns.names):
        if name == OFFSET:
            matrix[place] = 1.0 / points
    signed = lambda term: term[0] + term[1] * terms.ratio  # noqa: E731
    for term in (*_FIRST, *SECOND_ORDER):
        phase = term[0] * driving + term[1] * driven
        for index, harmonic in enumerate(terms.tied):
            if terms.frequency(term) == terms.frequency(harmonic.term) != 0:
                sense = 1.0 if signed(term) == signed(harmonic.term) else -1.0
                place = columns.own_width + 2 * index
                matrix[place] += 2 / points * np.cos(phase)
                matrix[place + 1] += sense * 2 / points * np.sin(phase)
    return matrix
