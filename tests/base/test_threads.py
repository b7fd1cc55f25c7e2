"""Functions on small matrices run with one BLAS thread, and leave the process as it was."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import vttig_jax
from vttig_jax.base.threads import one_blas_thread
from vttig_jax.identify import identification
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig


def threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    with threadpool_limits(2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_threads")
def test_threads_are_limited_inside_and_given_back():
    @one_blas_thread
    def seen(given: int) -> tuple[float, set[int]]:
        """Text."""
        return 5 / given, threads()

    assert seen(5) == (1.0, {1}) and threads() == {2}
    assert seen.__name__ == "seen" and seen.__doc__ == "Text."
    with pytest.raises(ZeroDivisionError):
        seen(0)
    assert threads() == {2}


@pytest.mark.usefixtures("two_threads")
def test_a_fit_and_its_search_for_lines_use_one(monkeypatch):
    found: dict[str, set[int]] = {}
    for name in ("mixed_fit", "found_lines"):

        def watched(*args, name=name, function=getattr(identification, name), **keywords):
            found[name] = threads()
            return function(*args, **keywords)

        monkeypatch.setattr(identification, name, watched)
    rig = paper_rig(0, PassMotion(reversal_deg=900.0, dwell_s=0.5))
    vttig_jax.fit(rig.log(0), rig.pair)
    assert found == {"mixed_fit": {1}, "found_lines": {1}} and threads() == {2}
