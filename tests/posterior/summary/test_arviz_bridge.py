"""Draws for arviz: the installed one for real, the other data model by what it is given."""

import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from jaxtyping import Float

from tests.posterior.densities import plain
from tests.posterior.made import made_posterior, quick_fit
from vttig_jax.base.errors import UsageError
from vttig_jax.posterior.sampling.ensembles import run_ensembles
from vttig_jax.posterior.summary.posterior import Posterior


@pytest.fixture(scope="module")
def posterior():
    return made_posterior(quick_fit(), steps=7, walkers=6)


@pytest.fixture(scope="module")
def converged(posterior) -> Posterior:
    """The draws of a sampler, long enough by the stop rule."""
    chains = run_ensembles(plain(8))
    assert chains.diagnosis.converged and chains.diagnosis.tau.min() > 20
    discarded = chains.discarded // chains.thin
    return replace(
        posterior,
        names=chains.names,
        units=chains.units,
        draws=chains.kept,
        log_density=chains.log_density[:, discarded:],
        diagnosis=chains.diagnosis,
    )


def effective_draws(chains: Float[np.ndarray, "chains n"]) -> float:
    """Effective draws of the mean by Geyer's initial monotone sequence over split chains.

    A. Vehtari et al., Bayesian Analysis 16 (2021) 667, equations (10) to (14), without ranks.
    """
    half = chains.shape[1] // 2
    split = np.concatenate([chains[:, :half], chains[:, -half:]])
    centred = split - split.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred, 2 * half, axis=1)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=1)[:, :half].mean(axis=0) / half
    within = covariance[0] * half / (half - 1)
    total = covariance[0] + split.mean(axis=1).var(ddof=1)
    correlation = 1 - (within - covariance * half / (half - 1)) / total
    correlation[0] = 1.0
    pairs = correlation[: half // 2 * 2].reshape(-1, 2).sum(axis=1)
    last = np.argmax(pairs < 0) if (pairs < 0).any() else len(pairs)
    return split.size / (2 * np.minimum.accumulate(pairs[:last]).sum() - 1)


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
    arviz = pytest.importorskip("arviz", reason="the extra vttig-jax[arviz] is not installed")
    found = posterior.to_arviz()
    group = found["posterior"]
    assert dict(group.sizes) == {"chain": 4, "draw": 42}
    assert list(group.data_vars) == list(posterior.names)
    # A chain is an ensemble, and its draws are the time series of one walker after the other.
    one = group["driven_x"].values[2, 3 * 7 + 1]
    assert one == posterior.draws[2, 1, 3, posterior.names.index("driven_x")]
    assert found["sample_stats"]["lp"].values[1, 8] == posterior.log_density[1, 1, 1]
    assert (group.attrs["walkers"], group.attrs["steps"]) == (6, 7)
    assert group["driven_x"].attrs["units"] == "mm"
    assert group["constant_backlash"].attrs["units"] == "rad"
    assert group.attrs["source"] == posterior.fit.source and group.attrs["converged"] == "True"
    assert float(arviz.rhat(found)["driven_x"]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("method", ["bulk", "mean"])
def test_the_installed_arviz_counts_the_effective_draws_of_the_diagnosis(converged, method):
    arviz = pytest.importorskip("arviz", reason="the extra vttig-jax[arviz] is not installed")
    found = converged.to_arviz()
    counted = [float(arviz.ess(found, method=method)[name]) for name in converged.names]
    np.testing.assert_allclose(counted, converged.diagnosis.effective, rtol=0.2)
    largest = max(float(arviz.rhat(found)[name]) for name in converged.names)
    assert largest == pytest.approx(converged.diagnosis.r_hat.max(), abs=0.005)


def test_the_order_of_the_draws_shows_their_autocorrelation(converged, monkeypatch):
    """The same count by the formula of arviz, and eight times as many in the order of steps."""
    module, calls = fake_arviz("1.0.0")
    monkeypatch.setitem(sys.modules, "arviz", module)
    converged.to_arviz()
    given = calls[0][0][0]["posterior"]
    counted = [effective_draws(given[name]) for name in converged.names]
    np.testing.assert_allclose(counted, converged.diagnosis.effective, rtol=0.2)
    by_steps = converged.draws.reshape(len(converged.draws), -1, len(converged.names))
    wrong = [effective_draws(by_steps[:, :, k]) for k in range(len(converged.names))]
    assert np.min(wrong / converged.diagnosis.effective) > 3
    noise = np.random.default_rng(0).standard_normal((4, 4000))
    assert effective_draws(noise) == pytest.approx(16_000, rel=0.05)


@pytest.mark.parametrize(
    ("version", "nested"), [("0.23.4", False), ("1.0.0", True), ("1.2.0rc1", True)]
)
def test_each_data_model_gets_its_own_call(posterior, monkeypatch, version, nested):
    module, calls = fake_arviz(version)
    monkeypatch.setitem(sys.modules, "arviz", module)
    found = posterior.to_arviz()
    ((args, groups),) = calls
    assert (len(args) == 1 and not groups) if nested else (not args and len(groups) == 2)
    given = args[0] if nested else groups
    assert set(given) == {"posterior", "sample_stats"}
    assert given["posterior"]["driven_x"].shape == given["sample_stats"]["lp"].shape == (4, 42)
    assert found["posterior"]["driven_x"].attrs["units"] == "mm"


def test_without_arviz_the_extra_is_named(posterior, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(UsageError, match=r"pip install `vttig-jax\[arviz\]`") as caught:
        posterior.to_arviz()
    assert caught.value.exit_code == 2
    assert np.isfinite(posterior.draws).all()
