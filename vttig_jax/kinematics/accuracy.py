"""Accuracy of gears and of a rotary axis in the terms of standards, with intervals.

Single flank (terms of ISO 1328-1; the definitions used are these): of a transmission error x over a
period of p pitches, F_is = max x − min x, and f_is is the largest max − min within one pitch: of x
(1995), or of x without its waves below p/2 cycles in the period (2013). f_l is max − min of these.

Rotary axis (ISO 230-2): of the deviations at target i, approached upwards ↑ and downwards ↓, with
means x̄ᵢ and standard deviations sᵢ (n − 1),

    Bᵢ = x̄ᵢ↑ − x̄ᵢ↓,  Rᵢ = max(2 sᵢ↑ + 2 sᵢ↓ + |Bᵢ|, 4 sᵢ↑, 4 sᵢ↓),  B = max |Bᵢ|,  R = max Rᵢ,
    M = range of (x̄ᵢ↑ + x̄ᵢ↓)/2,  E = range of all x̄ᵢ,  A = max (x̄ᵢ + 2 sᵢ) − min (x̄ᵢ − 2 sᵢ).

The largest of values that noise blurs is too large. How much noise adds follows from true values
that are drawn, and read once more with noise: T as read less T as drawn. Value and interval are T
less the median and the quantiles of this; of a single flank the value is not below the 2.5 %
quantile of T as drawn, the lower end not below its least and the upper end not below its 97.5 %
quantile. The draws have priors whose widths the values tell: waves have normal priors of different
widths, whose shares the EM algorithm finds (M. Stephens, Biostatistics 18 (2017) 275), and standard
deviations a common one (G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int, Real, Shaped
from scipy.fft import dct, idct
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.special import polygamma

SINGLE_FLANK = ("F_is", "f_is_1995", "f_is_2013", "f_l")
AXIS = ("B", "M", "E", "R", "A")


DRAWS = 200
"""Draws of an interval (chosen)."""

_ROUNDS, _WIDTHS, _EVEN, _SPARSE = 60, 20, 4.0, (0.0, 3.0, 20.0)
"""Rounds of the EM algorithm; widths of its priors; and values that are counted beside the measured
ones: of all widths alike, and waves that are zero, in √n of n waves (chosen)."""

_SCALE = 0.15
"""To this share the size of the noise is known, which a spectrum of few turns tells (chosen)."""


def single_flank(
    curve: Float[np.ndarray, "*b n"], long: Float[np.ndarray, "*b n"], pitches: int
) -> Float[np.ndarray, "*b terms"]:
    """Return F_is, f_is of 1995 and of 2013, and f_l of curves, in their unit.

    **Arguments**
    - `curve`: x at n equal distances over a period, which repeats. - `long`: its long waves.
    - `pitches`: pitches in the period, which divide n; 0 without teeth, where F_is alone is
      defined and the others are NaN.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.kinematics.accuracy import single_flank
    >>> turn = np.arange(640) * 2 * np.pi / 640
    >>> long = 4 * np.sin(turn)
    >>> single_flank(long + np.cos(20 * turn), long, 20).round(2).tolist()
    [9.95, 2.67, 2.0, 8.0]

    ```
    """
    if not pitches:
        return np.stack([np.ptp(curve, axis=-1), *np.full((3, *curve.shape[:-1]), np.nan)], -1)
    size = curve.shape[-1] // pitches + 1

    def within(x: np.ndarray) -> np.ndarray:
        high, low = (f(x, size, axis=-1, mode="wrap") for f in (maximum_filter1d, minimum_filter1d))
        return np.asarray(np.max(high - low, axis=-1))

    ends = [np.ptp(curve, axis=-1), within(curve), within(curve - long), np.ptp(long, axis=-1)]
    return np.stack(ends, -1)


def shrunk(
    value: Shaped[np.ndarray, " n"], std: Float[np.ndarray, " n"], sparse: Sequence[float] = (0.0,)
) -> Shaped[np.ndarray, "draws n"]:
    """Return draws of true values of which `value` was read with noise.

    The real and the imaginary part of complex values have the standard error `std` each, and a
    common prior width. `sparse`: how many further values are counted as zero, in equal parts of the
    draws, since the values tell the number of zeros among them only roughly.
    """
    random, std = np.random.default_rng(0), np.maximum(std, 1e-9 * np.abs(value).max() + 1e-100)
    floor = float(np.median(std))
    parts = 1 + np.iscomplexobj(value)
    top = max(float(np.abs(value).max()), floor)
    widths = np.append(0.0, np.geomspace(floor / 4, 2 * top, _WIDTHS))
    variance = std[:, None] ** 2 + widths**2
    size = -0.5 * (np.abs(value[:, None]) ** 2 / variance + parts * np.log(variance))
    likely = np.exp(size - size.max(axis=1, keepdims=True))
    kept = np.empty((DRAWS, len(value)))
    for number, zeros in enumerate(sparse):
        share = np.full(len(widths), 1 / len(widths))
        extra = _EVEN * share + zeros * (widths == 0)
        for _ in range(_ROUNDS):
            own = likely * share
            own = np.sum(own / own.sum(axis=1, keepdims=True), axis=0)
            share = (own + extra) / (len(value) + extra.sum())
        steps = np.cumsum(likely * share, axis=1)
        part = kept[number :: len(sparse)]
        place = random.uniform(size=(*part.shape, 1)) * steps[:, -1:]
        part[:] = 1 - std**2 / (std**2 + widths[np.sum(place > steps, axis=2)] ** 2)
    normal = random.standard_normal((parts, *kept.shape))
    noise = normal[0] + 1j * normal[1] if parts > 1 else normal[0]
    return kept * value + np.sqrt(kept) * std * noise


def single_flank_numbers(
    value: Complex[np.ndarray, " n"],
    std: Float[np.ndarray, " n"],
    cycles: Int[np.ndarray, " n"],
    pitches: int,
    points: int,
    short: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "4 terms"]:
    """Return the terms of `single_flank` of a series whose harmonics were read with noise.

    **Arguments**
    - `value`: c of Re c e^{jkφ} of all harmonics. - `std`: standard error of their parts.
    - `cycles`: their k, whole cycles in the period; 0 for a harmonic that is left out.
    - `pitches`: pitches in the period; 0 without teeth. - `points`: points at which the series is
      summed. - `short`: which harmonics have a period of at most a pitch, and priors of their own.

    **Returns** the terms as read, their values without what noise adds, and the ends of their 95 %
    intervals.
    """
    random, true = np.random.default_rng(1), np.zeros((DRAWS, len(value)), complex)
    for part in filter(np.any, (short, ~short)):
        zeros = [one * math.sqrt(part.sum()) for one in _SPARSE]
        true[:, part] = shrunk(value[part], std[part], zeros)
    normal = random.standard_normal((2, *true.shape))
    noise = std * np.exp(_SCALE * random.standard_normal((DRAWS, 1)))
    whole = np.concatenate([value[None], true, true + noise * (normal[0] + 1j * normal[1])])
    batch, terms, long = max(1, 2**20 // points), [], cycles < pitches / 2
    for start in range(0, len(whole), batch):
        part = whole[start : start + batch] * (cycles > 0) * (points / 2)
        # Without teeth there are no long waves.
        waves = np.zeros((1 + bool(pitches), len(part), points // 2 + 1), complex)
        waves[:, :, cycles] = np.stack([part, part * long])[: len(waves)]
        curves = np.fft.irfft(waves, points)
        terms.append(single_flank(curves[0], curves[-1], pitches))
    read, *others = np.concatenate(terms)
    sizes, again = np.reshape(others, (2, DRAWS, -1))
    # Where one wave has large noise that happens to be small, the terms as read are less than noise
    # usually adds. The true terms are still not less than what the other waves tell.
    least = np.quantile(sizes, [0.025, 0.0, 0.975], axis=0)
    return np.maximum(_numbers(read, again - sizes), np.concatenate([0 * read[None], least]))


def _numbers(
    read: Float[np.ndarray, " terms"], off: Float[np.ndarray, "draws terms"]
) -> Float[np.ndarray, "4 terms"]:
    """Return terms as read, without the median of what noise adds, and ends of their intervals."""
    ends = read - np.quantile(off, [0.5, 0.975, 0.025], axis=0)
    return np.concatenate([read[None], np.maximum(ends, 0.0)])


def axis_terms(
    mean: Float[np.ndarray, "*b targets 2"], std: Float[np.ndarray, "*b targets 2"]
) -> Float[np.ndarray, "*b terms"]:
    """Return B, M, E, R and A of the means and standard deviations (up, down) at the targets.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.kinematics.accuracy import axis_terms
    >>> mean = np.array([[0.0, -3.0], [4.0, 2.0]])
    >>> axis_terms(mean, np.ones((2, 2))).tolist()
    [3.0, 4.5, 7.0, 7.0, 11.0]

    ```
    """
    gap, both = np.abs(mean[..., 0] - mean[..., 1]), (-2, -1)
    repeat = np.maximum(2 * std.sum(axis=-1) + gap, 4 * std.max(axis=-1))
    ends = np.max(mean + 2 * std, axis=both) - np.min(mean - 2 * std, axis=both)
    middle, means = np.ptp(mean.mean(axis=-1), axis=-1), np.ptp(mean, axis=both)
    return np.stack([gap.max(axis=-1), middle, means, repeat.max(axis=-1), ends], -1)


def axis_numbers(
    mean: Float[np.ndarray, "targets 2"],
    std: Float[np.ndarray, "targets 2"],
    count: Real[np.ndarray, "targets 2"],
    free: Real[np.ndarray, "targets 2"],
) -> Float[np.ndarray, "4 terms"]:
    """Return the terms of `axis_terms` as read, without what noise adds, and their 95 % intervals.

    **Arguments**
    - `mean`, `std`, `count`: mean, standard deviation and number of the readings at each target, up
      and down. - `free`: degrees of freedom of `std`.
    """
    random = np.random.default_rng(0)
    log = 2 * np.log(np.maximum(std, 1e-9 * std.max()))
    over = np.sum((log - log.mean()) ** 2) / random.chisquare(log.size - 1, (DRAWS, 1, 1))
    over -= np.mean(polygamma(1, free / 2))  # trigamma(d/2) is about 2/d
    prior = 2 / np.clip(over, 1e-6, 2.0)
    pooled = np.sum(free * std**2) / random.chisquare(free.sum(), (DRAWS, 1, 1))
    variance = prior * pooled + free * std**2
    variance /= random.chisquare(prior + free, (DRAWS, *std.shape))
    noise = np.sqrt(np.mean(variance / count) / 2)
    waves: Any = dct(np.stack([mean.sum(axis=1), mean[:, 0] - mean[:, 1]]) / 2, norm="ortho")
    drawn = shrunk(waves[:, 1:].ravel(), np.full(2 * len(mean) - 2, noise))
    level = waves[:, :1] + noise * random.standard_normal((DRAWS, 2, 1))
    drawn = np.concatenate([level, drawn.reshape(DRAWS, 2, -1)], axis=2)
    middle, half = np.moveaxis(np.asarray(idct(drawn, norm="ortho"), float), 1, 0)
    true = np.stack([middle + half, middle - half], axis=-1)
    again = true + np.sqrt(variance / count) * random.standard_normal(true.shape)
    spread = np.sqrt(variance * random.chisquare(free, true.shape) / free)
    off = axis_terms(again, spread) - axis_terms(true, np.sqrt(variance))
    found = _numbers(axis_terms(mean, std), off)
    # Where an axis without error reads as much by chance, it may have none.
    chance = np.quantile(perfect_axis(count, free), 0.975, axis=0) * np.sqrt(np.mean(std**2))
    found[2, :3] = np.where(found[0] <= chance, 0.0, found[2])[:3]
    return found


def perfect_axis(
    count: Real[np.ndarray, "targets 2"], free: Real[np.ndarray, "targets 2"], draws: int = 2000
) -> Float[np.ndarray, "draws terms"]:
    """Return terms of an axis without error, of drawn readings that have the noise 1.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.kinematics.accuracy import AXIS, perfect_axis
    >>> count = np.full((10, 2), 5)
    >>> perfect_axis(count, count - 1).mean(axis=0).round(1).tolist()  # B, M, E, R, A
    [1.2, 1.0, 1.7, 6.6, 7.0]

    ```
    """
    random = np.random.default_rng(0)
    mean = random.standard_normal((draws, *count.shape)) / np.sqrt(count)
    return axis_terms(mean, np.sqrt(random.chisquare(free, mean.shape) / free))
