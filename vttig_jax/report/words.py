"""Explanations of the words and parameters of a report.

`-v` prints those of a report below it, `vttig explain NAME` those of a name, and the glossary of
`docs/` has all of them. They stand in `words.toml`.
"""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

_FILE = Path(__file__).with_suffix(".toml")
WORDS: Mapping[str, tuple[str, str]] = {
    pattern: (word, meaning)
    for word, (pattern, meaning) in tomllib.loads(_FILE.read_text("utf-8")).items()
}
"""Regular expression that finds a word in a report → the word, and its explanation."""


def explained(report: str) -> str:
    """Return a text with one line for each word of `WORDS` that a report uses, or "".

    **Example**
    ```python
    >>> from vttig_jax.report.words import explained
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
    >>> from vttig_jax.report.words import meanings
    >>> meanings("delay_s")
    {'delay_s': 'time by which the driven channel is late, the mean of the log'}

    ```
    """
    return {
        word: meaning
        for pattern, (word, meaning) in WORDS.items()
        if name.lower() in word.lower()
        or word == name.removesuffix("s")
        or re.search(pattern, name)
    }
