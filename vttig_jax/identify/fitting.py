"""From logs to parameters: the main job, in one function."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from ..base.errors import NoAnswerError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..logs.checks.ratio import check_ratio
from ..logs.checks.slip import refuse_slip
from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import assigned_segments, find_ramps
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Drive, Flank, GearPair
from ..pair.schema import HarmonicOrders
from .build_result import build_fit
from .compress.harmonic_summary import HarmonicSummary
from .fit_result import Fit
from .model.identifiability import find_identifiability
from .preliminary.linear_fit import Input
from .preliminary.model_selection import select_model
from .settings import Choices, Loss, NoiseChoice


@one_blas_thread
def fit(
    log: EncoderLog | Sequence[EncoderLog],
    pair: GearPair | Drive,
    *,
    options: HarmonicOrders | None = None,
    flank: Flank | None = None,
    encoder_terms: bool = True,
    gear_terms: bool = True,
    delay: float | Literal["auto", "free", "off"] = "auto",
    loss: Loss | Literal["auto"] = "auto",
    regressors: Sequence[str] = (),
    free_ratio: bool = False,
    drift_order: int | None = None,
    drift_knots_s: float | None = None,
    same_zero: bool | None = None,
    readings: BacklashReadings | None = None,
    use_readings: bool = False,
    noise: Literal["ar", "white", "ou"] = "ar",
    noise_in: Literal["time", "angle"] = "time",
    noise_of: Literal["rig", "plateau"] = "rig",
) -> Fit:
    """Identify eccentricities, encoder errors and constant backlash from the logs of one rig.

    The transmission error of each flank is a linear model in the harmonics of both shafts. Its
    first orders follow from the parameters through the exact relation of the pair,

        r_b2 φ₂ = r_b1 φ₁ − (r_b1 + r_b2)(δ ± Δinv) (+ r_b2 j_c on flank B),

    plus + E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁) on both flanks; the other orders are free on each
    flank. A delay d of the driven channel is taken out of the driving angle, φ₁(t − d), until it
    stands still. The logs are compressed, their noise is autoregressive, and Levenberg–Marquardt
    works on the compressed logs.

    **Arguments**
    - `log`: an encoder log or transmission-error curve, or several of one rig. They share
      eccentricities, orders, constant backlash and delay; offset and drift are each log's own.
    - `pair`: the gear pair, or a drive without geometry.
    - `options`: orders to model; those of the pair by default.
    - `flank`: use this flank only, as the paper does.
    - `encoder_terms`: False takes the encoders to be perfect; with one flank they have to be.
    - `gear_terms`: False takes the gears to be perfect: first orders are those of the encoders.
    - `delay`: "auto" fits a delay where the logs show one; "free" fits it in any case; "off" or a
      number of seconds takes it as known.
    - `loss`: "square", "huber", "bisquare" (redescending); "auto" takes squares unless there are
      outliers, and then the redescending loss.
    - `regressors`: "torque", "acceleration", "speed": further columns, common to both flanks. A
      torque column is tried unasked.
    - `free_ratio`: fit the ratio too, beside the one that is given.
    - `drift_order`: highest power of time (0 … 6); chosen among 0, 1 and 2 by BIC when None.
    - `drift_knots_s`: instead, a cubic B-spline with this distance of its knots in s.
    - `same_zero`: do the angles of several logs count from the same zero? None: where the zero is
      that of the reading; otherwise each log has start angles of its own.
    - `readings`: backlash read at single angles of the first log, to check the fit against.
    - `use_readings`: let the readings join the fit as data.
    - `noise`: "ar", an autoregression estimated by restricted maximum likelihood, its order by BIC;
      "ou", an Ornstein–Uhlenbeck process for samples at unequal times; "white" takes the rows
      to be independent, which real ones never are.
    - `noise_in`: the noise is stationary in "time" or in driving "angle".
    - `noise_of`: one noise for the whole "rig", or one for every speed "plateau".

    **Returns** a `Fit`.

    **Raises** `LogError` for a log that contradicts the pair or another log, `NoAnswerError` for
    logs that are too short to say anything, `ValueError` for wrong arguments and without 64-bit
    floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> round(result.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("fit")
    if flank not in (None, "A", "B"):
        raise ValueError(f'Argument `flank` must be "A", "B" or None, but is {flank!r}.')
    settings = Choices(
        encoder_terms,
        drift_order,
        drift_knots_s,
        delay,
        loss,
        tuple(regressors),
        free_ratio,
        same_zero,
        use_readings,
        gear_terms,
        NoiseChoice(noise, noise_in, noise_of),
    )
    if use_readings and readings is None:
        raise ValueError("Argument `readings` must be given to be used, but is None.")
    logs = (log,) if isinstance(log, EncoderLog) else tuple(log)
    if not logs:
        raise ValueError("Argument `log` must hold at least one log, but is empty.")
    found = []
    for one in logs:
        check_ratio(one)
        found.append(assigned_segments(one))
    identifiable = find_identifiability(
        logs, [f.segments for f in found], pair, options or pair.fit, flank
    )
    for one, each in zip(logs, found, strict=True):
        refuse_slip(one, each)
    inputs = tuple(
        Input(
            one,
            each,
            own,
            tuple(r for r in find_ramps(one, each) if r.segment.flank in identifiable.flanks),
        )
        for one, each, own in zip(logs, found, identifiable.segments, strict=True)
    )
    selected = select_model(inputs, pair, identifiable, settings)
    _require_rows(selected.summary, ", ".join(one.source for one in logs))
    identifiable = replace(identifiable, flanks=tuple(f.flank for f in selected.summary.flanks))
    return build_fit(selected, pair, identifiable, settings, readings)


def _require_rows(summary: HarmonicSummary, where: str) -> None:
    columns = summary.columns.width - 1
    for flank in ("A", "B"):
        found = [f for f in summary.flanks if f.flank == flank]
        rows = sum(f.rows for f in found)
        usable = rows - sum(f.heads.shape[0] * f.heads.shape[1] for f in found)
        if (found and usable <= columns) or not summary.flanks:
            raise NoAnswerError(
                f"{rows} averaged samples on flank {flank} are too few for {columns} coefficients"
                " and their noise; record more turns, or list fewer orders in [fit].",
                where=where,
            )
