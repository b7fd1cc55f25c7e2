"""How many small defects do the tests see?

    python -m benchmarks.mutants [--number 150] [--seed 0] [--package DIR] [--seconds 300]

Each mutant is one change in one function of `kinematics`, `model`, `identify`, `posterior` or
`control`: a sign, a comparison, an index, a constant, or a term that is left out. The tests that
import the changed module run until one fails, the slow ones last. Where no test imports it, those
of the modules that import it do. A mutant that no test kills within the seconds allowed has
survived. Two commits are compared by the share that is killed; `--package` is the root of the other
commit. Writes results/mutants.json.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from .environment import write

ROOMS = ("kinematics", "model", "identify", "posterior", "control")
HERE = Path(__file__).resolve().parents[1]
COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
}


@dataclass(frozen=True)
class Mutant:
    """One change: the text between two offsets of a line of a module becomes another."""

    module: str
    line: int
    kind: str
    before: str
    after: str
    start: int
    stop: int


def mutants_of(path: Path, root: Path) -> Iterator[Mutant]:
    """Every change that the operators know, in the functions of one module."""
    source = path.read_text("utf-8")
    data = source.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    module = path.relative_to(root).with_suffix("").as_posix().replace("/", ".")
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        every = (inner for statement in function.body for inner in ast.walk(statement))
        for node in (one for one in every if isinstance(one, ast.expr)):
            assert node.end_lineno is not None and node.end_col_offset is not None
            for kind, changed in changes(node):
                begin = starts[node.lineno - 1] + node.col_offset
                end = starts[node.end_lineno - 1] + node.end_col_offset
                before = data[begin:end].decode()
                yield Mutant(module, node.lineno, kind, before, changed, begin, end)


def changes(node: ast.expr) -> Iterator[tuple[str, str]]:
    """Kind and new text of every change of one expression."""
    match node:
        case ast.BinOp(left, ast.Add() | ast.Sub() as operator, right):
            sign = "-" if isinstance(operator, ast.Add) else "+"
            yield "sign", f"({ast.unparse(left)} {sign} ({ast.unparse(right)}))"
            yield "term", f"({ast.unparse(left)})"
        case ast.BinOp(left, ast.Mult(), right):
            yield "term", f"({ast.unparse(left)})"
        case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
            yield "sign", f"({ast.unparse(operand)})"
        case ast.Compare(left, [operator], [right]) if type(operator) in COMPARISONS:
            new = COMPARISONS[type(operator)]
            yield "bound", f"({ast.unparse(left)} {new} {ast.unparse(right)})"
        case ast.Subscript(value, ast.Constant(int() as index)) if not isinstance(index, bool):
            yield "index", f"{ast.unparse(value)}[{index + 1 if index >= 0 else index - 1}]"
        case ast.Constant(float() as number):
            yield "constant", repr(number * 1.5 if number else 0.5)


def drawn(root: Path, number: int, seed: int) -> list[Mutant]:
    """Mutants of all rooms, the same number from each."""
    generator = random.Random(seed)
    found: list[Mutant] = []
    per_room = -(-number // len(ROOMS))
    for room in ROOMS:
        by_module: dict[str, list[Mutant]] = {}
        for path in sorted((root / "vttig_jax" / room).rglob("*.py")):
            for mutant in mutants_of(path, root):
                by_module.setdefault(mutant.module, []).append(mutant)
        everything = [mutant for own in by_module.values() for mutant in own]
        found += generator.sample(everything, min(per_room, len(everything)))
    return found[:number]


def tests_of(module: str, root: Path) -> list[Path]:
    """Test files that import a module, or else those that import what imports it."""
    tests = {path: path.read_text("utf-8") for path in sorted((root / "tests").rglob("test_*.py"))}

    def importing(name: str) -> list[Path]:
        package, _, stem = name.rpartition(".")
        ways = (f"from {name} import", f"from {package} import {stem}")
        return [path for path, text in tests.items() if any(way in text for way in ways)]

    if found := importing(module):
        return found
    stem = module.rpartition(".")[2]
    above: list[Path] = []
    for path in sorted((root / "vttig_jax").rglob("*.py")):
        if f".{stem} import" in path.read_text("utf-8"):
            above += importing(path.relative_to(root).with_suffix("").as_posix().replace("/", "."))
    return sorted(set(above))


def killed(mutant: Mutant, root: Path, copy: Path, seconds: float) -> str:
    """The verdict: "killed", "survived", or "slow" where the time ran out."""
    place = Path(mutant.module.replace(".", "/")).with_suffix(".py")
    data = (root / place).read_bytes()
    changed = data[: mutant.start] + mutant.after.encode() + data[mutant.stop :]
    (copy / place).write_bytes(changed)
    files = [str(path.relative_to(root)) for path in tests_of(mutant.module, root)]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    try:
        for kind in ("not slow", "slow"):
            done = subprocess.run(
                [*command, "-m", kind, *files],
                cwd=copy,
                capture_output=True,
                timeout=seconds,
                check=False,
            )
            if done.returncode in (1, 2):
                return "killed"
    except subprocess.TimeoutExpired:
        return "slow"
    finally:
        (copy / place).write_bytes(data)
    return "survived"


def main() -> None:
    """Draw, run, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--package", type=Path, default=HERE)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--name", default="mutants")
    given = parser.parse_args()
    root = given.package.resolve()
    records = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        if (shared := root.parent / "shared").is_dir():
            (Path(folder) / "shared").symlink_to(shared)
        shutil.copytree(root, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*cache"))
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(Path(folder) / "programs")
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
        os.environ["PYTHONPATH"] = str(copy)
        for mutant in drawn(root, given.number, given.seed):
            verdict = killed(mutant, root, copy, given.seconds)
            records.append({**asdict(mutant), "verdict": verdict})
            print(verdict, mutant.module, mutant.line, mutant.kind, mutant.before[:60], flush=True)
    count = sum(record["verdict"] == "killed" for record in records)
    write(f"{given.name}.json", {"killed": count, "of": len(records), "mutants": records})


if __name__ == "__main__":
    main()
