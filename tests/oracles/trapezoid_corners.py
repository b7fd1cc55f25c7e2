"""A driving motion as plain numbers: piece by piece of constant acceleration, from its corners."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass
class Corners:
    """Speed in straight lines between `times` in s, `speeds` in rad/s; starts at `angle` in rad."""

    times: Sequence[float]
    speeds: Sequence[float]
    angle: float = 0.0
    angles: list[float] = field(init=False)
    gains: list[float] = field(init=False)

    def __post_init__(self) -> None:
        self.angles, self.gains = [self.angle], []
        for piece, (begin, end) in enumerate(zip(self.times, self.times[1:], strict=False)):
            first, last = self.speeds[piece : piece + 2]
            self.angles.append(self.angles[-1] + (end - begin) * (first + last) / 2)
            self.gains.append((last - first) / (end - begin))

    def at(self, time: float) -> tuple[float, float, float]:
        """Angle, speed and acceleration; at a corner those of what begins."""
        last = len(self.times) - 2
        piece = min(max(bisect.bisect_right(self.times, time) - 1, 0), last)
        spent, gain, speed = time - self.times[piece], self.gains[piece], self.speeds[piece]
        angle = self.angles[piece] + spent * (speed + 0.5 * gain * spent)
        return angle, speed + gain * spent, gain
