"""A drive 1 : 2 written as CSV by plain trigonometry, cheap enough to be fitted often."""

from pathlib import Path

import numpy as np

RATE_HZ = 50.0
DELAY_S = 0.004
FIRST_ARCSEC = {"driving": 30.0, "driven": 50.0}
TORQUE_ARCSEC = 2.0
"""Wind-up per unit of torque, where there is any."""

PAIR = """
name = "drive"
[drive]
ratio = "{ratio}"
[log]
torque = "torque_nm"
speed = "speed_rad_per_s"
acceleration = "acceleration_rad_per_s2"
[fit]
driving_orders = [1, 2]
driven_orders = [1, 2]
"""


def write_drive(
    path: Path,
    *,
    seed: int = 0,
    start_deg: float = 0.0,
    delay_s: float = DELAY_S,
    torque_arcsec: float = 0.0,
    hum_arcsec: float = 0.0,
    ratio: float = 0.5,
) -> Path:
    """Ten turns forward at two speeds and back; the angles count from `start_deg` of the shafts.

    Noise of 1″. `ratio` is driven over driving speed. `hum_arcsec` is the size of a line of 3.7
    cycles per driving turn.
    """
    generator = np.random.default_rng(seed)
    speeds_rpm = np.array([0, 60, 60, 100, 100, 0, 0, -100, -100, -60, -60, 0, 0])
    knots_s = np.cumsum([0, 0.5, 5, 0.3, 3, 0.5, 1, 0.5, 3, 0.3, 5, 0.5, 0.2])
    fine = np.arange(0, knots_s[-1], 1e-3)
    speed = np.interp(fine, knots_s, speeds_rpm) * np.pi / 30
    turned = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * 1e-3)])
    time = np.arange(0.1, fine[-1] - 0.1, 1 / RATE_HZ)
    start = np.radians(start_deg)
    driving = start + np.interp(time, fine, turned)
    late = start + np.interp(time - delay_s, fine, turned)
    omega = np.interp(time, fine, speed)
    torque = np.sin(0.7 * time) + 0.1 * generator.standard_normal(len(time))
    arcsec = (
        FIRST_ARCSEC["driving"] * np.sin(late + 0.3)
        + FIRST_ARCSEC["driven"] * np.sin(late * ratio + 1.1)
        + np.where(np.interp(time - delay_s, fine, speed) < 0, 100.0, 0.0)
        + torque_arcsec * torque
        + hum_arcsec * np.sin(3.7 * late)
        + generator.standard_normal(len(time))
    )
    driven = late * ratio + np.radians(arcsec / 3600)
    columns = {
        "time_s": time,
        "driving_deg": np.degrees(driving - driving[0]),
        "driven_deg": np.degrees(driven - driven[0]),
        "torque_nm": torque,
        "speed_rad_per_s": omega,
        "acceleration_rad_per_s2": np.gradient(omega, time),
    }
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, "%.8f", ",", header=",".join(columns), comments="")
    return path


def write_pair(path: Path, ratio: str = "1/2") -> Path:
    """The pair file of the drive."""
    path.write_text(PAIR.format(ratio=ratio))
    return path
