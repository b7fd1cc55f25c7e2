"""The words of a report are explained under `-v`, those that occur and no others."""

import re

from vttig_jax.report.words import WORDS, explained


def test_words_that_occur_and_no_others():
    found = explained("noise  blocks of 5 ms (AR(2))\nhunting period  16 driving turns")
    assert found.splitlines()[0] == "words:" and len(found.splitlines()) == 4
    assert "autoregression" in found and "same teeth meet" in found
    assert explained("area, hunter, profiled, stdout") == ""


def test_every_word_is_a_sentence_of_its_own():
    for pattern in WORDS:
        word, meaning = WORDS[pattern]
        assert word and len(f"  {word}: {meaning}") <= 140 and not meaning.endswith(".")
        assert (
            re.search(pattern, f"{word.replace('(n)', '(2)')} at 1 τ: {word} 2") or word == "order"
        )


def test_a_fit_explains_its_words_under_v(vttig, rig_folder):
    command = ("fit", rig_folder / "log.csv", "--pair", rig_folder / "pair.toml")
    _, plain, _ = vttig(*command)
    code, out, _ = vttig(*command, "-v")
    assert code == 0 and out.startswith(plain.rstrip("\n")) and "\n\nwords:\n" in out
    legend = out.partition("\nwords:\n")[2]
    for word in ("flank A, flank B", "std", "order", "constant_backlash_deg", "slow share"):
        assert f"  {word}: " in legend
    assert "R-hat" not in legend and "words:" not in plain
    assert "words:" not in vttig(*command, "-v", "--json")[1]


def test_a_plan_with_the_noise_of_a_log_expects_the_errors_of_its_fit(
    vttig, vttig_json, rig_folder
):
    pair = ("--pair", rig_folder / "pair.toml")
    fitted = ("fit", rig_folder / "log.csv", *pair)
    (line,) = [x for x in vttig(*fitted, "-v")[1].splitlines() if x.startswith("to plan")]
    options = re.findall(r"--[a-z-]+ [\d.e+-]+", line.rstrip(","))
    motion = ("--turns", "8", "--speed-rpm", "120")
    words = [word.rstrip(",") for option in options for word in option.split()]
    _, planned = vttig_json("plan", *pair, *motion, *words)
    name = "driving_eccentricity_mm"
    std = vttig_json(*fitted)[1]["parameters"][name]["std"]
    assert 0.75 < planned["parameters"][name]["std"] / std < 1.33
