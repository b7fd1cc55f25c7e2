"""Draws the imports between the rooms of the package into `docs/architecture.md`.

    python docs/draw_rooms.py

The diagram is Mermaid text. An arrow from `a` to `b` says that modules of `a` import modules of
`b`. An arrow is left out where a longer road of arrows leads to the same room. A test compares the
document with the imports.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "architecture.md"
START, END = "```mermaid\n", "```\n"


def edges() -> dict[str, set[str]]:
    """Room → other rooms that its modules import."""
    package = ROOT / "vttig_jax"
    rooms = sorted(path.name for path in package.iterdir() if (path / "__init__.py").exists())
    found: dict[str, set[str]] = {room: set() for room in rooms}
    for room in rooms:
        for path in (package / room).rglob("*.py"):
            depth = len(path.relative_to(package).parts)
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.level == depth and node.module:
                    found[room] |= {node.module.partition(".")[0]} & set(rooms)
    return found


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without arrows that a longer road replaces."""

    def reached(start: str) -> set[str]:
        return graph[start].union(*(reached(one) for one in graph[start]))

    return {
        room: {one for one in ahead if not any(one in reached(other) for other in ahead - {one})}
        for room, ahead in graph.items()
    }


def diagram() -> str:
    """Mermaid text of the reduced graph."""
    graph = reduced(edges())
    lines = [f"    {room} --> {one}\n" for room in sorted(graph) for one in sorted(graph[room])]
    return "".join(["graph TD\n", *lines])


def drawn(text: str) -> str:
    """The document with the diagram of today."""
    head, _, rest = text.partition(START)
    _, _, tail = rest.partition(END)
    return f"{head}{START}{diagram()}{END}{tail}"


if __name__ == "__main__":
    DOCUMENT.write_text(drawn(DOCUMENT.read_text("utf-8")), "utf-8")
