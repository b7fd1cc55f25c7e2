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
    def seen(given: int) -> tuple[int, set[int]]:
        """Text."""
        return given, threads()

    assert seen(5) == (5, {1}) and threads() == {2}
    assert seen.__name__ == "seen" and seen.__doc__ == "Text."


@pytest.mark.usefixtures("two_threads")
def test_threads_are_given_back_after_an_error():
    @one_blas_thread
    def fails() -> None:
        assert threads() == {1}
        raise KeyError

    with pytest.raises(KeyError):
        fails()
    assert threads() == {2}


@pytest.mark.usefixtures("two_threads")
def test_a_fit_and_its_search_for_lines_use_one(monkeypatch):
    found: dict[str, set[int]] = {}

    def watch(name: str) -> None:
        function = getattr(identification, name)

        def watched(*args, **keywords):
            found[name] = threads()
            return function(*args, **keywords)

        monkeypatch.setattr(identification, name, watched)

    watch("mixed_fit")
    watch("found_lines")
    rig = paper_rig(0, PassMotion(reversal_deg=900.0, dwell_s=0.5))
    vttig_jax.fit(rig.log(0), rig.pair)
    assert found == {"mixed_fit": {1}, "found_lines": {1}} and threads() == {2}
