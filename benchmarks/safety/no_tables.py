"""Texts of one megabyte that are no table: the time of the processor until each is refused or read.

    python -m benchmarks.safety.no_tables

Every kind of text is looked at as `vttig inspect` does. At most 1 s is wanted for each. Writes
results/no_tables.json; the exit code is 1 if a text took longer, or ended in another way than with
one sentence.
"""

import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

from vttig_jax.base.errors import InputError
from vttig_jax.logs.preview import preview_log

from ..environment import write

SIZE, MOST_S = 1_000_000, 1.0
UNITS = (
    *("a", "1", "1 2.5 3 ", "1,2.5,3,", "alpha beta ", "alpha,beta,", "alpha,beta,gamma\n", "a\n"),
    *("\n", "\t", ",", ";\n", '"', '"a",', "a,1\n", "(", "[", '{"a":', "a=1 ", "a=b c=d\n", "a:b:"),
    *("12:00:00 ", "12:00:00\n", "Time,A,B\nx,y,z\n\n", "Time,A,B\n1,2\n\n", '<a b="1">2</a>\n'),
    *("1'234'567", "1,234,567,890", "1\u00a0234\u00a0", ".", "-", "1e", "|", "| a | b |\n|---|\n"),
    *("RIG:A 2026-01-01 00:00:00.0 x\n", " (123.4) can0 1A0 [8] 00 11 22\n", "a,b\r", "测量,值\n"),
)
HEADS = (
    *("", '"', "overrun\n", "sep=;\n", "LabVIEW Measurement\n", "Name\ta\nSampleTime\t1\n"),
    *("PHD2 Log version 2.5\nGuiding Begins at x\n", "X,CH1,Start,Increment\nX,V,0,1\n"),
)
WORDS = (
    "alpha",
    "motor",
    "1.5",
    "=",
    "x1",
    "nan",
    "12:00",
    "#",
    '"',
    ";",
    "[",
    ")",
    "{",
    "0,5",
    "%",
)


def texts(draw: Random) -> Iterator[tuple[str, str]]:
    """Yield the kind and the text: repeated units, some below a head, and random words."""
    for k, unit in enumerate((*UNITS, *UNITS)):
        head = HEADS[k % len(HEADS)] if k >= len(UNITS) else ""
        yield f"{head!r} {unit!r}", (head + unit * (SIZE // len(unit)))[:SIZE]
    yield "blanks", " " * (SIZE // 2) + "x" * (SIZE // 2 - 1) + "#"
    yield "long names", "a," + "b " * (SIZE // 2) + "\n1,2\n3,4\n"
    yield "many keys", json.dumps({f"k{k}": [1, 2] for k in range(SIZE // 16)})
    for mark in (" ", ",", ";", "\t"):
        lines = (mark.join(draw.choices(WORDS, k=12)) for _ in range(SIZE // 50))
        yield f"words and {mark!r}", "\n".join(lines)


def main() -> int:
    slow, count, longest = {}, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.txt"
        for kind, text in texts(Random(0)):
            path.write_text(text, encoding="utf-8", newline="")
            start, ended = time.process_time(), ""
            try:
                preview_log(path)
            except InputError:
                pass
            except Exception as error:
                ended = repr(error)[:200]
            taken = time.process_time() - start
            count, longest = count + 1, max(longest, taken)
            if ended or taken > MOST_S:
                slow[kind] = ended or round(taken, 2)
                print(kind, slow[kind], flush=True)
    print(f"{count} texts, {len(slow)} too slow or faulty, longest {longest:.2f} s")
    write("no_tables.json", {"texts": count, "longest_s": round(longest, 2), "faults": slow})
    return bool(slow)


if __name__ == "__main__":
    sys.exit(main())
