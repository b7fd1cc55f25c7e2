"""Pair files to start from: the contract's example word for word, and others."""

from pathlib import Path

FOLDER = Path(__file__).parent / "texts"
NAMES = "contract", "other_keys", "tooth_keys", "minimal", "drive"
CONTRACT, OTHER_KEYS, TOOTH_KEYS, MINIMAL, DRIVE = (
    (FOLDER / f"{name}.toml").read_text("utf-8") for name in NAMES
)
