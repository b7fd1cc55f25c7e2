"""A LinuxCNC without display and without ports that moves rotary axes, and what it commanded.

It is isolated from every other process: private mounts, processes, shared memory and network.
"""

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

SPEED_DEG_S, ACCELERATION_DEG_S2, SERVO_S = 1200.0, 5000.0, 1e-3

_BUFFERS = {
    "emcCommand": 8192,
    "emcStatus": 20480,
    "emcError": 8192,
    "toolCmd": 1024,
    "toolSts": 1024,
}
_QUEUES = ("emcCommand", "emcError")
_PROCESSES = {"emc": (0, 0), "emcsvr": (1, 2), "tool": (0, 3), "xemc": (0, 10)}

_DRIVE = """#!/usr/bin/python3
import linuxcnc, subprocess, time
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
samples = open("samples.txt", "w")
sampler = subprocess.Popen(["halsampler"], stdout=samples)
for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
    command.state(state)
    command.wait_complete(20)
def manual():
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete(20)
    command.teleop_enable(0)
    command.wait_complete(20)

def home():
    manual()
    command.home(-1)
    time.sleep(0.3)
    for _ in range(400):
        time.sleep(0.05)
        status.poll()
        if all(status.homed[:JOINTS]):
            break
    command.teleop_enable(1)
    command.wait_complete(20)
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete(20)

def jog(distance):
    manual()
    command.unhome(-1)
    command.wait_complete(20)
    for joint in range(JOINTS):
        command.jog(linuxcnc.JOG_INCREMENT, True, joint, 100, distance)
    time.sleep(abs(distance) / 100 + 0.5)

for line in open("moves.txt"):
    if line.startswith("JOG"):
        jog(float(line.split()[1]))
    elif line.startswith("HOME"):
        home()
    else:
        command.mdi(line.strip())
        while command.wait_complete(60) == -1:
            pass
time.sleep(0.3)
with open("messages.txt", "w") as out:
    while message := errors.poll():
        print(message, file=out)
sampler.terminate()
sampler.wait()
command.state(linuxcnc.STATE_OFF)
"""


def why_not() -> str | None:
    """Return why LinuxCNC cannot run here, or None."""
    import os

    missing = [name for name in ("linuxcnc", "unshare", "halsampler") if not shutil.which(name)]
    if missing:
        return f"{' and '.join(missing)} not installed"
    if os.geteuid() != 0:
        return "needs root to isolate LinuxCNC"
    probe = ["unshare", "-m", "-n", "-i", "-p", "-f", "--mount-proc", "true"]
    done = subprocess.run(probe, capture_output=True)
    return None if done.returncode == 0 else "unshare is not permitted"


HOME_HERE = "HOME_OFFSET = 0\nHOME = 0\n"
"""An axis that is homed where it stands."""


def home_at(switch_deg: float, offset_deg: float) -> str:
    """An axis that finds a switch of the motor at an angle, and calls this place `offset_deg`."""
    return (
        f"HOME_SEARCH_VEL = 20\nHOME_LATCH_VEL = 0.05\nHOME_OFFSET = {offset_deg:.7f}\nHOME = 0\n"
        f"HOME_FINAL_VEL = 100\nSWITCH_DEG = {switch_deg}\n"
    )


def home_at_index(offset_deg: float) -> str:
    """An axis that calls the index, at which the encoder of its motor reads zero, `offset_deg`.

    It has no switch. The simulated index comes 10 ms after the axis began to look for it.
    """
    return (
        f"HOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 1\nHOME_USE_INDEX = YES\nHOME_FINAL_VEL = 100\n"
        f"HOME_OFFSET = {offset_deg}\nHOME = 0\n"
    )


