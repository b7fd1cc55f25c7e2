"""Guide logs of PHD2: the error that the mount would show without pulses, and what is refused."""

import numpy as np
import pytest

from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs import read_log
from vttig_jax.logs.readers.open_table import open_table

SCALE, DECLINATION, ANGLE_DEG, SPEED = 2.0, 35.0, 30.0, 7.5
PERIOD_S, AMPLITUDE = 86164.0905 / 180, 9.0
HEADER = (
    "Frame,Time,mount,dx,dy,RARawDistance,DECRawDistance,RAGuideDistance,DECGuideDistance,"
    "RADuration,RADirection,DECDuration,DECDirection,XStep,YStep,StarMass,SNR,ErrorCode"
)
FACTS = {
    "scale": f"Pixel scale = {SCALE:.2f} arc-sec/px, Binning = 1, Focal length = 400 mm",
    "mount": f"Mount = M, connected, guiding enabled, xAngle = {ANGLE_DEG}, xRate = 3.072, "
    "yAngle = 120.0, yRate = 4.9, parity = +/+",
    "speed": f"RA Guide Speed = {SPEED} a-s/s, Dec Guide Speed = 7.5 a-s/s, Cal Dec = 10.0, "
    "Last Cal Issue = None",
    "pointing": f"RA = 5.00 hr, Dec = {DECLINATION} deg, Hour angle = 1.00 hr, Pier side = East",
    "lock": "Lock position = 500.000, 400.000, Star position = 500.1, 400.2, HFD = 3.10 px",
}


def worm_arcsec(time):
    return AMPLITUDE * np.sin(2 * np.pi * time / PERIOD_S + 0.4) + 0.002 * time


def session(frames=900, facts=FACTS, *, moves=True) -> str:
    """Text of a guided session: each pulse is 0.7 of the distance it sees, in whole ms."""
    px = SCALE / np.cos(np.radians(DECLINATION))
    lines = ["Guiding Begins at 2026-10-01 21:00:00", "Equipment Profile = P", *facts.values()]
    lines += [HEADER, "INFO: SETTLING STATE CHANGE, Settling started"]
    guided, lock, zero = 0.0, np.array([500.0, 400.0]), 0.0
    across = np.array([np.cos(np.radians(ANGLE_DEG)), np.sin(np.radians(ANGLE_DEG))])
    for k in range(1, frames + 1):
        time = 2.0 * k + 0.1 * (k % 3)
        if moves and k % 200 == 100:  # a dither, which is logged twice
            zero, lock = zero + 1.5, lock + 1.5 * across
            at = f"new lock pos = {lock[0]:.3f}, {lock[1]:.3f}"
            lines += [f"INFO: SET LOCK POSITION, {at}", f"INFO: DITHER by 1.500, 0.000, {at}"]
        if moves and k == 350:  # a new lock position without a dither
            zero, lock = zero - 2.0, lock - 2.0 * across
            lines.append(f"INFO: SET LOCK POSITION, new lock pos = {lock[0]:.3f}, {lock[1]:.3f}")
        if moves and k == 500:
            guided -= 0.4 * SPEED
            lines.append("INFO: Manual guide (Mount) East 400 ms")
        if k % 61 == 0:
            lines.append(f'{k},{time:.3f},"DROP",,,,,,,,,,,,,11,1.20,2,"Star lost - low SNR"')
            continue
        raw = (worm_arcsec(time) - guided) / px - zero
        pulse = round(abs(raw) * 0.7 * px / SPEED * 1000)
        way = "" if not pulse else "W" if raw > 0 else "E"
        guided += np.sign(raw) * pulse / 1000 * SPEED
        lines.append(
            f'{k},{time:.3f},"Mount",0.1,0.2,{raw:.3f},0.010,{0.7 * raw:.3f},0.000,{pulse},{way},'
            "0,,,,1200,20.1,0"
        )
    return "\n".join([*lines, "Guiding Ends at 2026-10-01 21:31:00", ""])


START = "PHD2 version 2.6.13, Log version 2.5. Log enabled at 2026-10-01 20:00:00\n\n"
CALIBRATION = (
    "Calibration Begins at 2026-10-01 20:30:00\nDirection,Step,dx,dy,x,y,Dist\n"
    + "".join(f"West,{k},{k}.0,0.0,{500 + k},400.0,{k}.0\n" for k in range(9))
    + "West calibration complete. Angle = 30.0 deg, Rate = 3.072 px/sec, Parity = Even\n\n"
)


