"""Coverage of a log: turns of each shaft and directions, which decide what a fit can determine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ..encoder_log import EncoderLog
from .segments import Segment


@dataclass(frozen=True)
class Support:
    """Turns of each shaft over the samples whose flank is certain, and conclusions as sentences.

    `driving_resolved` and `driven_resolved` say whether the first order of the shaft can be
    determined and separated from that of the other shaft. `flanks` holds the flanks that have
    samples, "A" and "B".
    """

    driving_turns: float
    driven_turns: float
    driving_resolved: bool
    driven_resolved: bool
    flanks: tuple[str, ...]
    sentences: tuple[str, ...]


def support_of(log: EncoderLog, segments: Sequence[Segment]) -> Support:
    """Return the turns of both shafts over the segments, and what a fit can determine from them.

    The first order of a shaft needs one turn of this shaft. Both first orders are separable
    only after 1/|1 − i| driving turns (one beat period, i = ratio); with i = 1 they never are.
    """
    driving, driven = (turns_of(angle, segments) for angle in (log.driving_angle, log.driven_angle))
    beat = 1 / abs(1 - log.ratio) if log.ratio != 1 else None
    separable = beat is not None and driving >= beat
    flanks = tuple(sorted({segment.flank for segment in segments}))
    sentences = []
    if not segments:
        sentences.append("no sample lies on a certain flank, so nothing can be fitted")
    elif beat is None:
        sentences.append(
            "with ratio 1 both shafts share order 1: their eccentricities cannot be told apart"
        )
    elif not separable:
        sentences.append(
            f"the driving shaft turns {driving:.3g} times; under {float(beat):.3g} turns neither"
            " shaft's eccentricity can be told from the other's"
        )
    for name, turns in (("driving", driving), ("driven", driven)):
        if segments and turns < 1:
            sentences.append(
                f"the {name} shaft turns only {turns:.3g} times, so its first order cannot be"
                " determined"
            )
    if len(flanks) == 1:
        sentences.append(
            f"one direction only (flank {flanks[0]}): no backlash, and eccentricities only if the"
            " encoders are perfect"
        )
    resolved = separable and driving >= 1, separable and driven >= 1
    return Support(driving, driven, *resolved, flanks, tuple(sentences))


HIGHEST, _MOST = 8, 2000  # orders of a shaft, and angles, that are looked at (chosen)
CLEAR = 0.1
"""Least share of an order that no other order imitates over the angles of a log; without it its
variance would be ten times as large (chosen)."""


def told_orders(angle: Float[np.ndarray, " n"], orders: Sequence[float]) -> list[bool]:
    """Return which orders the places of a table tell from a level and from lower orders.

    At n places 360°/n apart the orders k and n − k have the same values. Half of the readings are
    left for the noise.

    **Arguments**
    - `angle`: angles in rad. - `orders`: in cycles per turn, in any order.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.motion.coverage import told_orders
    >>> places = np.radians(np.arange(0.0, 360.0, 60.0))
    >>> [told_orders(np.tile(places, times), [1, 2, 3, 4]) for times in (1, 4)]
    [[True, False, False, False], [True, True, False, False]]

    ```
    """
    basis, told = np.full((1, len(angle)), len(angle) ** -0.5), [False] * len(orders)
    for place in np.argsort(orders, kind="stable").tolist():
        own = np.stack([np.cos(orders[place] * angle), np.sin(orders[place] * angle)])
        rest = own - own @ basis.T @ basis
        # The last factor is the part of the second column that the first one does not have.
        factor = np.linalg.qr(rest.T)
        clear = np.diag(factor[1]) ** 2 >= CLEAR * np.sum(own**2, axis=1)
        if len(basis) + 2 <= len(angle) / 2 and np.all(clear):
            told[place] = True
            basis = np.concatenate([basis, factor[0].T])
    return told


def tells_first_order(
    angle: Float[np.ndarray, " n"], orders: Sequence[float] | Float[np.ndarray, " k"]
) -> bool:
    """Return whether angles of a shaft tell its first order from a level and other orders.

    A log over a whole turn does, and so do n places 360°/n apart.

    **Arguments**
    - `angle`: angles in rad. - `orders`: orders of the model, in cycles per turn of this shaft.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.motion.coverage import tells_first_order
    >>> places = np.radians(np.arange(0.0, 360.0, 30.0))
    >>> [tells_first_order(places[:count], [1, 2, 3]) for count in (12, 8)]
    [True, False]

    ```
    """
    phase = np.outer(orders, angle)
    own = np.repeat(np.isclose(orders, 1), 2)
    columns = np.concatenate([np.ones((1, len(angle))), np.cos(phase), np.sin(phase)])
    columns /= np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    gram = columns @ columns.T + 1e-9 * np.eye(len(columns))
    share = 1 / np.diag(np.linalg.inv(gram))[1:].reshape(2, -1).T.ravel()
    return bool(own.any() and share[own].min() >= CLEAR)


def turns_of(angle: Float[np.ndarray, " n"], segments: Sequence[Segment]) -> float:
    """Return the turns of a shaft over segments; a part that tells its orders counts as one."""
    ends = [angle[k] for s in segments for k in (s.start, s.stop - 1)]
    turns = float(max(ends) - min(ends)) / REV if ends else 0.0
    if not 0 < turns < 1:
        return turns
    rows = np.concatenate([angle[s.start : s.stop] for s in segments])
    rows = rows[:: -(-len(rows) // _MOST)]
    return 1.0 if tells_first_order(rows, np.arange(1.0, HIGHEST + 1)) else turns
