"""The involute from its definition, in 50 digits: a taut string unwound from the base circle.

After unwinding by t the end of the string that started at (r_b, 0) is at

    r_b (cos t, sin t) + r_b t (sin t, −cos t),

the point where the string leaves the circle plus its free length along the tangent. The curve is
turned so that the tooth has its half thickness π m/4 + shift tan α − δ on the reference circle.
Nothing is known of racks, rolling or the function inv α.
"""

from dataclasses import dataclass

import mpmath as mp

DIGITS = 50


@dataclass(frozen=True)
class Flank:
    """Right flank of a tooth that points along y; lengths mm, α in degrees. A left one mirrored."""

    teeth: int
    module: float
    pressure_angle_deg: float
    shift: float = 0.0
    recession: float | mp.mpf = 0.0

    def distance(self, x: float, y: float) -> float:
        """Distance of a point from the flank, mm."""
        with mp.workdps(DIGITS):
            target = mp.matrix([mp.mpf(x), mp.mpf(y)])
            start = mp.sqrt((mp.norm(target) / self._base()) ** 2 - 1)
            return float(mp.norm(self._point(self._nearest(target, start)) - target))

    def _nearest(self, target: mp.matrix, start: mp.mpf) -> mp.mpf:
        """Unwinding at which the string points at the target: the foot of the normal."""

        def slant(t: mp.mpf) -> mp.mpf:
            off = target - self._point(t)
            along = self._point(t + step) - self._point(t - step)
            return (off[0] * along[0] + off[1] * along[1]) / step

        step = mp.mpf(10) ** -18
        return mp.findroot(slant, (start, start + mp.mpf(10) ** -12), tol=mp.mpf(10) ** -40)

    def _point(self, t: mp.mpf) -> mp.matrix:
        """Turned into the frame of the tooth: clockwise is to the right, the string winds back."""
        wanted = self._half_thickness() / self._reference()
        at_reference = self._string(mp.sqrt((self._reference() / self._base()) ** 2 - 1))
        turn = wanted + mp.atan2(at_reference[1], at_reference[0])
        x, y = self._string(t)
        clockwise = turn - mp.atan2(y, x)
        radius = mp.hypot(x, y)
        return mp.matrix([radius * mp.sin(clockwise), radius * mp.cos(clockwise)])

    def _string(self, t: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
        cosine, sine, base = mp.cos(t), mp.sin(t), self._base()
        return base * (cosine + t * sine), base * (sine - t * cosine)

    def _alpha(self) -> mp.mpf:
        return mp.mpf(self.pressure_angle_deg) * mp.pi / 180

    def _reference(self) -> mp.mpf:
        return mp.mpf(self.module) * self.teeth / 2

    def _base(self) -> mp.mpf:
        return self._reference() * mp.cos(self._alpha())

    def _half_thickness(self) -> mp.mpf:
        quarter = mp.pi * mp.mpf(self.module) / 4
        return quarter + mp.mpf(self.shift) * mp.tan(self._alpha()) - mp.mpf(self.recession)
