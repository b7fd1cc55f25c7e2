"""Bounded reading: regular files only, and memory that is compared with a limit first."""

import io
import os
import threading

import pytest

from vttig_jax.base.errors import InputError
from vttig_jax.base.files import limits
from vttig_jax.base.files.limits import MemoryBudget, most_memory, read_regular


def test_a_regular_file_is_read_whole_and_others_are_refused(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(bytes(range(256)) * 100)
    (tmp_path / "link").symlink_to(path)
    assert read_regular(path) == read_regular(tmp_path / "link") == path.read_bytes()
    for other, error in ((tmp_path, IsADirectoryError), (tmp_path / "none", FileNotFoundError)):
        with pytest.raises(error):
            read_regular(other)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
def test_what_has_no_end_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    found = []

    def read() -> None:
        for path in (tmp_path / "pipe", "/dev/zero", "/dev/stdin" if os.isatty(0) else "/dev/tty"):
            try:
                read_regular(path)
            except OSError as error:
                found.append(error.strerror)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(10.0)
    assert len(found) == 3
    assert found[:2] == ["it is a device or a pipe and no regular file"] * 2


def test_a_file_beyond_the_limit_is_not_read(tmp_path, monkeypatch):
    path = tmp_path / "large"
    with open(path, "wb") as file:
        file.truncate(10_000)  # a hole: no disk, and all of the memory when read
    monkeypatch.setattr(limits, "free_bytes", lambda: 10_000)
    with pytest.raises(OSError, match="larger than the limit"):
        read_regular(path)
    with most_memory(20_000):
        assert len(read_regular(path)) == 10_000


def test_the_budget_grows_with_the_file_up_to_the_machine(monkeypatch):
    monkeypatch.setattr(limits, "free_bytes", lambda: 4 << 30)
    assert MemoryBudget("x", 0).limit == limits.LEAST_BYTES
    assert MemoryBudget("x", 10 << 20).limit == limits.MULTIPLE * (10 << 20)
    assert MemoryBudget("x", 1 << 30).limit == 2 << 30
    with most_memory(5 << 30), most_memory(None):
        assert MemoryBudget("x", 0).limit == 5 << 30
    budget = MemoryBudget("log.h5", 0)
    budget.take(limits.LEAST_BYTES)
    with pytest.raises(InputError, match="--most-memory") as caught:
        budget.take(1)
    assert caught.value.where == "log.h5"


class _Counted(io.BytesIO):
    """A stream that remembers the most bytes it was asked for."""

    most = 0

    def read(self, size: int | None = -1) -> bytes:
        self.most = max(self.most, -1 if size is None else size)
        return super().read(size)


def test_no_more_is_asked_for_than_is_expected():
    for size, expected in ((10, 10), (10, 4), (0, 0), (40 << 20, 0)):
        stream = _Counted(bytes(range(256)) * (size // 256) + bytes(size % 256))
        assert limits.read_at_most(stream, 8 << 30, expected) == stream.getvalue()
        assert stream.most < (17 << 20)


def test_a_stream_beyond_the_limit_is_read_to_just_beyond_it():
    assert 100 < len(limits.read_at_most(io.BytesIO(bytes(1000)), 100)) <= 300
