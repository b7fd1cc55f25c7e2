import dataclasses
import json
from typing import Any

import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.schemas import load_schema, schema_names
from vttig_jax.base.files.json_io import dumps

pytestmark = pytest.mark.smoke


@dataclasses.dataclass(frozen=True)
class Value:
    value: float
    unit: str


def strict_loads(text: str) -> Any:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=12,
    )
)
def test_whatever_is_written_is_strict_and_comes_back(obj):
    def finite(value: Any) -> Any:
        if isinstance(value, list):
            return [finite(item) for item in value]
        if isinstance(value, dict):
            return {key: finite(item) for key, item in value.items()}
        return None if isinstance(value, float) and not np.isfinite(value) else value

    assert strict_loads(dumps(obj)) == finite(obj)


def test_numbers_of_all_kinds():
    for value, expected in (
        (np.float64(0.1), 0.1),
        (np.float32(0.5), 0.5),
        (np.float32("nan"), None),
        (np.int64(2**53 + 1), 2**53 + 1),
        (np.bool_(True), True),
        (np.array([[1.0, np.inf], [-np.inf, 2.0]]), [[1.0, None], [None, 2.0]]),
        (np.array(3), 3),
        (np.array(["A", "B"]), ["A", "B"]),
        (jnp.arange(3.0), [0.0, 1.0, 2.0]),
        (("A", "B"), ["A", "B"]),
        (Value(np.nan, "mm"), {"value": None, "unit": "mm"}),
    ):
        assert strict_loads(dumps({"x": value})) == {"x": expected}


def test_ascii_only_escapes_and_keys_stay_in_the_order_given():
    assert "″" in dumps({"unit": "″"})
    assert dumps({"unit": "″"}, ascii_only=True).isascii()
    assert json.loads(dumps({"unit": "″"}, ascii_only=True)) == {"unit": "″"}
    assert list(json.loads(dumps({"b": 1, "a": 2}))) == ["b", "a"]


def test_what_json_cannot_hold_is_refused_with_its_place():
    for obj, place in (
        ({"a": [0, {1, 2}]}, r"`obj\.a\[1\]` is a set"),
        ({"a": 1j}, r"`obj\.a` is a complex"),
        ({"a": Value}, r"`obj\.a` is a type"),
        ({"a": np.array([1j])}, r"`obj\.a\[0\]` is a complex"),
        ({"a": {1: 2}}, r"`obj\.a` has the key 1"),
    ):
        with pytest.raises(ValueError, match=f"Argument `obj` must .*{place}"):
            dumps(obj)


def test_each_schema_is_itself_valid_and_names_what_it_describes():
    assert "vttig.error/1" in schema_names()
    for name in schema_names():
        schema = load_schema(name)
        jsonschema.Draft202012Validator.check_schema(schema)
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
        assert schema["properties"]["schema"] == {"const": name}


ERROR = {"schema": "vttig.error/1", "exit": 3, "message": "no such file.", "where": "log.csv"}


def test_an_error_fits_its_schema_and_may_gain_keys():
    validator = jsonschema.Draft202012Validator(load_schema("vttig.error/1"))
    assert validator.is_valid(ERROR | {"more": 1})
    wrong = ({"exit": 0}, {"message": ""}, {"message": "two\nlines"}, {"schema": "vttig.error/2"})
    broken = [ERROR | change for change in wrong]
    broken.append({key: value for key, value in ERROR.items() if key != "where"})
    assert not any(map(validator.is_valid, broken))
