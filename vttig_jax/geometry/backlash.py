"""Backlash from the tooth thickness of both gears, by section and of the pair, and its inverse."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Real

from ..base.arrays import compiled
from ..base.errors import PairError
from ..base.files.text_tables import key_values, text_table
from ..base.units import DEG
from ..pair.gear_pair import GearPair
from .mounting import Mounting
from .tooth import Scalar

TOUCHING = 1e-9
"""Angle, rad, within which flanks touch: they interfere only if they overlap by more (chosen)."""

# Chosen values:
_REPORTED = 11  # sections reported by default
_POSITIONS = 257  # positions over the stroke; the backlash is assumed monotonic between them
_STEP = 1e-13  # tolerance of the position in the root search, mm
_ROUNDING = 1e-12  # excess, rad, treated as zero so that the ends of the stroke are found


@compiled
def section_backlash(
    pair: GearPair,
    z_mm: Real[ArrayLike, "*shape"],
    centre_distance_mm: Real[ArrayLike, ""] | None = None,
    axial_mm: Real[ArrayLike, ""] = 0.0,
) -> Float[Array, "*shape"]:
    """Return the backlash of each section alone, without eccentricity, rad of the driven gear.

        j(z) = [2π r_w1/z₁ − Σ over flanks of (r_w1 ψ₁(r_w1, z) + r_w2 ψ₂(r_w2, −z − s))]/r_w2

    ψ are the half angles of `Tooth` on the working pitch circles, r_w1 + r_w2 = a. The backlash is
    negative if the teeth are thicker than the space. Crowned or unequal gears can touch on flank A
    and flank B in different sections; `geometric_backlash` gives the backlash of the pair.

    **Arguments**
    - `pair`: gear pair.
    - `z_mm`: heights from the middle of the driving face, any shape.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `axial_mm`: axial shift s of the driven gear towards the driving gear's thick end.

    **Returns** backlash in rad, shape of `z_mm`; NaN outside the common face.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import section_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20, crowning_um=10), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> np.degrees(section_backlash(pair, np.array([-10.0, 0.0, 10.0, 11.0]))).round(5)
    array([0.07711, 0.06279, 0.07711,     nan])

    ```
    """
    z, axial = jnp.asarray(z_mm, float), jnp.asarray(axial_mm, float)
    distance = _distance(pair, centre_distance_mm)
    backlash = jnp.vectorize(lambda z: _touching_at(pair, distance, axial, jnp.stack([z, z])))(z)
    low, high = _common_face(pair, axial)
    known = ~jnp.isnan(_face_widths(pair)).all()
    tolerance = 1e-12 * distance
    return jnp.where(known & ((z < low - tolerance) | (z > high + tolerance)), jnp.nan, backlash)


def geometric_backlash(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
) -> Float[Array, "..."]:
    """Return the backlash of the pair from its tooth thicknesses, rad of the driven gear.

        j = [2π r_w1/z₁ − Σ over flanks of max over z of (r_w1 ψ₁(z) + r_w2 ψ₂(−z − s))]/r_w2

    z is in the common face; the gears have no eccentricity. For linear recessions the backlash is
    j(0) − s (tan β_L + tan β_R)/R₂ of (16) at every s. For crowned gears each flank touches where
    both gears together are thickest. A negative backlash is an interference of the teeth.

    **Arguments**
    - `pair`: gear pair.
    - `centre_distance_mm`: centre distance a, any shape; the drawn one when absent.
    - `axial_mm`: axial shift s, broadcast against the centre distance; s > 0 closes the backlash.

    **Returns** backlash in rad; multiplied by R₂ it is the backlash at the reference circle. NaN
    where the faces do not overlap.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import geometric_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> np.degrees(geometric_backlash(pair, axial_mm=np.array([0.0, 0.5, 1.0]))).round(5)
    array([ 0.06279,  0.02525, -0.01228])
    >>> np.degrees(geometric_backlash(pair, np.array([125.0, 125.3]))).round(5) + 0.0
    array([0.     , 0.15781])

    ```
    """
    return backlash_and_contact(pair, centre_distance_mm, axial_mm)[0]


@compiled
def backlash_and_contact(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape 2"]]:
    """Return `geometric_backlash`, rad, and the contact heights of flank A and flank B, mm."""

    def at(distance: Scalar, axial: Scalar) -> tuple[Scalar, Float[Array, "flank=2"]]:
        low, high = _common_face(pair, axial)
        z = _contact_heights(pair, axial, low, high)
        return jnp.where(low <= high, _touching_at(pair, distance, axial, z), jnp.nan), z

    positions = _distance(pair, centre_distance_mm), jnp.asarray(axial_mm, float)
    return jnp.vectorize(at, signature="(),()->(),(2)")(*positions)


def _distance(pair: GearPair, given: Real[ArrayLike, "..."] | None) -> Array:
    return jnp.asarray(pair.centre_distance_mm if given is None else given, float)


def _touching_at(
    pair: GearPair, distance: Scalar, axial: Scalar, z: Float[Array, "flank=2"]
) -> Scalar:
    """Return the backlash of teeth that touch at heights z, mm, on flank A and flank B, rad.

    It is that of teeth without taper, and the recession of both gears over R₂ at any centre
    distance, because r_w1/R₁ = r_w2/R₂.
    """
    untapered = eqx.tree_at(lambda tree: tree.centre_distance_mm, pair, distance)
    slopes, curvatures = _tapers(pair)
    driven = -(z + axial)
    crowning = (curvatures[0] * z**2 + curvatures[1] * driven**2) / 2
    recession = slopes[0] * z + slopes[1] * driven + crowning
    return jnp.asarray(untapered.drawing_backlash + recession.sum() / pair.reference_radii[1])


def _contact_heights(
    pair: GearPair, axial: Scalar, low: Scalar, high: Scalar
) -> Float[Array, "flank=2"]:
    """Return the heights z, mm, between two ends at which flank A and flank B have least clearance.

    The recession of both gears together is a parabola in z. If it is the same in all sections, the
    middle is taken.
    """
    slopes, curvatures = _tapers(pair)
    middle, curvature = (low + high) / 2, curvatures.sum()
    rise = slopes[0] - slopes[1] + curvature * middle + curvatures[1] * axial
    curved = curvature > 0
    to_lowest = -rise / jnp.where(curved, curvature, 1.0)
    to_end = -jnp.sign(rise) * (high - low)
    return jnp.clip(middle + jnp.where(curved, to_lowest, to_end), low, high)


def _tapers(pair: GearPair) -> tuple[Float[Array, "gear=2 flank=2"], Float[Array, "gear=2"]]:
    """Return tan β of both gears on flanks A and B, and the curvature 8 c/b² of their crowning."""
    gears = pair.driving, pair.driven
    helices = jnp.array([[gear.helix_left_deg, gear.helix_right_deg] for gear in gears])
    crowning = jnp.array([gear.crowning_um for gear in gears]) * 1e-3
    widths = _face_widths(pair)
    widths = jnp.where(jnp.isnan(widths), 1.0, widths)
    return jnp.tan(helices * DEG), 8 * crowning / widths**2


def _face_widths(pair: GearPair) -> Float[Array, "gear=2"]:
    return jnp.stack([jnp.asarray(g.face_width_mm) for g in (pair.driving, pair.driven)])


def _common_face(pair: GearPair, axial: Scalar) -> tuple[Scalar, Scalar]:
    """Return the lowest and highest z of the common face; see `Mounting.face`."""
    centre = jnp.zeros((), complex)
    return Mounting(pair.centre_distance_mm, axial, centre, centre, _face_widths(pair) / 2).face()


def axial_for_backlash(
    pair: GearPair,
    backlash_rad: float,
    centre_distance_mm: float | None = None,
    *,
    least_overlap_mm: float = 0.0,
) -> float:
    """Return the axial shift s, mm, closest to 0 at which `geometric_backlash` has a given value.

    The search covers all positions with a face overlap of `least_overlap_mm` or more. If a face
    width is missing, the stroke is unlimited and the recession is assumed linear.

    **Arguments**
    - `pair`: gear pair.
    - `backlash_rad`: required backlash, rad of the driven gear.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `least_overlap_mm`: smallest permitted overlap of the faces.

    **Raises** `PairError` if no position has this backlash; the message states the possible range.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry import axial_for_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> round(axial_for_backlash(pair, math.radians(0.02)), 4)
    0.57
    >>> try:
    ...     axial_for_backlash(pair, math.radians(1.0), least_overlap_mm=15.0)
    ... except PairError as error:
    ...     print(error)
    backlash: 1° cannot be reached; with 15 mm of common face or more (s from -5 to 5 mm) it is
    -0.3126° to 0.4381°.

    ```
    """

    def excess(axial: Array, _: None = None) -> Array:
        return geometric_backlash(pair, centre_distance_mm, axial) - backlash_rad

    wanted, widths = f"{backlash_rad / DEG:g}°", np.asarray(_face_widths(pair))
    if np.isnan(widths).any():
        at_0, at_1 = map(float, excess(jnp.array([0.0, 1.0])))
        if at_0 != at_1:
            return at_0 / (at_0 - at_1)
        raise PairError(
            f"{wanted} cannot be reached; these teeth do not thin along the axis, so it is"
            f" {(at_0 + backlash_rad) / DEG:.4f}° at every position.",
            where="backlash",
        )
    if not 0 <= least_overlap_mm <= widths.min():
        raise PairError(
            f"{least_overlap_mm:g} mm is not between 0 and the narrower face width of"
            f" {widths.min():g} mm; give an overlap in this range.",
            where="least_overlap_mm",
        )
    stroke = float(widths.sum() / 2 - least_overlap_mm)
    positions = np.linspace(-stroke, stroke, _POSITIONS)
    values = np.asarray(excess(jnp.asarray(positions)))
    if np.isnan(values).any():
        raise PairError(
            "the working pitch circle lies below a base circle; move the axes apart.",
            where="centre_distance_mm",
        )
    values = np.where(np.abs(values) <= _ROUNDING, 0.0, values)
    crossings = np.flatnonzero(values[:-1] * values[1:] <= 0)
    if not len(crossings):
        low, high = (float(end + backlash_rad) / DEG for end in (values.min(), values.max()))
        raise PairError(
            f"{wanted} cannot be reached; with {least_overlap_mm:g} mm of common face or more"
            f" (s from {-stroke:g} to {stroke:g} mm) it is {low:.4f}° to {high:.4f}°.",
            where="backlash",
        )
    distances = np.minimum(np.abs(positions[crossings]), np.abs(positions[crossings + 1]))
    first = int(crossings[np.argmin(distances)])
    for end in (first, first + 1):
        if values[end] == 0:
            return float(positions[end])
    ends = {"lower": positions[first], "upper": positions[first + 1]}
    solver = optx.Bisection(rtol=_STEP, atol=_STEP)
    return float(optx.root_find(excess, solver, jnp.asarray(positions[first]), options=ends).value)


@dataclass(frozen=True)
class GapReport:
    """Backlash at one centre distance and axial position without eccentricity.

    **Arguments**
    - `centre_distance_mm`, `axial_mm`: centre distance a and axial shift s.
    - `backlash`: backlash of the pair, rad of the driven gear; negative if the teeth interfere.
    - `reference_radius_mm`: radius R₂, which converts rad to mm.
    - `contact_z_mm`: heights at which flank A and flank B have the least clearance.
    - `z_mm`: heights of sections over the common face.
    - `section_backlash`: backlash of each section alone, rad.
    - `apparent`: constant backlash estimated by a fit, rad, or None.
    - `logged_axial_mm`, `logged_backlash`: axial shift of the log and drawn backlash there, rad.
    - `opening_mm`: increase of the backlash at the reference circle, mm, per mm of −s.
    """

    centre_distance_mm: float
    axial_mm: float
    backlash: float
    reference_radius_mm: float
    contact_z_mm: Float[np.ndarray, "2"]
    z_mm: Float[np.ndarray, " n"]
    section_backlash: Float[np.ndarray, " n"]
    apparent: float | None
    logged_axial_mm: float
    logged_backlash: float
    opening_mm: float

    @property
    def backlash_mm(self) -> float:
        """Backlash at the reference circle of the driven gear, mm."""
        return self.backlash * self.reference_radius_mm

    @property
    def interferes(self) -> Bool[np.ndarray, " n"]:
        """Whether the teeth of each section are thicker than the space, beyond rounding."""
        return self.section_backlash < -TOUCHING

    @property
    def difference(self) -> float | None:
        """Apparent minus drawn backlash, rad; None without a fit.

        Its causes are thinner teeth, a larger centre distance, torsional wind-up and bearing play.
        """
        return None if self.apparent is None else self.apparent - self.logged_backlash

    def __str__(self) -> str:
        radius = self.reference_radius_mm
        pairs = [
            ("centre distance", f"{self.centre_distance_mm:g} mm"),
            ("axial position", f"{self.axial_mm:g} mm"),
            ("backlash", f"{self.backlash / DEG:z.4f}° = {self.backlash_mm:z.4f} mm"),
            ("least room at z", "A {:z.3f} mm, B {:z.3f} mm".format(*self.contact_z_mm)),
        ]
        if self.difference is not None and self.apparent is not None:
            pairs.append(("apparent, of the fit", f"{self.apparent / DEG:.4f}°"))
            thinner = self.difference * radius
            text = f"{self.difference / DEG:+.4f}° = {thinner:+.4f} mm of tooth thickness"
            if self.opening_mm:
                text += f" or {-thinner / self.opening_mm:+.3f} mm of s"
            pairs.append((f"less that drawn at s = {self.logged_axial_mm:g}", text))
        marks = np.where(self.interferes, "interferes", "")
        rows = [
            (f"{z:.3f}", f"{gap / DEG:z.4f}", f"{gap * radius:z.4f}", mark)
            for z, gap, mark in zip(self.z_mm, self.section_backlash, marks, strict=True)
        ]
        headers = [("z", "mm"), ("backlash", "°"), ("backlash", "mm"), ""]
        table = text_table(rows, headers, align="rrrl")
        return f"{key_values(pairs, title='backlash from the teeth')}\n{table}"


def gap_report(
    pair: GearPair,
    centre_distance_mm: float | None = None,
    axial_mm: float = 0.0,
    *,
    apparent_deg: float | None = None,
    logged_axial_mm: float = 0.0,
    sections: int = _REPORTED,
) -> GapReport:
    """Report the backlash of a pair at one position, section by section.

    **Arguments**
    - `pair`: gear pair.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `axial_mm`: axial shift s, positive towards the driving gear's thick end.
    - `apparent_deg`: j_c of a fit, compared with the drawn backlash at the position of the log.
    - `logged_axial_mm`: axial shift s of the log.
    - `sections`: number of sections over the common face.

    **Raises** `ValueError` if the faces do not overlap, `PairError` if the axes are too close.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import gap_report
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20, crowning_um=10), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> print(gap_report(pair, axial_mm=0.9, apparent_deg=0.038, sections=3))
    backlash from the teeth
      centre distance           125.12 mm
      axial position            0.9 mm
      backlash                  -0.0048° = -0.0067 mm
      least room at z           A 0.000 mm, B 0.000 mm
      apparent, of the fit      0.0380°
      less that drawn at s = 0  -0.0248° = -0.0346 mm of tooth thickness or +0.330 mm of s
     z [mm]  backlash [°]  backlash [mm]
    -10.000        0.0095         0.0133
     -0.450       -0.0047        -0.0066  interferes
      9.100        0.0071         0.0099

    ```
    """
    distance = float(pair.centre_distance_mm if centre_distance_mm is None else centre_distance_mm)
    low, high = (float(end) for end in _common_face(pair, jnp.asarray(axial_mm, float)))
    if not low <= high:
        raise ValueError(
            f"Argument `axial_mm` must leave the faces some overlap, but is {axial_mm:g}, at which"
            f" they are {low - high:g} mm apart."
        )
    heights = np.linspace(low, high, sections if high > low else 1)
    # All positions are evaluated in one array, so that the function is compiled for one shape.
    shifts = np.append(axial_mm + np.array([0.0, -1e-3, 1e-3]), logged_axial_mm)
    values, contact = map(np.asarray, backlash_and_contact(pair, distance, shifts))
    backlash, opened, closed, logged = map(float, values)
    if np.isnan(backlash):
        raise PairError(
            f"{distance:g} mm puts a working pitch circle below a base circle; move the axes"
            " apart.",
            where="centre_distance_mm",
        )
    by_section = section_backlash(pair, heights, distance, axial_mm)
    radius = float(pair.reference_radii[1])
    return GapReport(
        centre_distance_mm=distance,
        axial_mm=axial_mm,
        backlash=backlash,
        reference_radius_mm=radius,
        contact_z_mm=contact[0],
        z_mm=heights,
        section_backlash=np.asarray(by_section),
        apparent=None if apparent_deg is None else apparent_deg * DEG,
        logged_axial_mm=logged_axial_mm,
        logged_backlash=logged,
        opening_mm=(opened - closed) / 2e-3 * radius,
    )