@pytest.fixture
def save(tmp_path):
    def write(*parts):
        path = tmp_path / "PHD2_GuideLog.txt"
        path.write_text(START + CALIBRATION + "\n".join(parts), encoding="utf-8")
        return path

    return write


def test_the_error_without_pulses_and_dithers(save):
    log = read_log(save(session()), ratio="180:1", driving_rpm="sidereal")
    assert log.transmission_error is not None
    seen = np.degrees(log.transmission_error) * 3600
    assert len(log) == 900 - 900 // 61
    wanted = worm_arcsec(log.time)
    assert np.abs(seen - seen[0] - (wanted - wanted[0])).max() < 0.02  # px are written to 0.001
    turns = (log.time[-1] - log.time[0]) / PERIOD_S
    assert np.ptp(log.driving_angle) / (2 * np.pi) == pytest.approx(turns, rel=1e-9)
    assert any("guide rate 7.5″/s as the mount reports" in note for note in log.notes)


def test_the_sum_of_pulses_matters(save):
    """Negative control: the distances alone show little of the worm."""
    table = open_table(save(session(moves=False)))
    raw = [float(line.split(",")[5]) for line in session(moves=False).split("\n") if '"Mo' in line]
    assert np.ptp(table.columns([1])[0]) > 5 * np.ptp(np.array(raw)) * SCALE


def test_the_rate_of_the_calibration_stands_in(save):
    unknown = FACTS | {"speed": "RA Guide Speed = Unknown, Dec Guide Speed = Unknown"}
    table = open_table(save(session(facts=unknown)))
    notes = table.notes
    rate = 3.072 * SCALE / np.cos(np.radians(DECLINATION))
    assert f"guide rate {rate:.4g}″/s from xRate" in notes[1]
    known = open_table(save(session())).columns([1])[0]
    assert np.abs(table.columns([1])[0] - known).max() < 0.002 * np.abs(known).max() + 0.02


def test_rates_that_disagree_are_told(save):
    wrong = FACTS | {"speed": "RA Guide Speed = 15.0 a-s/s, Dec Guide Speed = 7.5 a-s/s"}
    assert "(the calibration measured 7.5″/s)" in open_table(save(session(facts=wrong))).notes[1]


def test_several_sessions_are_asked_for(save):
    path = save(session(120), session(5), session(150))
    with pytest.raises(LogError, match=r"2 columns could be `transmission_error` \(1/.*, 3/"):
        read_log(path, ratio="180:1", driving_rpm="sidereal")
    chosen = {"transmission_error": "3/transmission_error_arcsec"}
    log = read_log(path, ratio="180:1", driving_rpm="sidereal", columns=chosen)
    assert len(log) == 148 and log.spec is not None and log.spec.log.time == "3/time_s"
    assert any("left out: session 2, it has 5 rows" in note for note in log.notes)


def test_the_clock_is_asked_for(save):
    with pytest.raises(LogError, match="--driving-rpm sidereal"):
        read_log(save(session(60)), ratio="180:1")
    with pytest.raises(UsageError, match="--driving-rpm"):
        read_log(save(session(60)), ratio="180:1", driving_rpm="solar")


def test_a_cut_last_row_is_left_out(save):
    text = session(90, moves=False).replace("Guiding Ends at 2026-10-01 21:31:00\n", "")
    table = open_table(save(text + '91,182.100,"Mount",0.1,0.2,0.'))
    assert len(table.columns([0])[0]) == 89


@pytest.mark.parametrize(
    ("key", "line", "words"),
    [
        ("scale", "Pixel scale = unspecified", "the heading lacks `Pixel scale = 2.00"),
        ("pointing", "RA/Dec = Unknown, Hour angle = Unknown", "lacks `Dec = 20.0 deg`"),
        ("mount", "Mount = M", "neither RA Guide Speed nor xRate"),
    ],
)
def test_headings_that_lack_a_fact(save, key, line, words):
    facts = FACTS | {key: line}
    if key == "mount":
        facts["speed"] = "RA Guide Speed = Unknown"
    with pytest.raises(LogError, match="no session of guiding can be used") as caught:
        open_table(save(session(60, facts, moves=False)))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"Mount"', '"AO"', "adaptive optics"),
        ("INFO: SETTLING", "INFO: LOCK SHIFT, enabled = 1\nINFO: S", "shifted all the time"),
        ("xAngle", "angle", "states no xAngle"),
        ('31,62.100,"Mount"', "31,sixty,Mount", "line"),
    ],
)
def test_what_is_no_error_of_the_mount(save, old, new, words):
    with pytest.raises(LogError, match=words):
        open_table(save(session(400).replace(old, new)))
