"""Compile a C header with the compiler at hand, and call its functions at many readings."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

CC, CXX = shutil.which("cc"), shutil.which("c++")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow")

needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler (`cc`) on this machine")

_DRIVER = """
#include "{name}.h"
#include <stdio.h>

int main(void)
{{
    double x[3], y[5];
    while (fread(x, sizeof x[0], 3, stdin) == 3) {{
{body}
        fwrite(y, sizeof y[0], 5, stdout);
    }}
    return 0;
}}
"""

SHIFT = """
        const struct {name}_gap gap = {name}_backlash(x[0], x[1]);
        const struct {name}_displacement shift = {name}_shift(x[0], x[1], x[2]);
        y[0] = gap.backlash_rad;
        y[1] = gap.slope;
        y[2] = shift.shift_mm;
        y[3] = shift.slope_mm_per_rad;
        y[4] = 10.0 * gap.status + shift.status;
"""

BACKLASH = """
        const struct {name}_gap gap = {name}_backlash(x[0], x[1]);
        y[0] = gap.backlash_rad;
        y[1] = gap.slope;
        y[2] = y[3] = 0.0;
        y[4] = gap.status;
"""

ARITHMETIC = """
        {name}_sincos_(x[0], &y[0], &y[1]);
        y[2] = {name}_within_turn_(x[1]);
        y[3] = y[4] = 0.0;
"""

TABLE = """
        y[0] = {name}_forward_deg(x[0]);
        y[1] = {name}_reverse_deg(x[0]);
        y[2] = y[3] = y[4] = 0.0;
"""


def compiled(
    folder: Path, text: str, name: str, body: str = SHIFT, *, flags: tuple[str, ...] = STRICT
) -> Path:
    """A program that reads triples of doubles and writes what `body` makes of them.

    **Raises** `subprocess.CalledProcessError` with the compiler's words where it refuses.
    """
    (folder / f"{name}.h").write_text(text, encoding="ascii")
    source = folder / "driver.c"
    source.write_text(_DRIVER.format(name=name, body=body.format(name=name)))
    program = folder / f"{name}.out"
    assert CC is not None
    command = [CC, *flags, "-O2", "-o", str(program), str(source)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return program


def called(program: Path, *columns) -> np.ndarray:
    """What the program makes of columns that broadcast to (n, 3): shape (5, n)."""
    stacked = np.stack(np.broadcast_arrays(*np.atleast_1d(*columns)), axis=-1)
    done = subprocess.run(
        [str(program)], input=stacked.astype(np.float64).tobytes(), capture_output=True, check=True
    )
    return np.frombuffer(done.stdout).reshape(-1, 5).T
