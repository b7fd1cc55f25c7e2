"""Points of py_gearworks' tooth curve, in a process and environment of its own.

    PYTHON benchmarks/surface_peer.py FOLDER

It brings a CAD system with it that nothing here needs. Reads one JSON object a line (teeth,
module_mm, pressure_angle_deg, points), writes the curve as FOLDER/peer.npy and the seconds it took.
"""

import json
import math
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
from py_gearworks.gearteeth import InvoluteTooth  # pyright: ignore[reportMissingImports]


def main(folder: Path) -> None:
    print(json.dumps({"version": version("py-gearworks")}), flush=True)
    for line in sys.stdin:
        wanted = json.loads(line)
        tooth = InvoluteTooth(
            pitch_intersect_angle=math.pi / (2 * wanted["teeth"]),
            pitch_radius=wanted["module_mm"] * wanted["teeth"] / 2,
            cone_angle=0,
            pressure_angle=math.radians(wanted["pressure_angle_deg"]),
        )
        involute = tooth.generate_tooth_curve()[1]
        share = np.linspace(0.0, 1.0, wanted["points"])
        clock = time.perf_counter()
        points = involute(share)
        taken = time.perf_counter() - clock
        np.save(folder / "peer.npy", points)
        print(json.dumps({"seconds": taken}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
