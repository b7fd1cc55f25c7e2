"""Columns, relation and names of the fits of a scenario: those of `vttig_jax.fit`."""

from ...identify.columns import Columns
from ...identify.relation import PairRelation, pair_relation
from ...identify.terms import TermPlan, plan_terms
from .scenarios import Scenario

JUDGED = ("constant_backlash", "driving_", "driven_")
"""Beginnings of the names of parameters whose intervals are judged."""


def planned(scenario: Scenario) -> TermPlan:
    """The harmonics the fit models."""
    pair, options = scenario.pair, scenario.options
    return plan_terms(
        pair.ratio,
        options.driving_orders,
        options.driven_orders,
        options.mesh_orders,
        pair.driving.teeth,
    )


def columns_of(terms: TermPlan) -> Columns:
    """Layout of the rows of one log without drift."""
    return Columns(tuple(h.term for h in terms.free), tuple(h.term for h in terms.tied))


def relation_of_scenario(scenario: Scenario) -> PairRelation:
    """From parameters to tied coefficients."""
    terms = planned(scenario)
    return pair_relation(
        scenario.pair,
        terms,
        columns_of(terms),
        scenario.flanks,
        encoder_terms=scenario.encoder_terms,
    )


def judged(names: tuple[str, ...]) -> tuple[int, ...]:
    """Places of the parameters that are judged among all."""
    return tuple(k for k, name in enumerate(names) if name.startswith(JUDGED))
