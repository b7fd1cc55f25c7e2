"""Draws for arviz: the installed one for real, the other data model by what it is given."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.posterior.made import made_posterior, quick_fit
from vttig_jax.base.errors import UsageError
from vttig_jax.posterior.summary.posterior import to_arviz


@pytest.fixture(scope="module")
def posterior():
    return made_posterior(quick_fit(), steps=7, walkers=6)


def fake_arviz(version: str) -> tuple[ModuleType, list]:
    """An arviz that keeps how `from_dict` was called and hands back groups with attributes."""
    calls = []

    def from_dict(*args, **groups):
        calls.append((args, groups))
        own = args[0] if args else groups

        class Group(dict):
            attrs: dict

        made = {}
        for name, variables in own.items():
            made[name] = Group({v: SimpleNamespace(attrs={}) for v in variables})
            made[name].attrs = {}
        return made

    module = ModuleType("arviz")
    module.__version__, module.from_dict = version, from_dict  # pyright: ignore
    return module, calls


@pytest.mark.filterwarnings("ignore")
def test_the_installed_arviz_reads_the_draws(posterior):
    arviz = pytest.importorskip("arviz")
    found = posterior.to_arviz()
    group = found["posterior"]
    assert dict(group.sizes) == {"chain": 4, "draw": 42}
    assert list(group.data_vars) == list(posterior.names)
    # A chain is an ensemble, a draw a walker of a step.
    one = group["driven_x"].values[2, 3 * 6 + 1]
    assert one == posterior.draws[2, 3, 1, posterior.names.index("driven_x")]
    assert found["sample_stats"]["lp"].values[1, 8] == posterior.log_density[1, 1, 2]
    assert group["driven_x"].attrs["units"] == "mm"
    assert group["constant_backlash"].attrs["units"] == "rad"
    assert group.attrs["source"] == posterior.fit.source and group.attrs["converged"] == "True"
    assert float(arviz.rhat(found)["driven_x"]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("version", "nested"), [("0.23.4", False), ("1.0.0", True), ("1.2.0rc1", True)]
)
def test_each_data_model_gets_its_own_call(posterior, monkeypatch, version, nested):
    module, calls = fake_arviz(version)
    monkeypatch.setitem(sys.modules, "arviz", module)
    found = to_arviz(posterior)
    ((args, groups),) = calls
    assert (len(args) == 1 and not groups) if nested else (not args and len(groups) == 2)
    given = args[0] if nested else groups
    assert set(given) == {"posterior", "sample_stats"}
    assert given["posterior"]["driven_x"].shape == given["sample_stats"]["lp"].shape == (4, 42)
    assert found["posterior"]["driven_x"].attrs["units"] == "mm"


def test_without_arviz_the_extra_is_named(posterior, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(UsageError, match=r"pip install `vttig-jax\[arviz\]`") as caught:
        to_arviz(posterior)
    assert caught.value.exit_code == 2
    assert np.isfinite(posterior.draws).all()
