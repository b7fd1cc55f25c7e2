"""Interface of a log density for the sampler, checks of its values, and starts of the walkers."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError

MOST_REDRAWS = 50
"""Most times that starts outside the support are redrawn (chosen)."""

LARGEST_CONDITION = 1e8
"""Largest condition number of the scaled starts (chosen). Moves are combinations of the walkers, so
that they cannot reach a direction in which the starts do not spread."""


@runtime_checkable
class Target(Protocol):
    """Log density over named coordinates, to be sampled.

    `identity` (options, SHA-256 of the data, prior and other JSON values) must be equal in a
    checkpoint and in the run that continues it.
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
        """JSON values that identify this density."""
        ...

    def log_density(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Return the log density of each point up to a constant; −inf outside the support."""
        ...

    def starts(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count d"]:
        """Return starting points that are spread about as widely as the posterior."""
        ...


class CheckedDensity:
    """Log density of a target, which raises an error for values that cannot be used."""

    def __init__(self, target: Target):
        self.target = target

    def __call__(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Return the log density of each point, float64.

        **Raises** `NoAnswerError` that names a point whose density is NaN or +∞.
        """
        values = np.asarray(self.target.log_density(points), np.float64)
        if values.shape != points.shape[:1]:
            raise ValueError(
                f"Argument `target` must give one log density per point, but gives shape"
                f" {values.shape} for {len(points)} points."
            )
        if not (values < np.inf).all():  # NaN < inf is False too
            worst = int(np.argmin(values < np.inf))
            raise NoAnswerError(
                f"the log density is {values[worst]} at {self.describe(points[worst])}; it must be"
                " a number, or −inf outside the support."
            )
        return values

    def describe(self, point: Float[np.ndarray, " d"]) -> str:
        """Return the coordinates of a point as text, with names and units."""
        parts = zip(self.target.names, point, self.target.units, strict=True)
        return ", ".join(f"{name} = {value:.6g} {unit}".rstrip() for name, value, unit in parts)


def starting_points(
    density: CheckedDensity, walkers: int, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "walkers d"], Float[np.ndarray, " walkers"]]:
    """Return the start of every walker of an ensemble and its finite log density.

    Starts outside the support are redrawn. emcee itself never ends if no walker has a finite
    density, and walkers that do not spread in a direction never move in it.

    **Raises** `NoAnswerError` if too few starts are inside the support, or if they do not spread
    over all coordinates; the message names the coordinate.
    """
    points = _draw_starts(density.target, walkers, generator)
    values = density(points)
    for _ in range(MOST_REDRAWS):
        outside = np.flatnonzero(~np.isfinite(values))
        if not outside.size:
            break
        # All walkers are redrawn, so that the density is compiled for one shape only.
        redrawn = _draw_starts(density.target, walkers, generator)
        redrawn_values = density(redrawn)
        inside = np.flatnonzero(np.isfinite(redrawn_values))[: outside.size]
        points[outside[: inside.size]] = redrawn[inside]
        values[outside[: inside.size]] = redrawn_values[inside]
    else:
        raise NoAnswerError(_outside_message(density, points, values))
    _check_spread(density.target, points)
    return points, values


def _draw_starts(target: Target, walkers: int, generator: np.random.Generator) -> np.ndarray:
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


def _outside_message(density: CheckedDensity, points: np.ndarray, values: np.ndarray) -> str:
    inside = np.isfinite(values)
    count = f"{(~inside).sum()} of {inside.size} walkers start where the density is zero"
    if not inside.any():
        return (
            f"{count}, for example {density.describe(points[0])}; the prior excludes the starts, so"
            " widen its bounds."
        )
    # Coordinate with the largest distance between the mean start outside and the mean start inside,
    # relative to its standard deviation.
    shift = np.abs(points[~inside].mean(0) - points[inside].mean(0))
    spread = points.std(0)
    worst = int(np.argmax(np.divide(shift, spread, out=np.zeros_like(shift), where=spread > 0)))
    name, unit = density.target.names[worst], density.target.units[worst]
    low, high = points[inside, worst].min(), points[inside, worst].max()
    outside = points[~inside, worst].mean()
    return (
        f"{count}, mostly because of the coordinate `{name}` (inside {low:.6g} … {high:.6g} {unit},"
        f" outside around {outside:.6g} {unit}); widen its bounds."
    )


def _check_spread(target: Target, points: Float[np.ndarray, "walkers d"]) -> None:
    """Raise an error if walkers coincide or span fewer dimensions than there are coordinates."""
    distinct = len(np.unique(points, axis=0))
    if distinct < len(points):
        raise NoAnswerError(
            f"{len(points) - distinct} of {len(points)} walkers start at the same point as another,"
            f" so the starts of `{'`, `'.join(target.names)}` have no spread; give them one."
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
            f"the starts of `{name}` are a linear combination of those of the other coordinates;"
            " give it an independent spread."
        )