def moved(
    folder: Path, tables: list[str], moves: list[str], homing: Sequence[str] = (HOME_HERE,) * 6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move axes with one table each, and return what was sampled each millisecond.

    They are A, B and C, then X, Y and Z, whose mm stand for degrees: only three axes are rotary.
    The paths of the tables have a space.

    A move is a line of G-code; the line HOME homes all axes, first of all by default, and the line
    JOG 37 moves them by 37° unhomed. `homing` are lines of the INI file for each axis. An empty
    table is none. A machine on which the controller does not end in time skips the test.

    **Returns** command, motor position and speed, °, shapes (samples, axes).
    """
    axes = "ABCXYZ"[: len(tables)]
    source, rows = folder / "machine", range(len(tables))
    source.mkdir()
    for number, table in enumerate(tables):
        (source / f"axis {number}.comp").write_text(table)
    if "HOME" not in moves:
        moves = ["HOME", *moves]
    (source / "moves.txt").write_text("\n".join(moves) + "\n")
    drive = source / "drive.py"
    drive.write_text(_DRIVE.replace("JOINTS", str(len(tables))))
    drive.chmod(0o755)
    (source / "axis.nml").write_text(_nml())
    (source / "axis.ini").write_text(_ini(axes, homing))
    joined = {"pos-cmd": "command", "motor-pos-cmd": "motor", "vel-cmd": "speed"}
    hal = [
        f"loadrt trivkins coordinates={axes}",
        f"loadrt motmod servo_period_nsec={round(1e9 * SERVO_S)} num_joints={len(tables)}",
        f"loadrt sampler depth=60000 cfg={'fff' * len(tables)}",
        f"loadrt comp count={len(tables)}",
        f"loadrt sim_home_switch count={len(tables)}",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        "addf sampler.0 servo-thread",
        "net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in",
        "setp sampler.0.enable 1",
    ]
    for joint in rows:
        for place, (pin, name) in enumerate(joined.items()):
            back = f" joint.{joint}.motor-pos-fb" if name == "motor" else ""
            hal.append(
                f"net {name}{joint} joint.{joint}.{pin} =>{back} sampler.0.pin.{3 * joint + place}"
            )
        if switch := re.search("SWITCH_DEG = (.*)", homing[joint]):
            hal += [
                f"setp comp.{joint}.in0 {switch[1]}",
                f"net motor{joint} => comp.{joint}.in1",
                f"net switch{joint} comp.{joint}.out => joint.{joint}.home-sw-in",
                f"addf comp.{joint} servo-thread",
            ]
        if "HOME_USE_INDEX" in homing[joint]:
            hal += [
                f"net index{joint} sim-home-switch.{joint}.index-enable joint.{joint}.index-enable",
                f"addf sim-home-switch.{joint} servo-thread",
            ]
    (source / "axis.hal").write_text("\n".join(hal) + "\n")
    result = folder / "result"
    result.mkdir()
    script = f"""
mount -t tmpfs tmpfs /mnt && cp -r {source}/. /mnt && cd /mnt && chmod 755 . || exit 9
mkdir fifo temporary && chown 65534 fifo && mount --bind temporary /tmp || exit 9
export RTAPI_UID=65534 RTAPI_FIFO_PATH=/mnt/fifo/rtapi HOME=/mnt
timeout -k 5 60 linuxcnc axis.ini > out.txt 2>&1 < /dev/null
code=$?
umount /tmp && cp out.txt samples.txt messages.txt {result}/
exit $code
"""
    isolated = ["timeout", "-k", "5", "80", "unshare", "-m", "-n", "-i", "-p", "-f", "--mount-proc"]
    done = subprocess.run([*isolated, "bash", "-c", script], capture_output=True, text=True)
    if done.returncode in (124, 137):
        pytest.skip("LinuxCNC did not end in time: its clock does not run on so slow a machine")
    assert done.returncode == 0, done.stderr + (result / "out.txt").read_text()
    assert (result / "messages.txt").read_text() == "", "LinuxCNC told its operator something"
    lines = (result / "samples.txt").read_text().splitlines()
    assert not any("overrun" in line for line in lines)
    found = np.array([line.split() for line in lines if line.strip()], float)
    return found[:, 0::3], found[:, 1::3], found[:, 2::3]


def _nml() -> str:
    lines = []
    for number, (name, size) in enumerate(_BUFFERS.items(), 1):
        queue = " queue" if name in _QUEUES else ""
        lines.append(f"B {name} SHMEM localhost {size} 0 0 {number} 16 {1000 + number}{queue}")
    for process, (master, number) in _PROCESSES.items():
        lines += [
            f"P {process} {name} LOCAL localhost RW 0 5.0 {master} {number}" for name in _BUFFERS
        ]
    return "\n".join(lines) + "\n"


def _ini(axes: str, homing: Sequence[str]) -> str:
    limits = (
        f"MIN_LIMIT = -100000\nMAX_LIMIT = 100000\nMAX_VELOCITY = {SPEED_DEG_S}\n"
        f"MAX_ACCELERATION = {ACCELERATION_DEG_S2}\n"
    )
    parts = [
        "[EMC]\nVERSION = 1.1\nMACHINE = test\nNML_FILE = axis.nml\n",
        "[DISPLAY]\nDISPLAY = ./drive.py\n",
        "[TASK]\nTASK = milltask\nCYCLE_TIME = 0.001\n",
        "[RS274NGC]\nPARAMETER_FILE = axis.var\n",
        f"[EMCMOT]\nEMCMOT = motmod\nCOMM_TIMEOUT = 4.0\nSERVO_PERIOD = {round(1e9 * SERVO_S)}\n",
        "[EMCIO]\nEMCIO = io\nCYCLE_TIME = 0.1\n[HAL]\nHALFILE = axis.hal\n",
        f"[TRAJ]\nCOORDINATES = {axes}\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n"
        f"MAX_ANGULAR_VELOCITY = {2 * SPEED_DEG_S}\n"
        f"MAX_ANGULAR_ACCELERATION = {ACCELERATION_DEG_S2}\n"
        f"MAX_LINEAR_VELOCITY = {2 * SPEED_DEG_S}\n"
        f"MAX_LINEAR_ACCELERATION = {ACCELERATION_DEG_S2}\n",
        f"[KINS]\nKINEMATICS = trivkins coordinates={axes}\nJOINTS = {len(axes)}\n",
    ]
    for joint, axis in enumerate(axes):
        parts.append(f"[AXIS_{axis}]\n{limits}")
        parts.append(
            f"[JOINT_{joint}]\nTYPE = {'ANGULAR' if axis in 'ABC' else 'LINEAR'}\n{limits}"
            "FERROR = 10\nMIN_FERROR = 10\n"
            f"HOME_SEQUENCE = 0\n{homing[joint]}"
            f"COMP_FILE = axis {joint}.comp\nCOMP_FILE_TYPE = 1\n"
        )
    return "".join(parts)
