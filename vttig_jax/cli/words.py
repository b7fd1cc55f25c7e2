"""Explanations of technical words in a report; `-v` prints them below the report."""

import re
from collections.abc import Mapping

WORDS: Mapping[str, tuple[str, str]] = {
    r"\bAR\(\d+\)": (
        "AR(n)",
        "autoregression: the noise of a block depends on that of the n blocks before it",
    ),
    r"\bflank A\b|\bflanks +A|\bflank B\b|\bflanks +B": (
        "flank A, flank B",
        "the flank that carries while the driving angle grows, and the one while it falls",
    ),
    r"\bresidual\b": ("residual", "transmission error less that of the fitted model"),
    r"\bstd\b": ("std", "standard error: the scatter to expect if the log were recorded again"),
    r"95 % interval": ("95 % interval", "the range that holds the truth in 95 of 100 logs"),
    r"\borders\b|\border \d": (
        "order",
        "cycles per turn of the named shaft, so that driven 2 comes twice per turn of the driven"
        " shaft",
    ),
    r"\bmesh \d": ("mesh 1", "the order of the teeth: once for each pair of teeth"),
    r"\bclosure\b": (
        "closure",
        "difference between two passes over the same pairs of teeth, where gears repeat",
    ),
    r"\bjump +\d|\bjump at\b|\blargest jump\b": (
        "jump",
        "step of the driven shaft at a reversal, where it changes flanks",
    ),
    r"\bj_v\b": ("j_v", "the part of the backlash that the eccentricities make"),
    r"\blost motion\b": (
        "lost motion",
        "how far the driven shaft is, on the way back, from where the first flank would hold it",
    ),
    r"\binterference\b|\binterferes?\b": (
        "interference",
        "distance by which the controller closes further than the gap allows",
    ),
    r"error of the output|\boutput error\b": (
        "error of the output",
        "how far the driven shaft is from the ratio times the angle that the motion asks for",
    ),
    r"\bgap left\b|backlash at the turn": (
        "gap left",
        "backlash that is open when the motion turns; residual_gap_deg in tables",
    ),
    r"\bwrong flank\b": (
        "wrong flank",
        "travel before the turn with the flank in contact that carries after it",
    ),
    r"\baxial step\b": (
        "axial step",
        "turn of the driven shaft by the axial shift that closes the gap",
    ),
    r"closing begins|closes at": (
        "closing begins",
        "the first command to close the gap after the motor began to brake",
    ),
    r"\blane-steps?\b": ("lane-step", "one time step of one case"),
    r"hardest to tell apart": (
        "hardest to tell apart",
        "the combination of parameters that the log determines worst (the weakest direction)",
    ),
    r"hunting period": ("hunting period", "turns of the driving shaft until the same teeth meet"),
    r"\ball orders\b|\border-complete\b": (
        "all orders",
        "order-complete: with every fitted order, not with the first orders alone",
    ),
    r"\bapparent\b|constant_backlash_deg|constant backlash": (
        "constant backlash",
        "backlash without the part that varies with the angle; it holds wind-up and bearings too",
    ),
    r"delay_s\b": (
        "delay_s",
        "time by which the driven channel is late",
    ),
    r"\bdrift\b": ("drift", "slow change over time that no gear makes, such as warming"),
    r"effective draws": (
        "effective draws",
        "independent draws that would tell a mean as well as those of the chains do",
    ),
    r"\bR-hat\b": ("R-hat", "spread between independent chains over that within them; 1 is best"),
}
"""Regular expression that finds a word in a report → the word, and its explanation."""


def explained(report: str) -> str:
    """Return a text with one line for each word of `WORDS` that a report uses, or "".

    **Example**
    ```python
    >>> from vttig_jax.cli.words import explained
    >>> print(explained("hunting period  16 driving turns"))
    words:
      hunting period: turns of the driving shaft until the same teeth meet

    ```
    """
    used = [pair for pattern, pair in WORDS.items() if re.search(pattern, report)]
    lines = [f"  {word}: {meaning}" for word, meaning in used]
    return "\n".join(["words:", *lines]) if lines else ""
