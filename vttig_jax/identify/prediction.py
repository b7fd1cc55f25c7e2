"""What a linear model says about single samples: harmonics and own columns, rad."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.sincos import sincos
from ..base.units import REV
from ..logs.segments import Segment
from .channels import Channels
from .columns import Columns

_CHUNK = 8192


def residual_of(
    channels: Channels,
    segment: Segment,
    columns: Columns,
    weights: Float[np.ndarray, " columns"],
    stride: int = 1,
) -> Float[np.ndarray, " n"]:
    """Transmission error less the model at every `stride`-th sample of a segment, rad.

    `columns` is the layout of this log alone, `weights` its row (−β, 1) that makes residuals.
    """
    part = slice(segment.start, segment.stop, stride)
    own = columns.own_slice
    coefficients = -weights[:-1]
    harmonics = np.delete(coefficients, own)
    orders = np.asarray(columns.free + columns.tied, np.float64).reshape(-1, 2)
    values = np.full(len(channels.time[part]), coefficients[own.start])
    for place, name in enumerate(columns.own[0][1:], own.start + 1):
        values += coefficients[place] * channels.own[name][part]
    if len(orders):
        driving, driven = channels.driving[part], channels.driven[part]
        for start in range(0, len(values), _CHUNK):
            piece = slice(start, start + _CHUNK)
            count = len(values[piece])
            angles = [np.pad(a[piece], (0, _CHUNK - count)) for a in (driving, driven)]
            values[piece] += np.asarray(_harmonics(orders, harmonics, *angles))[:count]
    return channels.error[segment.flank][part] - values


@jax.jit
def _harmonics(
    orders: Float[Array, "terms 2"],
    coefficients: Float[Array, " cells"],
    driving: Float[Array, " n"],
    driven: Float[Array, " n"],
) -> Float[Array, " n"]:
    """Σ of the harmonics; coefficients of cosine and sine of a term stand beside each other."""
    driving, driven = (angle - REV * jnp.round(angle / REV) for angle in (driving, driven))

    def add(term, total):
        order = orders[term]
        sine, cosine = sincos(order[0] * driving + order[1] * driven)
        return total + coefficients[2 * term] * cosine + coefficients[2 * term + 1] * sine

    return jax.lax.fori_loop(0, orders.shape[0], add, jnp.zeros_like(driving))
