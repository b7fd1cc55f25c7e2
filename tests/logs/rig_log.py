"""One rig with known numbers, and its log in the layouts of recording programs."""

import numpy as np

RATIO = 9 / 16
GAP_DEG = 0.061
HZ = 100.0


def angles_deg(shift_s: float = 0.0, turns: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time in s, and both angles in deg at `time + shift_s`: forth and back at 60 and 40 rpm."""
    driving, sense, start = [], [], 0.0
    for speed in (360.0, -360.0, 240.0, -240.0):
        steps = int(turns * 360 / abs(speed) * HZ)
        driving.append(start + speed * (np.arange(1, steps + 1) / HZ + shift_s))
        sense.append(np.full(steps, np.sign(speed)))
        start += speed * steps / HZ
    x, way = np.concatenate(driving), np.concatenate(sense)
    error = 0.0085 * np.sin(np.radians(x) + 0.7) + 0.0121 * np.sin(np.radians(x * RATIO) + 1.9)
    y = x * RATIO + error + np.where(way > 0, 0.0, GAP_DEG)
    return np.arange(len(x)) / HZ, x, y


def csv(header: str, *columns, mark: str = ",", digits: int = 6) -> str:
    """Text of a table; whole numbers and texts as they are."""
    texts = [
        [one if isinstance(one, str) else f"{one:d}" for one in column]
        if isinstance(column[0], str | int | np.integer)
        else [f"{one:.{digits}f}" for one in column]
        for column in columns
    ]
    return header + "\n" + "".join(mark.join(row) + "\n" for row in zip(*texts, strict=True))
