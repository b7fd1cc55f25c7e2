"""Scenario files."""

import pytest
import tomli_w


@pytest.fixture
def write(tmp_path):
    def write(table):
        path = tmp_path / "scenario.toml"
        path.write_text(table if isinstance(table, str) else tomli_w.dumps(table), "utf-8")
        return path

    return write
