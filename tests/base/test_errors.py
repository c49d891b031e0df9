"""Errors say what strangers' files say without obeying it, in every process."""

from copy import deepcopy

import pytest

from nw_base.errors import Problem, SceneError, SuiteError, TrialError

EVIL = "x\n::error::owned\x1b[2J\u202e ws://user:secret@host/ ##vso[task]"


def harmless(text):
    return (
        "\n" not in text
        and "\x1b" not in text
        and "\u202e" not in text
        and "secret" not in text
        and "##vso[" not in text
        and not text.startswith("::")
    )


def test_a_strangers_words_in_a_message_are_one_harmless_line():
    error = SceneError(f"scene {EVIL!s}", fix=f"rename {EVIL!s}")
    assert harmless(str(error))
    assert "ws://host/" in str(error)


def test_every_problem_of_a_file_has_a_line_of_its_own_and_no_more():
    problems = [Problem(file=f"a{EVIL}", line=n, column=1, message=EVIL) for n in (1, 2)]
    lines = str(SuiteError(problems)).split("\n")
    assert len(lines) == 2
    assert all(harmless(line) for line in lines)


def test_a_message_of_five_thousand_characters_is_cut_and_keeps_its_fix():
    text = str(TrialError("y" * 5000, fix="look at the server"))
    assert len(text) < 2200
    assert text.endswith("; look at the server")


@pytest.mark.parametrize(
    "error",
    [
        SceneError("no floor", fix="add one"),
        SuiteError([Problem(file="a", line=n, column=1, message="m", fix="f") for n in (1, 2)]),
    ],
)
def test_an_error_says_the_same_in_another_process(error):
    there = deepcopy(error)  # As pickle does on the way, by `__reduce_ex__`.
    assert (str(there), there.fix, there.problems) == (str(error), error.fix, error.problems)
