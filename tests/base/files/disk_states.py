"""Every state that a folder passes through: what a kill at that moment leaves on the disk."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from vttig_jax.base.files import atomic_write as commit

OPERATIONS = ("rename", "replace", "unlink", "rmdir", "mkdir", "fsync", "open")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@contextmanager
def recorded(folder: Path, into: Path) -> Iterator[list[Path]]:
    """Yield a list that collects a copy of `folder` at every different state inside the block.

    The copies hold no process alive, so the lock in them is free, as after a kill.
    """
    states: list[Path] = []
    seen: list[dict[str, bytes]] = []
    busy = [False]

    def look() -> None:
        if busy[0] or not folder.exists():
            return
        busy[0] = True
        try:
            content = contents(folder)
            if not seen or seen[-1] != content:
                seen.append(content)
                states.append(shutil.copytree(folder, into / f"{len(states):03d}", symlinks=True))
        finally:
            busy[0] = False

    def followed(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            look()
            done = real(*arguments, **options)
            look()
            return done

        return call

    def write_halves(path: Path, data: bytes) -> None:
        path.write_bytes(data[: len(data) // 2])
        look()
        path.unlink()
        real_write(path, data)

    real_write = commit.write_synced
    patches = [mock.patch.object(os, name, followed(getattr(os, name))) for name in OPERATIONS]
    patches.append(mock.patch.object(commit, "write_synced", write_halves))
    for patch in patches:
        patch.start()
    try:
        yield states
        look()
    finally:
        for patch in patches:
            patch.stop()
