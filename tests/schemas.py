"""The JSON Schemas of the package, by the names that its objects have under `schema`."""

import json
from importlib.resources import files
from typing import Any

_FOLDER = files("vttig_jax") / "schemas"


def schema_names() -> list[str]:
    """Return the names of all schemas, for example `vttig.error/1`."""
    stems = (entry.name.removesuffix(".json") for entry in _FOLDER.iterdir())
    return sorted("/".join(stem.rsplit("-", 1)) for stem in stems if stem.startswith("vttig."))


def load_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of `name`."""
    return json.loads((_FOLDER / f"{name.replace('/', '-')}.json").read_text("utf-8"))
