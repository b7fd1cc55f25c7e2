"""Every text of the corpus through each of its doors."""

from collections.abc import Iterator

import pytest

from tests.corpus.cases import (
    DOORS,
    READERS,
    Case,
    cases,
    differences,
    expected_at,
    facts,
    name_of,
    texts_of_the_corpus,
    through,
)

pytestmark = pytest.mark.usefixtures("unchecked_module")


def parameters() -> Iterator[object]:
    for case in cases():
        marks = [pytest.mark.xfail(reason=case.xfail, strict=True)] if case.xfail else []
        yield pytest.param(case, id=case.log.name, marks=marks)


@pytest.mark.parametrize("case", [*parameters()])
def test_a_text_is_read_as_expected(case: Case, tmp_path):
    if case.needs:
        pytest.importorskip(case.needs)
    found = {
        door: differences(expected_at(case, door), through(door, case, tmp_path))
        for door in case.doors
    }
    assert not any(found.values()), found


def test_what_is_wrong_is_seen():
    """Negative control: every part of an expectation can fail."""
    log = {
        "rows": 3,
        "notes": ["the last line (4) is cut off", "column `t`"],
        "time": {"name": "t", "first": 0.5},
        "gap_deg": [0.1, 0.2],
    }
    good = {"log": log | {"notes": [["(4)"], ["`t`"]]}}
    assert differences(good, {"log": log}) == []
    for key, value in (
        ("rows", 4),
        ("notes", [["(4)"]]),
        ("notes", [["(5)"], ["`t`"]]),
        ("time", {"name": "u"}),
        ("time", {"first": 0.25}),
        ("driving", {"name": "a"}),
        ("gap_deg", [0.1]),
        ("gap_deg", [0.1, 0.2 + 1e-13]),
    ):
        assert differences({"log": good["log"] | {key: value}}, {"log": log}), key
    assert differences(good, {"error": {"exit": 3}})
    error = {"error": {"exit": 3, "where": "line 2", "says": "give --unit deg for `a`."}}
    for key, value in (("exit", 2), ("where", "line 3"), ("says", ["--unit rad"])):
        assert differences({"error": {key: value}}, error), key
    assert facts(error["error"]["says"]) == ["--unit deg", "`a`"]


def test_the_corpus_is_whole():
    """Each text has its TOML, the texts are small, and no expectation is empty."""
    known = list(cases())
    assert sorted(map(name_of, texts_of_the_corpus())) == sorted(name_of(c.log) for c in known)
    assert max(case.log.stat().st_size for case in known) < 12_000
    assert all(set(case.doors) <= {*DOORS, *READERS} and len(case.expected) == 1 for case in known)
