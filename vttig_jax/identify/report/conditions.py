"""Assumptions under which the numbers of a fit are valid, by name."""

from ...pair.gear_pair import Drive, GearPair
from ..model.identifiability import Identifiability
from ..preliminary.delay import WITHIN_ONE_INTERVAL
from ..preliminary.model_selection import SelectedModel
from ..settings import FitSettings


def conditions_of(
    pair: GearPair | Drive, split: bool, settings: FitSettings, selected: SelectedModel
) -> tuple[str, ...]:
    """Return the names of the assumptions under which the numbers of the fit are valid.

    `split` is True if the fit separates encoder errors from gear errors.
    """
    given = selected.linear.model.given is not None
    conditions = ("flank_model",) if given else perfect_parts(pair, split, settings)
    if selected.delay.state == "given":
        conditions += ("given_delay",)
    if selected.delay.is_bounded and len(selected.summary.flanks) == 2:
        bound = settings.delay_within_ms
        conditions += (WITHIN_ONE_INTERVAL if bound is None else f"delay_within_{bound:g}_ms",)
    return conditions


def is_split(identifiable: Identifiability, settings: FitSettings) -> bool:
    """Return whether gear eccentricities are separated from encoder errors."""
    trusted = settings.perfect_encoders or settings.perfect_gears
    return len(identifiable.flanks) == 2 and not trusted


def perfect_parts(pair: GearPair | Drive, split: bool, settings: FitSettings) -> tuple[str, ...]:
    """Return the name of the parts that a fit takes as perfect; see `conditions_of`."""
    if settings.perfect_gears:
        return ("perfect_gears",)
    return () if isinstance(pair, Drive) or split else ("perfect_encoders",)
