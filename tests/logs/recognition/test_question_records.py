"""Questions and guesses are records: each names a cure or a reason, and `inspect --json` has it."""

import json

import pytest

from tests.corpus.cases import cases
from tests.logs.rig_log import angles_deg, csv
from vttig_jax.cli.main import main
from vttig_jax.logs.read import open_log
from vttig_jax.logs.recognition.candidates import GUESSES, QUESTIONS, Question
from vttig_jax.logs.recognition.request import DriveRequest


@pytest.mark.parametrize("slug", QUESTIONS)
def test_every_question_has_a_sentence_with_a_cure(slug):
    cures = ("give ", "--", "{options}", "write ", "interpolate ", "leave it out")
    assert any(cure in QUESTIONS[slug] for cure in cures)
    assert QUESTIONS[slug].endswith(".")


def test_every_guess_says_what_was_taken_and_why():
    assert all(", " in words for words in GUESSES.values())


def test_the_corpus_asks_every_question():
    assert {*QUESTIONS} <= {case.expected.get("error", {}).get("slug") for case in cases()}


def test_questions_are_records_in_the_json(tmp_path, capsys):
    path = tmp_path / "log.csv"
    time, x, y = angles_deg(turns=1)
    whole = (one.round().astype(int) for one in (100 * x, 100 * y))
    path.write_text(csv("t_s,motor_counts,load_counts", time, *whole))
    assert main(["inspect", str(path), "--json"]) == 0
    (asked,) = json.loads(capsys.readouterr().out)["questions"]
    assert (asked["slug"], asked["role"]) == ("no-counts", "driving")
    assert asked["columns"] == ["motor_counts"] and "--counts" in asked["options"][0]
    assert main(["inspect", str(path), "--json", "--counts", "36000"]) == 0
    assert "questions" not in json.loads(capsys.readouterr().out)


def test_the_ratio_is_that_of_scaled_readings(tmp_path):
    path = tmp_path / "log.csv"
    time, x, y = angles_deg()
    path.write_text(csv("t,a [deg],b [deg]", time, x, y / 7))
    with pytest.raises(Question) as caught:
        open_log(path, DriveRequest(ratio="16:9"))
    assert caught.value.slug == "shafts-open"
    found = open_log(path, DriveRequest(ratio="16:9", driven_scale="7")).spec.log
    assert (found.driving, found.driven, found.driven_scale) == ("a [deg]", "b [deg]", "7")
