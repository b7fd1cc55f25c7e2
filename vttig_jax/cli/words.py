"""Explanations of the words and parameters of a report.

`-v` prints those of a report below it, `vttig explain NAME` those of a name, and the glossary of
`docs/` has all of them.
"""

import re
from collections.abc import Mapping

WORDS: Mapping[str, tuple[str, str]] = {
    r"\bAR\(\d+\)": (
        "AR(n)",
        "autoregression: the noise of a row depends on that of the n rows before it",
    ),
    r"\bflank A\b|\bflanks +A|\bflank B\b|\bflanks +B": (
        "flank A, flank B",
        "the flank that carries while the driving angle grows, and the one while it falls",
    ),
    r"(driving|driven)_eccentricity_mm": (
        "driving_eccentricity_mm, driven_eccentricity_mm",
        "distance of the base-circle centre of a gear from its axis",
    ),
    r"(driving|driven)_amplitude_arcsec": (
        "driving_amplitude_arcsec, driven_amplitude_arcsec",
        "order 1 of a shaft, the mean of both flanks as vectors, or that of the only flank",
    ),
    r"(driving|driven)_phase_deg": (
        "driving_phase_deg, driven_phase_deg",
        "direction of an eccentricity at angle 0; of a drive p in a sin(φ + p), order 1",
    ),
    r"(driving|driven)_encoder_arcsec": (
        "driving_encoder_arcsec, driven_encoder_arcsec",
        "error of an encoder once per turn of its own shaft, alike on both flanks",
    ),
    r"(driving|driven)_encoder_phase_deg": (
        "driving_encoder_phase_deg, driven_encoder_phase_deg",
        "p in the error a sin(φ + p) of an encoder",
    ),
    r"\bapparent\b|constant_backlash_deg|constant backlash": (
        "constant_backlash_deg",
        "constant backlash: backlash without what varies with the angle; wind-up is in it",
    ),
    r"gap_over_angles_covered": (
        "gap_over_angles_covered",
        "flank B less flank A, the mean over the driving angles that both covered, degrees",
    ),
    r"backlash_plus_delay_deg": (
        "backlash_plus_delay_deg",
        "gap + i (mean |ω₁| on A + on B) · delay, which one speed tells",
    ),
    r"delay_s\b": ("delay_s", "time by which the driven channel is late, the mean of the log"),
    r"torque_arcsec_per_unit": (
        "torque_arcsec_per_unit",
        "wind-up: transmission error per unit of the torque column",
    ),
    r"^ratio( +\d|$| at)": (
        "ratio",
        "turns of the driven shaft per turn of the driving shaft, as the log shows it",
    ),
    r"\bresidual\b": ("residual", "transmission error less that of the fitted model"),
    r"correlation time": (
        "correlation time",
        "time over which noise averages out: half of the integral of its correlation",
    ),
    r"\bis slow\b|slow.share": (
        "slow share",
        "share of the variance of the noise that the rows before tell; 0 for white noise",
    ),
    r"averaged rows|\brows? (of )?\d": (
        "row",
        "mean of neighbouring samples, one equation of the fit",
    ),
    r"peak to peak": (
        "peak to peak",
        "range of the fitted error of a flank over the angles covered",
    ),
    r"\bstd\b": ("std", "standard error: the scatter to expect if the log were recorded again"),
    r"95 % interval": (
        "95 % interval",
        "holds the truth in 95 of 100 logs; noise, delay, drift and their widths are in it",
    ),
    r"not significant": ("not significant", "below three standard errors: may be zero"),
    r"upper limit": ("upper limit", "95 % bound of an amplitude below three standard errors"),
    r"likelihood ratio|likelihood_ratio": (
        "likelihood ratio",
        "how much better a component explains the log; above 12 it is needed",
    ),
    r"conditional on": (
        "conditional on",
        "what is taken as known, so that no interval contains it",
    ),
    r"undetermined": ("undetermined", "the log does not tell it, for the reason beside it"),
    r"\borders\b|\border \d|^order\b": (
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
    used = [pair for pattern, pair in WORDS.items() if re.search(pattern, report, re.MULTILINE)]
    lines = [f"  {word}: {meaning}" for word, meaning in used]
    return "\n".join(["words:", *lines]) if lines else ""


def meanings(name: str) -> dict[str, str]:
    """Return the words of `WORDS` that `name` is or is part of, with their explanations.

    **Example**
    ```python
    >>> from vttig_jax.cli.words import meanings
    >>> meanings("delay_s")
    {'delay_s': 'time by which the driven channel is late, the mean of the log'}

    ```
    """
    return {
        word: meaning
        for pattern, (word, meaning) in WORDS.items()
        if name.lower() in word.lower() or re.search(pattern, name)
    }
