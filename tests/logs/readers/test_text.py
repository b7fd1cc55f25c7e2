import hashlib
import os

import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers import text as text_module
from vttig_jax.logs.readers.text import read_text

TEXT = "time_s,φ_deg\n0,1\n"


def write(tmp_path, data, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_encodings_found(tmp_path, encoding):
    data = TEXT.encode(encoding)
    text, digest, notes = read_text(write(tmp_path, data), None)
    assert text == TEXT and notes == ()
    assert digest == hashlib.sha256(data).hexdigest()


def test_encodings_given_and_assumed(tmp_path):
    path = write(tmp_path, "time_s,x [°]\n".encode("cp1252"))
    text, _, notes = read_text(path, None)
    assert text == "time_s,x [°]\n" and "cp1252" in notes[0]
    assert read_text(path, "cp1252")[2] == ()
    assert read_text(path, "cp437")[0] != text
    with pytest.raises(LogError, match="not utf-8"):
        read_text(path, "utf-8")
    with pytest.raises(LogError, match="unknown encoding 'klingon'"):
        read_text(path, "klingon")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_without_a_mark(tmp_path, encoding):
    data = "time_s,a\n0,1\n".encode(encoding)
    text, _, notes = read_text(write(tmp_path, data), None)
    assert text == "time_s,a\n0,1\n"
    assert notes == (f"UTF-16 without a byte-order mark, read as {encoding}",)
    assert read_text(write(tmp_path, data), encoding)[2] == ()


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_utf_16_cut_off_within_a_character(tmp_path, encoding):
    path = write(tmp_path, "a\n12".encode(encoding)[:-1])
    assert read_text(path, encoding)[0] == "a\n1"
    assert read_text(path, None)[0] == "a\n1"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16-le", "utf-16-be"])
def test_a_mark_the_given_encoding_keeps_is_taken_off(tmp_path, encoding):
    path = write(tmp_path, ("\ufeff" + TEXT).encode(encoding))
    assert read_text(path, encoding)[0] == TEXT


def test_line_endings(tmp_path):
    assert read_text(write(tmp_path, b"a\r\nb\rc\n"), None)[0] == "a\nb\nc\n"


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("log.csv", b"", "empty"),
        ("log.csv", b" \n\n", "empty"),
        ("log.csv", b"time\0\1\2", "binary"),
        ("log.csv", b"\x81\x8d\x8f", "binary"),
        ("log.csv", b"t\0,\0a\0\0\0", "binary"),
        ("log.csv", bytes(range(256)), "binary"),
        ("log.TDMS", b"TDSm", "only text logs"),
    ],
)
def test_refused(tmp_path, name, data, words):
    path = write(tmp_path, data, name)
    with pytest.raises(LogError, match=words) as caught:
        read_text(path, None)
    assert caught.value.where == str(path)


@pytest.mark.parametrize("name", ["log.csv", "log.TSV", "log.txt", "log.dat", "log"])
def test_endings(tmp_path, name):
    assert read_text(write(tmp_path, b"a", name), None)[0] == "a"


def test_folder_and_missing(tmp_path):
    with pytest.raises(LogError, match="folder"):
        read_text(tmp_path, None)
    with pytest.raises(LogError, match="no such file"):
        read_text(tmp_path / "log.csv", None)
    with pytest.raises(LogError, match="no such file"):
        read_text(tmp_path / "log.mat", None)


@pytest.mark.parametrize(
    ("error", "words"),
    [(PermissionError(13, "denied"), "no permission"), (OSError(5, "Input/output error"), "Input")],
)
def test_unreadable(tmp_path, monkeypatch, error, words):
    path = write(tmp_path, b"a")

    def refuse(*_args, **_options):
        raise error

    monkeypatch.setattr(text_module, "read_regular", refuse)
    with pytest.raises(LogError, match=words):
        read_text(path, None)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path):
    path = write(tmp_path, b"a")
    path.chmod(0)
    with pytest.raises(LogError, match="no permission"):
        read_text(path, None)


@pytest.mark.parametrize("encoding", ["undefined", "punycode", "a\0b", "base64", "klingon", ""])
def test_an_encoding_that_reads_nothing_is_refused(tmp_path, encoding):
    path = tmp_path / "log.csv"
    path.write_bytes(b"time_s,driving_deg\n0.0,1.\n" * 5)
    if encoding == "":  # as if it were not given
        assert read_text(path, encoding)[0].startswith("time_s")
        return
    with pytest.raises(LogError, match="unknown encoding") as caught:
        read_text(path, encoding)
    assert caught.value.where == "log.encoding"
