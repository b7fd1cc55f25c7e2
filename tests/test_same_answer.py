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


def test_last_digits_and_counts_of_steps_are_no_difference():
    assert differences(KEPT, KEPT | {"checks": KEPT["checks"] | {"solver_steps": 16}}) == []
    assert differences(KEPT, _changed(value=0.038 + 0.9e-7)) == []
    assert (
        differences(KEPT, KEPT | {"orders": [{"amplitude_arcsec": 12.0004, "std_arcsec": 0.5}]})
        == []
    )


def test_a_thousandth_of_a_standard_error_is_one():
    assert differences(KEPT, _changed(value=0.038 + 2e-7)) == [
        f".parameters.gap_deg.value: 0.038 is not {0.038 + 2e-7!r}"
    ]
    alone = {"delay_s": 0.003 + 2e-8, "delay_std_s": 1e-5}
    assert len(differences(KEPT, KEPT | {"checks": {"solver_steps": 11, "alone": alone}})) == 1


def test_a_standard_error_has_none_of_its_own():
    assert len(differences(KEPT, _changed(std=1.001e-4))) == 1


def test_numbers_of_a_list_are_compared_with_its_largest():
    kept = {"autocorrelation": [0.5, -1e-4]}
    assert differences(kept, {"autocorrelation": [0.5, -1e-4 + 1e-7]}) == []
    assert len(differences(kept, {"autocorrelation": [0.5, -1e-4 + 2e-4]})) == 1


def test_words_types_and_missing_keys_are_differences():
    assert differences(KEPT, KEPT | {"outcome": "partly_determined"}) != []
    assert differences(KEPT, _changed(determined=False)) != []
    assert differences(KEPT, _changed(value=None)) != []
    assert differences(KEPT, _changed(reason="below three standard errors")) != []
    assert differences(KEPT, KEPT | {"orders": []}) != []
    assert len(differences(KEPT, {"outcome": "ok"})) == 1
    assert differences({"n": 3}, {"n": 3.0}) != []
