"""Effects in the transmission error that a slip is fitted together with, as a compact matrix.

Most columns of the design matrix are zero in most rows: a sample belongs to one group of segments
and to one flank. Only the waves of both shafts are stored, once for both flanks.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.units import REV
from ..encoder_log import EncoderLog

ORDERS = 4
"""Number of orders of each shaft in the fit."""


@dataclass(frozen=True, eq=False)
class Effects:
    """Design matrix of all effects in TE except a slip, with columns scaled to about 1.

    The columns are an offset of every group, drift, speed, cosine and sine of every order on each
    flank, and the torque if it was logged.

    **Arguments**
    - `group`: number of the group of every row, and `groups`: how many there are.
    - `flank`: index of the flank of every row, and `flanks`: how many there are.
    - `plain`: time and speed, shape (2, m). - `waves`: cosines and sines, shape (w, m).
    - `torque`: torque, shape (t, m) with t = 1, or t = 0 if it was not logged.
    """

    group: Int[np.ndarray, " m"]
    groups: int
    flank: Int[np.ndarray, " m"]
    flanks: int
    plain: Float[np.ndarray, "2 m"]
    waves: Float[np.ndarray, "w m"]
    torque: Float[np.ndarray, "t m"]

    @classmethod
    def of(
        cls,
        log: EncoderLog,
        rows: Int[np.ndarray, " m"],
        group: Int[np.ndarray, " m"],
        forward: Bool[np.ndarray, " m"],
    ) -> "Effects":
        """Return the effects at the samples `rows` of a log.

        `group` and `forward` hold the group of every sample and whether flank A is in contact.
        """
        time, speed = log.time[rows], log.driving_speed.value[rows]
        drift = (time - time.mean()) / max(float(np.ptp(time)), 1e-300)
        both = forward.any() and not forward.all()
        return cls(
            group=group,
            groups=int(group.max()) + 1,
            flank=(~forward).astype(np.int64) if both else np.zeros(len(rows), np.int64),
            flanks=1 + int(both),
            plain=np.stack([drift, _scaled(speed)]),
            waves=np.concatenate(
                [_waves(angle[rows]) for angle in (log.driving_angle, log.driven_angle)]
            ),
            torque=np.zeros((0, len(rows)))
            if log.torque is None
            else _scaled(log.torque[rows])[None],
        )

    @property
    def speed_place(self) -> int:
        """Index of the column of the speed."""
        return self.groups + 1

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.groups + 2 + self.flanks * len(self.waves) + len(self.torque)

    def at(self, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k p"]:
        """Return the rows of the design matrix with these indices."""
        parts = (self.plain[:, rows], self.waves[:, rows], self.torque[:, rows])
        return self._spread(self.group[rows], self.flank[rows], *parts)

    def means(
        self, starts: Int[np.ndarray, " w"], size: Int[np.ndarray, " w"]
    ) -> Float[np.ndarray, "w p"]:
        """Return the mean row of every window; no window extends beyond a segment.

        A window has `size` rows from index `starts` on.
        """
        plain, waves, torque = (
            np.add.reduceat(part, starts, axis=1) / size
            for part in (self.plain, self.waves, self.torque)
        )
        return self._spread(self.group[starts], self.flank[starts], plain, waves, torque)

    def times(self, coefficients: Float[np.ndarray, " p"]) -> Float[np.ndarray, " m"]:
        """Return the product of the design matrix and the coefficients."""
        place = self.groups + 2
        stop = place + self.flanks * len(self.waves)
        of_waves = coefficients[place:stop].reshape(len(self.waves), self.flanks).T
        waves = of_waves @ self.waves
        total = waves[0] if self.flanks == 1 else np.where(self.flank == 0, waves[0], waves[1])
        total += coefficients[self.groups : place] @ self.plain
        total += coefficients[: self.groups][self.group]
        if len(self.torque):
            total += coefficients[-1] * self.torque[0]
        return total

    def _spread(
        self,
        group: Int[np.ndarray, " k"],
        flank: Int[np.ndarray, " k"],
        plain: Float[np.ndarray, "2 k"],
        waves: Float[np.ndarray, "w k"],
        torque: Float[np.ndarray, "t k"],
    ) -> Float[np.ndarray, "k p"]:
        """Return whole rows of the design matrix, zeros included."""
        table = np.zeros((self.width, len(group)))
        rows, place = np.arange(len(group)), self.groups + 2
        table[group, rows] = 1.0
        table[self.groups : place] = plain
        for wave in range(len(waves)):
            table[place + self.flanks * wave + flank, rows] = waves[wave]
        if len(torque):
            table[-1] = torque[0]
        return table.T


def _waves(angle: Float[np.ndarray, " m"]) -> Float[np.ndarray, "w m"]:
    """Return cosine and sine of the orders 1 to `ORDERS` of an angle."""
    turns = angle / REV
    turns -= np.rint(turns)  # NumPy is faster for small angles
    turns *= REV
    table = np.empty((2 * ORDERS, len(angle)))
    np.cos(turns, out=table[0])
    np.sin(turns, out=table[1])
    double = 2 * table[0]
    for order in range(1, ORDERS):  # f((k + 1) x) = 2 cos x f(k x) − f((k − 1) x)
        for part in (0, 1):
            place = 2 * order + part
            np.multiply(double, table[place - 2], out=table[place])
            table[place] -= table[place - 4] if order > 1 else 1.0 - part
    return table


def _scaled(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    return values / max(float(np.abs(values).max()), 1e-300)
