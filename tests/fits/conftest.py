import pytest


@pytest.fixture(autouse=True, scope="module")
def as_for_a_user(unchecked_module) -> None:
    """Fit the worked examples without checks of annotations."""
