"""Written and numeric time stamps."""

import numpy as np
import pytest

from tests.logs.rig_log import angles_deg, csv
from vttig_jax.base.errors import LogError
from vttig_jax.logs import read_log
from vttig_jax.logs.readers.times.epochs import epoch_unit
from vttig_jax.logs.readers.times.stamps import looks_like_stamp, read_stamps

DAY = 86400


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (["2026-11-01T22:15:03.250Z", "2026-11-01T22:15:03.252Z"], 0.002),
        (["2026-11-01 22:15:03,250+02:00", "2026-11-01 21:15:03,252+01:00"], 0.002),
        (["2026-11-01T23:59:59.999999999", "2026-11-02T00:00:00.000000001"], 2e-9),
        (["01.11.2026 23:59:59,998", "02.11.2026 00:00:00,000"], 0.002),
        (["11:59:59.9 PM", "12:00:00.1 AM"], 0.2),
        (["12:59:59 pm", "1:00:00 pm"], 1.0),
        (["23:59:59.5", "00:00:00.0"], 0.5),
        (["11/30/2026 01:02:03 PM", "12/01/2026 01:02:03 PM"], DAY),
        (["30/11/2026 01:02:03", "01/12/2026 01:02:03"], DAY),
        (["01-Nov-2026 00:30:00", "02-Nov-2026 00:30:01"], DAY + 1),
        (["2026-02-28 00:00", "2026-03-01 00:00"], DAY),
        (["20261101T235959.75Z", "20261102T000000.25Z"], 0.5),
        (["Nov 01, 2026 11:59:59.5 PM", "Nov 02, 2026 12:00:00.0 AM"], 0.5),
        (["59:59.75", "00:00.25"], 0.5),
        (["59:59.75", "1:00:00.25"], 0.5),
        (["2026-11-01 00:00:00 CET", "2026-11-01 00:00:00.5 CET"], 0.5),
        (["2026-11-01 00:00:00Z", "2026-11-01 01:00:00.5+01:00", "2026-11-01 00:00:01 UTC"], 0.5),
    ],
)
def test_written_stamps(stamps, seconds):
    assert all(map(looks_like_stamp, stamps))
    assert read_stamps(stamps, "log.csv")[0][:2].tolist() == [0, round(seconds * 1e9)]


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (["01/02/2026 00:00:00", "02/02/2026 00:00:00"], "day and month or month and day"),
        (["2026-11-01 00:00:00 CET", "2026-11-01 00:00:01 CEST"], "time zone changes"),
        (["2026-11-01 00:00:00 CET", "2026-11-01 00:00:01+01:00"], r"changes \(\+01:00, CET\)"),
        (["2026-11-01 00:00:00", "2026-11-01 00:00:01+01:00"], r"changes \(\+01:00, none\)"),
        (["2026-11-01 00:00:00", "broken"], "`broken` in row 2"),
        (["2026-13-01 00:00:00", "2026-13-01 00:00:01"], "is no date"),
    ],
)
def test_stamps_that_are_refused(stamps, words):
    with pytest.raises(LogError, match=words):
        read_stamps(stamps, "log.csv")


@pytest.mark.parametrize("text", ["", "1.5", "25:00:00", "12:61:00", "13:00 PM", "a:b", "1:2"])
def test_what_is_no_stamp(text):
    assert not looks_like_stamp(text)


@pytest.mark.parametrize(
    ("first", "unit"),
    [
        (1_793_570_103, "s"),
        (1_793_570_103_250, "ms"),
        (1_793_570_103_250_000, "us"),
        (1_793_570_103_250_000_000, "ns"),
        (134_059_017_032_500_000, "100ns"),
        (60_000, None),
        (45_000.5, None),
    ],
)
def test_epochs_by_magnitude(first, unit):
    found = epoch_unit(np.array([first, first + 1]))
    assert (found and found.unit) == unit


def time_of(tmp_path, stamps, name="time", **options):
    _, x, y = angles_deg(turns=2)
    path = tmp_path / "log.csv"
    size = min(len(stamps), len(x))
    path.write_text(csv(f"{name},motor_deg,load_deg", stamps[:size], x[:size], y[:size]))
    return read_log(path, ratio="16:9", **options).time


def test_nanoseconds_since_1970_keep_all_digits(tmp_path):
    whole = 1_793_570_103_250_000_001 + 10_000_019 * np.arange(400)
    time = time_of(tmp_path, whole)
    np.testing.assert_allclose(time, 0.010000019 * np.arange(400), rtol=1e-15)
    assert np.abs(np.diff(whole.astype(np.float64)) / 1e9 - 0.010000019).max() > 1e-8  # as floats


def test_decimal_seconds_since_1970_keep_all_digits(tmp_path):
    stamps = [f"{1_793_570_103 + k // 100}.{k % 100:02d}0000019" for k in range(400)]
    np.testing.assert_allclose(time_of(tmp_path, stamps), np.arange(400) / 100, atol=1e-12)


def test_days_of_excel(tmp_path):
    fine = [f"{46327 + k / 100 / DAY:.10f}" for k in range(400)]
    time = time_of(tmp_path, fine, unit={"time": "d"})
    np.testing.assert_allclose(time, np.arange(400) / 100, atol=1e-5)
    coarse = [f"{46327 + k / 100 / DAY:.6f}" for k in range(400)]
    with pytest.raises(LogError, match="too coarse for samples"):
        time_of(tmp_path, coarse, unit={"time": "d"})


def test_german_dates_through_midnight(tmp_path):
    stamps = [f"01.11.2026 23:59:{58 + k // 100:02d},{k % 100:02d}" for k in range(200)]
    stamps += [f"02.11.2026 00:00:{k // 100:02d},{k % 100:02d}" for k in range(200)]
    _, x, y = angles_deg(turns=2)
    path = tmp_path / "log.csv"
    rows = [
        ";".join([stamp, *(f"{one:.6f}".replace(".", ",") for one in angles)])
        for stamp, *angles in zip(stamps, x, y, strict=False)
    ]
    head = "sep=;\r\nDatum/Uhrzeit;Antrieb [°];Abtrieb [°]\r\n"
    path.write_bytes((head + "\r\n".join(rows)).encode("cp1252"))
    log = read_log(path, ratio="16:9")
    np.testing.assert_allclose(log.time, np.arange(400) / 100, atol=1e-12)
    assert any("starts at 01.11.2026 23:59:58" in note for note in log.notes)
