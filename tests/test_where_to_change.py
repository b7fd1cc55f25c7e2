"""The page on the architecture names files that exist, where it says what to change for what."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "vttig_jax"
TABLE = (ROOT / "docs" / "architecture.md").read_text().split("## Where to change what")[1]
ROWS = [line for line in TABLE.splitlines() if line.startswith("| ") and "`" in line]


def missing(row: str) -> list[str]:
    """Files of a row that do not exist; a name without a folder is in the folder before it."""
    lacking, folder = [], None
    for name in re.findall(r"`([^`\s]+(?:\.py|\.pyi|\.md|\.json|\.toml|/))`", row):
        places = [base / name for base in (PACKAGE, ROOT, folder) if base is not None]
        found = next((place for place in places if place.exists()), None)
        if found is None:
            lacking.append(name)
            continue
        folder = found if found.is_dir() else found.parent
    return lacking


def test_the_rows_name_files_that_exist():
    assert [(row, lacking) for row in ROWS if (lacking := missing(row))] == []


def test_a_file_that_does_not_exist_is_found():
    row = "| a controller | `control/controllers/` a new module, `controller.py`, `nobody.py` |"
    assert missing(row) == ["nobody.py"]
    assert 20 < len(ROWS) <= 25
