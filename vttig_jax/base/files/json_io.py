"""Strict JSON. Imports neither numpy nor jax.

Every object that the program writes has a key `schema` with a name and a version number, such as
`vttig.error/1`. Its JSON Schema (draft 2020-12) is `vttig_jax/schemas/vttig.error-1.json`. New keys
do not change the version number.
"""

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

_LONE = re.compile("[\ud800-\udfff]")
"""Half of a surrogate pair, which UTF-8 cannot encode."""


def dumps(obj: Any, *, ascii_only: bool = False) -> str:
    """Return an object as strict, indented JSON text with its keys in the given order.

    NaN and infinities become null. Dataclasses become objects; NumPy and JAX arrays and scalars
    become lists and numbers. `ascii_only` escapes non-ASCII text, for streams of unknown encoding.
    Surrogates without their other half, which names of files may have, are escaped in any case.

    **Raises** `ValueError` naming the position of a value that has no JSON form.

    **Example**
    ```python
    >>> from vttig_jax.base.files.json_io import dumps
    >>> print(dumps({"unit": "°", "value": float("nan")}))
    {
      "unit": "°",
      "value": null
    }

    ```
    """
    plain = _plain(obj, "obj")
    text = json.dumps(plain, ensure_ascii=ascii_only, allow_nan=False, indent=2)
    return _LONE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file, or None if it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _plain(value: Any, place: str) -> Any:
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        # A NumPy float64 is a float too, and float() converts it to a plain one.
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise ValueError(
                    f"Argument `obj` must have text as keys, but `{place}` has the key {key!r}."
                )
        return {key: _plain(item, f"{place}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{place}[{index}]") for index, item in enumerate(value)]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return _plain(fields, place)
    # Arrays and array scalars are recognised by `tolist`, so that numpy need not be imported.
    tolist = getattr(value, "tolist", None)
    if callable(tolist):
        listed = tolist()
        if not hasattr(listed, "tolist"):
            return _plain(listed, place)
    raise ValueError(
        f"Argument `obj` must hold only what JSON can, but `{place}` is a {type(value).__name__}."
    )
