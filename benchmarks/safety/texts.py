"""Hostile texts: what a name, a cell, a key or an option may hold that is no plain word."""

import random

PIECES: tuple[str, ...] = (
    "\x00", "\x07", "\x08\x08\x08", "\x1b[2J", "\x1b]0;title\x07", "\x1b[31m", "\x7f", "\x85",
    "\x9b31m", "\x9d0;t\x9c", "\r", "\n", "\r\n", "\t", "\x0b", "\x0c", "\u00ad", "\u061c",
    "\u200b", "\u200e", "\u200f", "\u2028", "\u2029", "\u202a", "\u202e", "\u2066", "\u2069",
    "\ufeff", "\ufffe", "\U000e0041", "\udcff", "\ud800", "=1+1", "=cmd|' /C calc'!A0", "+1-1",
    "-1+1", "@SUM(A1)", "\t=1", "'", '"', '"""', "'''", "`", "```", "\\", "\\x1b", "\\u202e", "\\n",
    "*/", "/*", "//", "#", "%", "%s%n", "{0}", "{}", "${HOME}", "$(touch x)", "`id`", ";", "|",
    "&&", "<script>alert(1)</script>", "]]>", "<!--", "&amp;", "</title>", "--help", "--", "-",
    "..", "../x", "/", "C:\\", "CON", "nan", "inf", "-inf", "1e999", "1e-320", "0x10", "1_000",
    "9" * 400, "1/0", "0/0", "1:0", "True", "null", "None", "[fit]", "a = 1", "a.b", "[[x]]", "{x}",
    "$\\frac{a}{b}$", "$x^{", "$$", "_", "^", "\\alpha", "?", "*", "[a-z]", "~", "~root", "\u00e4",
    "A\u0308", "\u202fx", "\u6e2c\u5b9a", "\U0001f9b7", "\u0645\u0631\u062d", "\u05d0",
    "\u0301" * 50,
    "error: forged", "\nerror: forged line", "warning: x", "Traceback (most recent call last):",
    "v 9 9 9\nf 1 2 3", "end_header", "0\nSECTION\n2\nENTITIES", "');DATA;", "\\X2\\00E4\\X0\\",
    "n" * 300, "n" * 5000, " ", "  ", "", ",", ";;;", "a,b", "\u00b0", "time_s", "driving_deg",
    "#1", "#row", "int", "for", "0name", "a b", "utf-16", "idna", "undefined", "<stdin>", "tcp://[::1",
    "http://x:y", "tcp://127.0.0.1:1", "inproc://x", ".csv", ".toml", "x.h",
)  # fmt: skip
"""Pieces of hostile texts: controls, directions, quotes, formulas, mark-up, numbers, paths."""


def texts(count: int, seed: int) -> list[str]:
    """Return texts: every piece alone first, then random joins of two to four pieces."""
    draw = random.Random(seed)
    found: list[str] = list(dict.fromkeys(PIECES))[:count]
    while len(found) < count:
        pieces = [draw.choice(PIECES) for _ in range(draw.randint(2, 4))]
        if draw.random() < 0.5:
            pieces.insert(draw.randrange(len(pieces) + 1), "rig")
        found.append("".join(pieces))
    return found


def file_name(text: str) -> str | None:
    """Return the text as a name that a file of this system can have, or None."""
    name = text.replace("/", "\u2215").replace("\x00", "")
    try:
        size = len(name.encode("utf-8", "surrogateescape"))
    except UnicodeEncodeError:  # a surrogate that no byte stands for
        return None
    return name if 0 < size < 200 and name.strip(".") else None


def argument(text: str) -> str:
    """Return the text as an argument of a process, which holds no null character."""
    name = text.replace("\x00", "")
    return name.encode("utf-8", "surrogatepass").decode("utf-8", "surrogateescape")


def toml_text(text: str) -> str:
    """Return the text as TOML can hold it, without lone surrogates."""
    return text.encode("utf-8", "replace").decode("utf-8")
