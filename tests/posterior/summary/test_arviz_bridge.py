"""Draws for arviz: the installed one for real, the other data model by what it is given."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.posterior.densities import plain
from tests.posterior.made import quick_posterior
from vttig_jax.base import UsageError
from vttig_jax.posterior import Until, run_ensembles
from vttig_jax.posterior.summary.posterior import arviz_data


class Group(dict):
    """Variables of arviz, all with attributes."""

    def __init__(self, names):
        super().__init__({name: SimpleNamespace(attrs={}) for name in names})
        self.attrs: dict = {}


def fake_arviz(version: str) -> tuple[ModuleType, list]:
    """An arviz that keeps how `from_dict` was called and hands back groups with attributes."""
    calls = []

    def from_dict(*args, **groups):
        calls.append((args, groups))
        return {name: Group(own) for name, own in (args[0] if args else groups).items()}

    module = ModuleType("arviz")
    module.__version__, module.from_dict = version, from_dict  # pyright: ignore
    return module, calls


@pytest.mark.filterwarnings("ignore")
def test_the_installed_arviz_counts_the_effective_draws_of_the_diagnosis():
    arviz = pytest.importorskip("arviz", reason="the extra vttig-jax[arviz] is not installed")
    chains = run_ensembles(plain(8), until=Until(effective=5000.0))
    names = chains.header.names
    found = arviz_data(names, chains.header.units, chains.draws)
    counted = [float(arviz.ess(found, method="mean")[name]) for name in names]
    np.testing.assert_allclose(counted, chains.diagnosis.effective, rtol=0.25)


@pytest.mark.parametrize(
    ("version", "nested"), [("0.23.4", False), ("1.0.0", True), ("1.2.0rc1", True)]
)
def test_each_data_model_gets_its_own_call(monkeypatch, version, nested):
    posterior, (module, calls) = quick_posterior(), fake_arviz(version)
    monkeypatch.setitem(sys.modules, "arviz", module)
    found = posterior.to_arviz()
    ((args, groups),) = calls
    assert (len(args) == 1 and not groups) if nested else (not args and len(groups) == 1)
    given = args[0] if nested else groups
    ensembles, steps, walkers, _ = posterior.draws.shape
    column = given["posterior"]["driven_x"]
    assert column.shape == (ensembles, steps * walkers)
    # A chain is an ensemble, and its draws are the time series of one walker after the other.
    place = posterior.place("driven_x")
    assert column[2, 3 * steps + 1] == posterior.draws[2, 1, 3, place]
    assert found["posterior"]["driven_x"].attrs["units"] == "mm"
    assert found["posterior"].attrs["steps"] == steps


def test_without_arviz_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(UsageError, match="arviz") as caught:
        quick_posterior().to_arviz()
    assert caught.value.exit_code == 2
