"""Prior of the parameters of a fit, as numbers and in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...base.units import ARCSEC, DEG
from ...pair.gear_pair import Drive, GearPair

SHAFTS = ("driving", "driven")
_LARGEST_ANGLE_ARCSEC = 3600.0  # 1°, chosen
_LONGEST_DELAY_S = 1.0  # s, chosen

OPTIONS = {
    "eccentricity_mm": "--largest-eccentricity-mm",
    "flat_in": "--prior",
    "amplitude_arcsec": "--largest-amplitude-arcsec",
    "encoder_arcsec": "--encoder-arcsec",
    "backlash_deg": "--largest-backlash-deg",
}
"""Field of `Prior` → option of `vttig sample`."""


@dataclass(frozen=True)
class Prior:
    """Priors of the physical parameters.

    The priors of the noise are always flat in its log std and its partial autocorrelations.

    **Arguments**
    - `eccentricity_mm`: largest eccentricity of a gear, mm; by default half the module.
    - `flat_in`: "plane" is a flat density over (x, y), so that the density of the amplitude is
      proportional to the amplitude; "amplitude" is a flat density of the amplitude.
    - `amplitude_arcsec`: largest amplitude of a first order of a drive, ″; also the largest encoder
      error if the pair names no accuracy.
    - `encoder_arcsec`: standard deviation of both components of an encoder's error, ″; by default
      the `accuracy_arcsec` of the pair, and flat if the pair has none.
    - `backlash_deg`: largest absolute value of the constant backlash, °.

    **Raises** `ValueError` that names the argument.
    """

    eccentricity_mm: float | None = None
    flat_in: Literal["plane", "amplitude"] = "plane"
    amplitude_arcsec: float = _LARGEST_ANGLE_ARCSEC
    encoder_arcsec: float | None = None
    backlash_deg: float = 5.0

    def __post_init__(self):
        if self.flat_in not in ("plane", "amplitude"):
            raise ValueError(
                f'Argument `flat_in` must be "plane" or "amplitude", but is {self.flat_in!r}.'
            )
        for name in ("eccentricity_mm", "amplitude_arcsec", "encoder_arcsec", "backlash_deg"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ValueError(f"Argument `{name}` must be positive, but is {value!r}.")


@dataclass(frozen=True)
class Disc:
    """Prior of two coordinates (x, y): flat within the radius `bound`, or normal with `std`.

    `bound` and `std` are in internal units (mm, rad). If `flat_in_amplitude`, the density is flat
    in the amplitude instead of flat in the plane. `field` names the field of `Prior` that gives
    `bound` or `std`; `words` describes this prior.
    """

    name: str
    coordinates: tuple[str, str]
    field: str
    words: str
    bound: float = np.inf
    std: float = np.inf
    flat_in_amplitude: bool = False


@dataclass(frozen=True)
class StatedPrior:
    """Prior of the coordinates of one fit.

    **Arguments**
    - `discs`: priors of the (x, y) pairs: eccentricities, encoder errors and first orders.
    - `bounds`: largest absolute value of every other coordinate, by name (radians or seconds).
    - `sentences`: the prior in words.
    """

    discs: tuple[Disc, ...]
    bounds: dict[str, float]
    sentences: tuple[str, ...]

    @property
    def fields(self) -> frozenset[str]:
        """Fields of `Prior` that have an effect on these coordinates."""
        found = {disc.field for disc in self.discs}
        if any(not disc.name.endswith("_encoder") for disc in self.discs):
            found.add("flat_in")
        if "constant_backlash" in self.bounds:
            found.add("backlash_deg")
        return frozenset(found)


def state_prior(
    prior: Prior, pair: GearPair | Drive, names: Sequence[str], delay_s: float
) -> StatedPrior:
    """Return the prior of the coordinates `names`.

    `delay_s` is the delay that the fit has already removed, s; it widens the bound of "delay".
    """
    discs = []
    for shaft in SHAFTS:
        for kind in ("", "_difference"):
            plane = (f"{shaft}_x{kind}", f"{shaft}_y{kind}")
            if plane[0] in names:
                discs.append(_first_order(prior, pair, shaft + kind, plane))
        if f"{shaft}_encoder_x" in names:
            discs.append(_encoder(prior, pair, shaft))
    sentences = [disc.words for disc in discs]
    bounds = {}
    if "constant_backlash" in names:
        bounds["constant_backlash"] = prior.backlash_deg * DEG
        sentences.append(f"constant backlash: flat within ±{prior.backlash_deg:g}°")
    if "delay" in names:
        bounds["delay"] = _LONGEST_DELAY_S + abs(delay_s)
        sentences.append(f"delay: flat within ±{_LONGEST_DELAY_S:g} s")
    sentences.append("noise: flat in the logarithm of its std and in partial autocorrelations")
    return StatedPrior(tuple(discs), bounds, tuple(sentences))


def _first_order(prior: Prior, pair: GearPair | Drive, source: str, plane: tuple[str, str]) -> Disc:
    flat = prior.flat_in == "amplitude"
    shape = "flat in its amplitude" if flat else "flat in the plane"
    label = source.replace("_", " ")
    if isinstance(pair, Drive):
        bound = prior.amplitude_arcsec
        words = f"{label} first order: {shape} up to {bound:g}″"
        return Disc(
            name=source,
            coordinates=plane,
            field="amplitude_arcsec",
            words=words,
            bound=bound * ARCSEC,
            std=np.inf,
            flat_in_amplitude=flat,
        )
    bound = prior.eccentricity_mm
    if bound is None:
        bound = 0.5 * float(pair.module_mm)
    words = f"{label} eccentricity: {shape} up to {bound:g} mm"
    return Disc(
        name=source,
        coordinates=plane,
        field="eccentricity_mm",
        words=words,
        bound=bound,
        std=np.inf,
        flat_in_amplitude=flat,
    )


def _encoder(prior: Prior, pair: GearPair | Drive, shaft: str) -> Disc:
    std = prior.encoder_arcsec
    if std is None:
        encoder = getattr(pair, shaft).encoder
        std = None if encoder is None else encoder.accuracy_arcsec
    name = f"{shaft}_encoder"
    plane = (f"{name}_x", f"{name}_y")
    if std is None:
        bound = prior.amplitude_arcsec
        words = f"{shaft} encoder: flat in the plane up to {bound:g}″ (no accuracy given)"
        return Disc(name, plane, "amplitude_arcsec", words, bound * ARCSEC)
    words = f"{shaft} encoder: normal, {std:g}″ in each component"
    return Disc(name, plane, "encoder_arcsec", words, std=std * ARCSEC)
