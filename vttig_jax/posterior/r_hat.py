"""Whether independent ensembles agree: the rank-normalised split R-hat."""

import numpy as np
from jaxtyping import Float
from scipy import special, stats


def r_hat(draws: Float[np.ndarray, "ensembles steps walkers d"]) -> Float[np.ndarray, " d"]:
    """R-hat of each coordinate between ensembles (Vehtari et al. 2021): larger of bulk and folded.

        R̂ = √[((n − 1)/n · W + B/n) / W]

    on normal scores of the ranks (bulk) and of |x − median| (folded); a group is one half in time
    of one ensemble with all its walkers, B/n the variance of the group means, W the mean variance
    inside a group. The walkers of an ensemble are proposed from each other, so that all of them can
    miss the same half of a posterior and still agree; only ensembles that never met can tell.

    Correlation over steps leaves W as it is and adds to B the error of a mean of n/τ draws, which
    makes R-hat larger, never smaller: at 50 τ and 64 walkers by less than 0.001, so that draws
    need no thinning by τ here. A middle step that is left over is dropped. A coordinate that is
    constant has R-hat 1 where all ensembles agree, else infinity.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.r_hat import r_hat
    >>> draws = np.random.default_rng(0).standard_normal((4, 100, 64, 1))
    >>> print(np.round(r_hat(draws), 2))
    [1.]
    >>> draws[0] += 1.0  # an ensemble elsewhere
    >>> print(np.round(r_hat(draws), 1))
    [1.1]

    ```
    """
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])
    groups = halves.reshape(len(halves), -1, draws.shape[3])
    return np.array([_one(groups[:, :, axis]) for axis in range(draws.shape[3])])


def _one(groups: Float[np.ndarray, "groups n"]) -> float:
    folded = np.abs(groups - np.median(groups))
    return max(_split(_normal_scores(groups)), _split(_normal_scores(folded)))


def _normal_scores(values: Float[np.ndarray, "groups n"]) -> Float[np.ndarray, "groups n"]:
    """Quantiles of the normal distribution at the ranks (Blom), so that heavy tails do no harm."""
    ranks = stats.rankdata(values, method="average").reshape(values.shape)
    return special.ndtri((ranks - 0.375) / (values.size + 0.25))


def _split(groups: Float[np.ndarray, "groups n"]) -> float:
    count = groups.shape[1]
    within = groups.var(axis=1, ddof=1).mean()
    between = groups.mean(axis=1).var(ddof=1)
    if (groups == groups[:, :1]).all():  # by value: a variance of rounding errors is not zero
        return 1.0 if (groups == groups[0, 0]).all() else float("inf")
    return float(np.sqrt((count - 1) / count + between / within))
