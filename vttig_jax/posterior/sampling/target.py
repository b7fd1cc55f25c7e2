"""What the sampler asks of a log density, and how it checks the answers."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError

TRIES = 50
"""So often starts outside the support are drawn anew."""

LARGEST_CONDITION = 1e8
"""Of the scaled starts: beyond it moves along differences of walkers no longer span the space."""


@runtime_checkable
class Target(Protocol):
    """A log density over named coordinates, to be sampled.

    `identity` (options, SHA-256 of the data, prior …; whatever JSON can hold) is what a checkpoint
    must agree with to be continued.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each coordinate, "" for a pure number."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """What makes this density the one it is."""
        ...

    def log_density(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Log density of each point up to a constant; −inf outside the support, never NaN."""
        ...

    def starts(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count d"]:
        """Points to start from, spread about as widely as the posterior."""
        ...


class CheckedDensity:
    """The log density of a target, with answers that cannot be used told in one sentence."""

    def __init__(self, target: Target):
        self.target = target

    def __call__(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Log density of each point, float64.

        **Raises** `NoAnswerError` naming a point whose density is NaN or +∞.
        """
        values = np.asarray(self.target.log_density(points), np.float64)
        if values.shape != points.shape[:1]:
            raise ValueError(
                f"Argument `target` must give one log density a point, but gives shape"
                f" {values.shape} for {len(points)} points."
            )
        if not (values < np.inf).all():  # False for NaN too
            worst = int(np.argmin(values < np.inf))
            raise NoAnswerError(
                f"the log density is {values[worst]} at {self.words(points[worst])}; it must be a"
                " number, or −inf outside the support."
            )
        return values

    def words(self, point: Float[np.ndarray, " d"]) -> str:
        """The coordinates of a point with names and units."""
        parts = zip(self.target.names, point, self.target.units, strict=True)
        return ", ".join(f"{name} = {value:.6g} {unit}".rstrip() for name, value, unit in parts)


def starting_points(
    density: CheckedDensity, walkers: int, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "walkers d"], Float[np.ndarray, " walkers"]]:
    """Start of every walker of an ensemble and its finite log density.

    Starts outside the support are drawn anew. emcee itself goes on for ever where no walker has a
    density, and never leaves the plane of walkers that do not spread.

    **Raises** `NoAnswerError` where too few starts are inside, or they do not spread over all
    coordinates, naming the coordinate.
    """
    points = _drawn(density.target, walkers, generator)
    values = density(points)
    for _ in range(TRIES):
        outside = np.flatnonzero(~np.isfinite(values))
        if not outside.size:
            break
        others = _drawn(density.target, walkers, generator)  # all of them: one compiled shape
        other_values = density(others)
        inside = np.flatnonzero(np.isfinite(other_values))[: outside.size]
        points[outside[: inside.size]] = others[inside]
        values[outside[: inside.size]] = other_values[inside]
    else:
        raise NoAnswerError(_outside(density, points, values))
    _check_spread(density.target, points)
    return points, values


def _drawn(target: Target, walkers: int, generator: np.random.Generator) -> np.ndarray:
    points = np.array(target.starts(walkers, generator), np.float64)
    if points.shape != (walkers, len(target.names)):
        raise ValueError(
            f"Argument `target` must give starts of shape {(walkers, len(target.names))}, but gives"
            f" {points.shape}."
        )
    if not np.isfinite(points).all():
        name = target.names[int(np.argmin(np.isfinite(points).all(0)))]
        raise NoAnswerError(f"a start is not finite in the coordinate `{name}`; give it a scale.")
    return points


def _outside(density: CheckedDensity, points: np.ndarray, values: np.ndarray) -> str:
    inside = np.isfinite(values)
    lost = f"{(~inside).sum()} of {inside.size} walkers start where the density is zero"
    if not inside.any():
        return (
            f"{lost}, for example {density.words(points[0])}; the prior excludes the starts, so"
            " widen its bounds."
        )
    # The coordinate in which the starts outside differ most from those inside, in its spread.
    shift = np.abs(points[~inside].mean(0) - points[inside].mean(0))
    spread = points.std(0)
    worst = int(np.argmax(np.divide(shift, spread, out=np.zeros_like(shift), where=spread > 0)))
    name, unit = density.target.names[worst], density.target.units[worst]
    low, high = points[inside, worst].min(), points[inside, worst].max()
    around = points[~inside, worst].mean()
    return (
        f"{lost}, most of all by the coordinate `{name}` (inside {low:.6g} … {high:.6g} {unit},"
        f" outside around {around:.6g} {unit}); widen its bounds."
    )


def _check_spread(target: Target, points: Float[np.ndarray, "walkers d"]) -> None:
    """Refuse walkers that coincide or span fewer dimensions than there are."""
    distinct = len(np.unique(points, axis=0))
    if distinct < len(points):
        raise NoAnswerError(
            f"{len(points) - distinct} of {len(points)} walkers start at the place of another, so"
            f" the starts of `{'`, `'.join(target.names)}` are not drawn from a spread; give one."
        )
    centred = points - points.mean(0)
    size = np.abs(centred).max(0)
    if not (size > 0).all():
        name = target.names[int(np.argmin(size > 0))]
        raise NoAnswerError(f"all walkers start at one value of `{name}`; give it a spread.")
    scaled = centred / np.linalg.norm(centred / size, axis=0) / size
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] * LARGEST_CONDITION < singular[0]:
        name = target.names[int(np.argmax(np.abs(directions[-1])))]
        raise NoAnswerError(
            f"the starts of `{name}` follow from those of the other coordinates; give it a spread"
            " of its own."
        )
