"""Draws of the backlash map, and of the smallest gap with its driving angle.

The order-complete flank model is linear in its coefficients if both shaft angles are known. The
driven angle of a draw differs by microradians from that of the mean coefficients, and one Newton
step corrects this difference. The curves of all draws are therefore one matrix product, basis times
draws.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ...base.errors import PairError
from ...base.numerics.counting import pieces
from ...base.units import REV
from ...kinematics.flank_model import flank_index
from ...kinematics.harmonic import OrderModel, linearised_series
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import Flank
from .draws import SmallestGap

_CHUNK = 256
"""Angles per block (chosen): 8 MB of curves for 4000 draws."""

PER_PERIOD = 8  # grid points per period of the highest order (chosen)
_LIMIT_PLACES, _LIMIT_DRAWS = 200, 2000  # angles and draws for the upper limit (chosen)
_CANDIDATES = 6  # local minima of a draw that are refined (chosen)
_NEWTON = 4  # Newton steps to a minimum (chosen)
_MOST_POINTS = 2**22  # most grid points of a hunting period (chosen)
_MOST_PHASES = 4_000_000  # most bytes of an array over draws, candidates and terms (chosen)

Angles = Float[np.ndarray, " n"]
Curves = Float[np.ndarray, "n m"]


@dataclass(frozen=True)
class GapDraws:
    """Draws of the coefficients of both flanks, evaluated as curves over the driving angle.

    **Arguments**
    - `pair`: gear pair, for the ratio, the hunting period and millimetres.
    - `terms`: orders (n₁, n₂) of the harmonics.
    - `offset`, `cosine`, `sine`: draws, rad, shapes (m, 2), (m, 2, terms), (m, 2, terms).
    - `batch`: batch of every draw, shape (m,); different batches are independent.
    """

    pair: GearPair | Drive
    terms: tuple[tuple[int, int], ...]
    offset: Float[np.ndarray, "m 2"]
    cosine: Float[np.ndarray, "m 2 terms"]
    sine: Float[np.ndarray, "m 2 terms"]
    batch: np.ndarray

    @cached_property
    def mean_model(self) -> OrderModel:
        """Flank model of the mean coefficients, the centre of all bands."""
        means = (jnp.asarray(p.mean(axis=0)) for p in (self.offset, self.cosine, self.sine))
        return OrderModel(jnp.asarray(float(self.pair.ratio)), self.terms, *means)

    def errors(self, driving_angle: Angles, flank: Flank | None) -> Curves:
        """Return the transmission error of every draw on one flank, rad, shape (angles, m).

        Without a flank it is the difference TE_B − TE_A, the backlash.
        """
        centre, basis = self.linearised(driving_angle, flank)
        return centre[:, None] + basis @ self._deviations[flank]

    def over(self, driving_angle: Angles) -> Curves:
        """Return the backlash of every draw, rad of the driven gear, shape (angles, m)."""
        return self.errors(driving_angle, None)

    def chunks(self, driving_angle: Angles, flank: Flank | None = None) -> Iterator[Curves]:
        """Yield `errors` for successive blocks of `driving_angle` (rad).

        Blocks of at most `_CHUNK` angles limit the memory.
        """
        for part in pieces(len(driving_angle), _CHUNK):
            yield self.errors(driving_angle[part], flank)

    @cached_property
    def smallest(self) -> SmallestGap:
        """Smallest gap of every draw over the hunting period, also between grid points."""
        angles = self._minima(*self._candidates())
        gaps = self._exact_gaps(angles)
        best = gaps.argmin(axis=1)[:, None]
        place = np.take_along_axis(angles, best, axis=1)[:, 0] % (self.pair.hunting_turns * REV)
        gap = np.take_along_axis(gaps, best, axis=1)[:, 0]
        upper = self._upper_limit(place)
        return SmallestGap(self.pair, gap, place, self.batch, upper)

    def _upper_limit(self, places: Angles) -> float:
        """Return a 97.5 % upper limit of the smallest gap, rad.

        The smallest gap is at most the gap at any angle. It is therefore at most the lowest point
        of a one-sided band that the gaps at all `places` (driving angles, rad) do not exceed with
        this probability.
        """
        places = np.unique(places)
        places = places[np.linspace(0, len(places) - 1, _LIMIT_PLACES).astype(int)]
        centre, basis = self.linearised(places)
        deviations = basis @ self._deviations[None][:, :_LIMIT_DRAWS]
        std = np.maximum(deviations.std(axis=1), 1e-300)
        highest = (deviations / std[:, None]).max(axis=0)
        return float(np.min(centre + np.quantile(highest, 0.975) * std))

    # Linear curves

    def linearised(
        self, driving_angle: Angles, flank: Flank | None = None
    ) -> tuple[Angles, Float[np.ndarray, "n c"]]:
        """Return TE of the mean coefficients, rad, and its derivatives by all coefficients.

        Without a flank TE_B − TE_A takes its place, with the coefficients of B, then those of A.
        """
        if flank is None:
            centre_a, basis_a = self.linearised(driving_angle, "A")
            centre_b, basis_b = self.linearised(driving_angle, "B")
            return centre_b - centre_a, np.concatenate([basis_b, -basis_a], axis=1)
        parts = self.offset, self.cosine, self.sine
        mean = [part[:, flank_index(flank)].mean(axis=0) for part in parts]
        return linearised_series(float(self.pair.ratio), self.terms, mean, driving_angle)

    @cached_property
    def _deviations(self) -> dict[Flank | None, Float[np.ndarray, "c m"]]:
        """Coefficients (offset, cosines, sines) of every draw minus their mean, rad.

        Those of each flank, and as `linearised` takes them without a flank.
        """
        on_flanks = np.concatenate([self.offset[..., None], self.cosine, self.sine], axis=2)
        a, b = np.ascontiguousarray((on_flanks - on_flanks.mean(axis=0)).transpose(1, 2, 0))
        return {"A": a, "B": b, None: np.concatenate([b, a])}

    # The smallest gap

    def _candidates(self) -> tuple[Float[np.ndarray, "m k"], float]:
        """Return driving angles, rad, of the lowest local minima of every draw, and the grid step.

        The angles are points of a grid over the hunting period with this step, rad.
        """
        width = REV / (PER_PERIOD * math.ceil(self.mean_model.highest_order))
        count = round(self.pair.hunting_turns * REV / width)
        if count > _MOST_POINTS:
            raise PairError(
                f"a hunting period of {self.pair.hunting_turns} turns is too long to search for the"
                ' smallest gap; give the ratio as a quotient of tooth numbers, such as "7/1798".',
                where="drive.ratio" if isinstance(self.pair, Drive) else "driven.teeth",
            )
        kept = self._possible_minima(count, width)
        lowest = np.full((_CANDIDATES, len(self.offset)), np.inf)
        places = np.zeros_like(lowest)
        for part in pieces(len(kept), _CHUNK):
            points = kept[part]
            needed = np.unique(np.concatenate([points - 1, points, points + 1]))
            gaps = self.over(needed * width)
            index = np.searchsorted(needed, points)
            before, here, after = gaps[index - 1], gaps[index], gaps[index + 1]
            bend = before - 2 * here + after
            # Minima between grid points are ranked by the parabola through three points.
            vertex = here - (after - before) ** 2 / (8 * np.where(bend > 0, bend, np.inf))
            vertex[(before < here) | (after < here)] = np.inf
            both = np.concatenate([lowest, vertex])
            angle = np.broadcast_to((points * width)[:, None], vertex.shape)
            first = np.argpartition(both, _CANDIDATES - 1, axis=0)[:_CANDIDATES]
            lowest = np.take_along_axis(both, first, axis=0)
            places = np.take_along_axis(np.concatenate([places, angle]), first, axis=0)
        # A draw with fewer minima than candidates repeats its best one.
        best = np.take_along_axis(places, lowest.argmin(axis=0)[None], axis=0)
        return np.where(np.isfinite(lowest), places, best).T, width

    def _possible_minima(self, count: int, width: float) -> np.ndarray:
        """Return the indices of the grid points near which a draw can have its smallest gap.

        The grid has `count` points in steps of `width`, rad. The deviation of a draw from the mean
        curve is at most its Mahalanobis length times the standard deviation at the same angle
        (Cauchy and Schwarz). Points at which even the longest draw stays too high are left out.
        """
        deviations = self._deviations[None]
        values, vectors = np.linalg.eigh(np.cov(deviations))
        used = values > 1e-12 * max(values.max(), 1e-300)
        roots = vectors[:, used] * np.sqrt(values[used])
        white = (vectors[:, used] / np.sqrt(values[used])).T @ deviations
        longest = np.sqrt(np.max(np.sum(white**2, axis=0), initial=0.0))
        centre, reach = np.empty(count), np.empty(count)
        for part in pieces(count, 16 * _CHUNK):
            centre[part], basis = self.linearised(np.arange(part.start, part.stop) * width)
            reach[part] = longest * np.linalg.norm(basis @ roots, axis=1)
        # Between grid points, a curve is at most `dip` lower, by the bound `bend` of its curvature.
        bend = float(np.abs(self._series).max(axis=0) @ self._speeds**2)
        dip = bend * width**2 / 8
        return np.flatnonzero(centre - reach - dip <= np.min(centre + reach) + 1e-15)

    @property
    def _orders(self) -> Float[np.ndarray, "terms 2"]:
        return np.asarray(self.terms, float).reshape(-1, 2)

    @property
    def _speeds(self) -> Float[np.ndarray, " terms"]:
        """Frequencies ω = n₁ + i n₂ of the terms, cycles per driving revolution."""
        return self._orders @ np.array([1.0, float(self.pair.ratio)])

    @cached_property
    def _series(self) -> Complex[np.ndarray, "m terms"]:
        """Complex amplitudes z of the gap of every draw, rad; see `_speeds` for the ω.

        Without its constant, the gap is approximately Re Σ z exp(jωφ₁). For the phases, the driven
        angle is taken as i φ₁ plus the mean offset of the flank, which neglects the variation of
        the transmission error. The series serves only to locate the minima.
        """
        turned = np.exp(1j * np.outer(self.offset.mean(axis=0), self._orders[:, 1]))
        flanks = (self.cosine - 1j * self.sine) * turned
        return flanks[:, 1] - flanks[:, 0]

    def _minima(self, angles: Float[np.ndarray, "m k"], width: float) -> Float[np.ndarray, "m k"]:
        """Return the driving angle, rad, of the minimum near each of the grid points `angles`.

        Newton steps with the series `_series` find it, at most one grid step `width` away.
        """
        speeds, series = self._speeds, self._series
        refined = angles.copy()
        for part in self._draw_slices(angles.shape[1]):
            first = (1j * speeds * series[part])[:, None]
            second = (-(speeds**2) * series[part])[:, None]
            for _ in range(_NEWTON):
                wave = np.exp(1j * refined[part][..., None] * speeds)
                slope = np.sum(first * wave, axis=-1).real
                bend = np.sum(second * wave, axis=-1).real
                step = np.where(bend > 0, -slope / np.where(bend > 0, bend, 1.0), 0.0)
                moved = refined[part] + np.clip(step, -width, width)
                refined[part] = np.clip(moved, angles[part] - width, angles[part] + width)
        return refined

    def _exact_gaps(self, angles: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "m k"]:
        """Return the gap, rad, of every draw (row) at its k driving angles.

        The driven angle is found by fixed-point iteration.
        """
        orders, gaps = self._orders, np.empty_like(angles)
        for part in self._draw_slices(angles.shape[1]):
            errors = []
            for side in (0, 1):
                offset = self.offset[part, side, None]
                error = np.broadcast_to(offset, angles[part].shape)
                for _ in range(4):
                    driven = float(self.pair.ratio) * angles[part] + error
                    phase = (
                        angles[part][..., None] * orders[:, 0] + driven[..., None] * orders[:, 1]
                    )
                    wave = np.cos(phase) * self.cosine[part, side, None]
                    wave += np.sin(phase) * self.sine[part, side, None]
                    error = offset + wave.sum(axis=-1)
                errors.append(error)
            gaps[part] = errors[1] - errors[0]
        return gaps

    def _draw_slices(self, candidates: int) -> Iterator[slice]:
        """Return slices of the draws that keep arrays over (draws, candidates, terms) small."""
        size = max(1, _MOST_PHASES // 8 // max(1, candidates * len(self.terms)))
        return pieces(len(self.offset), size)
