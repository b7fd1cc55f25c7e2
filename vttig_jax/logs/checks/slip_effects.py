"""Effects in the transmission error that a slip is fitted together with, as a compact matrix.

Most columns of the design matrix are zero in most rows: a sample belongs to one group of segments
and to one flank. Only the waves of both shafts are stored, once for both flanks.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.numerics.counting import pieces
from ...base.units import REV
from ..encoder_log import EncoderLog

ORDERS = 4
"""Number of orders of each shaft in the fit."""

_PIECE, _FEW = 4096, 2048  # rows whose waves and products are computed in the cache (chosen)


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
            waves=_waves(log.driving_angle[rows], log.driven_angle[rows]),
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

    def few(self, rows: Int[np.ndarray, " k"]) -> "FewRows":
        """Return the rows of the design matrix with these indices for a fit of their own."""
        rows = rows[np.argsort(self.group[rows], kind="stable")]
        table, place = np.ones((3 + len(self.waves) + len(self.torque), len(rows))), 1
        for part in (self.plain, self.waves, self.torque):
            np.take(part, rows, axis=1, out=table[place : place + len(part)])
            place += len(part)
        edges = np.searchsorted(self.group[rows], np.arange(self.groups + 1)).tolist()
        parts = [
            (slice(start + part.start, start + part.stop), self._places_of(group, int(rows[start])))
            for group, (start, stop) in enumerate(pairwise(edges))
            for part in pieces(stop - start, _FEW)
        ]
        return FewRows(rows, table, parts, self.width)

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

    def times(self, coefficients: Float[np.ndarray, "*c p"]) -> Float[np.ndarray, "*c m"]:
        """Return the product of the design matrix and the coefficients, for each set of them."""
        sets = coefficients.reshape(-1, self.width)
        place = self.groups + 2
        of_waves = sets[:, place : place + self.flanks * len(self.waves)]
        of_waves = of_waves.reshape(len(sets), len(self.waves), self.flanks).transpose(2, 0, 1)
        total = sets[:, : self.groups][:, self.group]
        for part in pieces(len(self.group), _PIECE):
            waves = of_waves @ self.waves[:, part]
            own = waves[0] if self.flanks == 1 else np.where(self.flank[part] == 0, *waves)
            total[:, part] += own + sets[:, self.groups : place] @ self.plain[:, part]
            if len(self.torque):
                total[:, part] += sets[:, -1:] * self.torque[:, part]
        return total.reshape(*coefficients.shape[:-1], len(self.group))

    def _places_of(self, group: int, row: int) -> Int[np.ndarray, " c"]:
        """Return the columns that are not zero in a group, of which `row` is a row.

        They are in the order offset, drift, speed, waves, torque.
        """
        first = self.groups + 2
        waves = first + self.flank[row] + self.flanks * np.arange(len(self.waves))
        torque = [self.width - 1] * len(self.torque)
        return np.array([group, first - 2, first - 1, *waves, *torque])

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


@dataclass(frozen=True, eq=False)
class FewRows:
    """Rows of the design matrix for a fit of their own, sorted by group.

    **Arguments**
    - `rows`: their indices. - `width`: number of columns of the design matrix.
    - `table`: their columns that are not zero, one row for each column, the offset first.
    - `parts`: parts of one group, each with the columns of the design matrix that `table` holds.
    """

    rows: Int[np.ndarray, " k"]
    table: Float[np.ndarray, "c k"]
    parts: list[tuple[slice, Int[np.ndarray, " c"]]]
    width: int

    def times(self, coefficients: Float[np.ndarray, " p"]) -> Float[np.ndarray, " k"]:
        """Return the product of the rows and the coefficients."""
        return np.concatenate(
            [coefficients[places] @ self.table[:, part] for part, places in self.parts]
        )

    def normal(
        self, weight: Float[np.ndarray, " k"], values: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
        """Return Xᵀ W X and Xᵀ W y for the rows X, their weights W and the values y."""
        matrix, right = np.zeros(self.width**2), np.zeros(self.width)
        for part, places in self.parts:
            table = self.table[:, part]
            weighted = table * weight[part]
            matrix[np.add.outer(places * self.width, places)] += weighted @ table.T
            right[places] += weighted @ values[part]
        return matrix.reshape(self.width, self.width), right


def _waves(*angles: Float[np.ndarray, " m"]) -> Float[np.ndarray, "w m"]:
    """Return cosine and sine of the orders 1 to `ORDERS` of every angle."""
    count = len(angles[0])
    table = np.empty((2 * ORDERS * len(angles), count))
    for part in pieces(count, _PIECE):
        for number, angle in enumerate(angles):
            first = 2 * ORDERS * number
            _fill_waves(angle[part], table[first : first + 2 * ORDERS, part])
    return table


def _fill_waves(angle: Float[np.ndarray, " m"], table: Float[np.ndarray, "w m"]) -> None:
    turns = angle / REV
    turns -= np.rint(turns)  # NumPy is faster for small angles
    turns *= REV
    np.cos(turns, out=table[0])
    np.sin(turns, out=table[1])
    double = 2 * table[0]
    for order in range(1, ORDERS):  # f((k + 1) x) = 2 cos x f(k x) − f((k − 1) x)
        for part in (0, 1):
            place = 2 * order + part
            np.multiply(double, table[place - 2], out=table[place])
            table[place] -= table[place - 4] if order > 1 else 1.0 - part


def _scaled(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    return values / max(float(np.abs(values).max()), 1e-300)
