from pathlib import Path

import pytest

from vttig_jax.cli.main import main


@pytest.fixture(autouse=True, scope="module")
def as_for_a_user(unchecked_module) -> None:
    """Run the commands without checks of annotations."""


@pytest.fixture(scope="session")
def demo(tmp_path_factory) -> Path:
    """Folder that `vttig demo --out demo` has written."""
    out = tmp_path_factory.mktemp("demo") / "demo"
    assert main(["demo", "--out", str(out), "--quiet"]) == 0
    return out
