"""Inputs damaged at random: bytes of any file, cells and lines of text, arrays of a log.

Every function takes a generator of random numbers and returns bytes or arrays; the same seed gives
the same damage.
"""

from random import Random

import numpy as np

CELLS = (
    "", "nan", "NaN", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e999", "9" * 400, "0x10", "-0",
    "1,5", "1.5.2", "1e", "=1+1", "true", "\u0661\u0662", "1_000", "2026-01-01T00:00:00",
    "25:61:61", "\x00", '"', "\u221e", "--", "1e17", "18446744073709551616", "0", "#", ";",
    "1e-200",
)  # fmt: skip
"""Cells and values that are no plain numbers, or numbers that no log has."""

NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-320, 1e17, 0.0, -1.0, 2.0**63, 1e-200)


def damaged_bytes(data: bytes, draw: Random) -> bytes:
    """Flip, cut, remove, repeat, insert or overwrite bytes, once to three times."""
    for _ in range(draw.randint(1, 3)):
        if not data:
            return data
        place, length = draw.randrange(len(data)), draw.choice((1, 2, 4, 8, 64, 1000))
        kind = draw.randrange(6)
        if kind == 0:
            flipped = bytes([data[place] ^ (1 << draw.randrange(8))])
            data = data[:place] + flipped + data[place + 1 :]
        elif kind == 1:
            data = data[:place]
        elif kind == 2:
            data = data[:place] + data[place + length :]
        elif kind == 3:
            data = data[: place + length] + data[place:]
        elif kind == 4:
            data = data[:place] + draw.randbytes(length) + data[place:]
        else:
            put = draw.choice((b"\xff", b"\x00", b"\x7f", b"\x80")) * length
            data = data[:place] + put + data[place + length :]
    return data


def damaged_text(text: str, draw: Random) -> bytes:
    """Damage the lines, the cells or the encoding of a table or of a TOML file."""
    lines = text.splitlines()
    for _ in range(draw.randint(1, 3)):
        lines = _damaged_lines(lines, draw)
    mended = draw.choice(("\n", "\n", "\n", "\r\n", "\r")).join(lines) + draw.choice(("\n", ""))
    kind = draw.randrange(12)
    if kind == 0:
        codec = draw.choice(("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "utf-7", "cp500"))
        return mended.encode(codec, "replace")
    if kind == 1:
        return mended.replace("d", "\u00e9", 3).encode("latin-1", "replace")
    return mended.encode("utf-8")


def _damaged_lines(lines: list[str], draw: Random) -> list[str]:
    if not lines:
        return lines
    place = draw.choice((0, draw.randrange(len(lines)), len(lines) - 1))
    before, line, after = lines[:place], lines[place], lines[place + 1 :]
    kind = draw.randrange(10)
    if kind == 0:
        return [*before, line, line, *after]
    if kind == 1:
        return before + after
    if kind == 2:
        return [*before, *after[::-1]]
    if kind == 3:
        mark, other = draw.choice((",", "=", ".", "[", '"', " ")), draw.choice((";", "", "\t", ","))
        return [one.replace(mark, other) for one in lines]
    if kind == 4:
        return [*before, line[: draw.randrange(len(line) + 1)]]
    if kind == 5:
        return [_swapped(one, draw.random() < 0.5) for one in lines]
    mark = "=" if "=" in line else ","
    cells = line.split(mark)
    chosen = draw.randrange(len(cells))
    cells[chosen] = draw.choice(CELLS)
    changed = mark.join(cells)
    if kind == 6:  # the same cell in all lines
        rows = [one.split(mark) for one in lines]
        for row in rows:
            row[min(chosen, len(row) - 1)] = cells[chosen]
        return [mark.join(row) for row in rows]
    return [*before, changed, *after]


def _swapped(line: str, whole: bool) -> str:
    cells = line.split(",")
    return ",".join(cells[::-1] if whole else cells[1:2] + cells[:1] + cells[2:])


def damaged_arrays(arrays: dict[str, np.ndarray], draw: Random) -> dict[str, np.ndarray]:
    """Damage values, types and lengths of the columns of a log."""
    damaged = {name: values.copy() for name, values in arrays.items()}
    name = draw.choice(list(damaged))
    values = damaged[name]
    kind = draw.randrange(9)
    if kind == 0:
        values[draw.randrange(len(values))] = draw.choice(NUMBERS)
    elif kind == 1:
        values[:] = draw.choice(NUMBERS)
    elif kind == 2:
        damaged[name] = values[: draw.choice((0, 1, 2, len(values) // 2))]
    elif kind == 3:
        with np.errstate(all="ignore"):
            damaged[name] = values.astype(draw.choice(("i1", "u8", "f4", "i8", "?", "f2")))
    elif kind == 4:
        first, second = draw.sample(list(damaged), 2)
        damaged[first], damaged[second] = damaged[second], damaged[first]
    elif kind == 5:
        with np.errstate(all="ignore"):
            damaged[name] = values * draw.choice((1e300, 1e-300, -1.0, 1e12, 0.0))
    elif kind == 6:
        damaged[name] = values[::-1].copy()
    elif kind == 7:
        del damaged[name]
    else:
        damaged = {name: values[: draw.choice((0, 1, 2, 3))] for name, values in damaged.items()}
    return damaged
