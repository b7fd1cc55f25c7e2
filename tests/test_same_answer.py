"""The comparison of answers sees what a reader would, and nothing else."""

from tests.same_answer import differences

KEPT = {
    "outcome": "ok",
    "parameters": {"gap_deg": {"value": 0.038, "std": 1e-4, "determined": True, "reason": None}},
    "orders": [{"amplitude_arcsec": 12.0, "std_arcsec": 0.5}],
    "checks": {"solver_steps": 11, "alone": {"delay_s": 0.003, "delay_std_s": 1e-5}},
}


def _changed(**value) -> dict:
    fields = KEPT["parameters"]["gap_deg"] | value
    return KEPT | {"parameters": {"gap_deg": fields}}


ALONE = {"delay_s": 0.003 + 2e-8, "delay_std_s": 1e-5}


def test_last_digits_and_counts_of_steps_are_no_difference():
    for same in (
        KEPT | {"checks": KEPT["checks"] | {"solver_steps": 16}},
        _changed(value=0.038 + 0.9e-7),
        KEPT | {"orders": [{"amplitude_arcsec": 12.0004, "std_arcsec": 0.5}]},
    ):
        assert differences(KEPT, same) == []


def test_a_thousandth_of_a_standard_error_is_one_and_a_standard_error_has_none_of_its_own():
    assert differences(KEPT, _changed(value=0.038 + 2e-7)) == [
        f".parameters.gap_deg.value: 0.038 is not {0.038 + 2e-7!r}"
    ]
    alone = KEPT | {"checks": {"solver_steps": 11, "alone": ALONE}}
    for other in (alone, _changed(std=1.001e-4), {"outcome": "ok"}):
        assert len(differences(KEPT, other)) == 1


def test_numbers_of_a_list_are_compared_with_its_largest():
    kept = {"autocorrelation": [0.5, -1e-4]}
    assert differences(kept, {"autocorrelation": [0.5, -1e-4 + 1e-7]}) == []
    assert len(differences(kept, {"autocorrelation": [0.5, -1e-4 + 2e-4]})) == 1


def test_words_types_and_missing_keys_are_differences():
    reason = _changed(reason="below three standard errors")
    changed = _changed(determined=False), _changed(value=None), reason
    for other in (KEPT | {"outcome": "partly_determined"}, KEPT | {"orders": []}, *changed):
        assert differences(KEPT, other) != []
    assert differences({"n": 3}, {"n": 3.0}) != []
