"""Verbs that are made of functions: which options they have, and what they hand on."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import get_type_hints

import pytest

from nw_base.words import Backend
from nw_eval import api
from nw_eval.cli.verbs import forms
from nw_eval.cli.verbs.help import options_of
from nw_eval.cli.verbs.verb import Verb, verb_of
from nw_eval.engine.how import How
from nw_gate.results.request import Request

MADE = {name: form for name, form in forms() if issubclass(form, Verb)}
HEARD_ELSEWHERE = {"policies fetch", "robots fetch"}
"""Downloads are shown by the process, whichever verb starts one."""


@dataclass
class Answer:
    given: dict = field(default_factory=dict)
    exit_code: int = 0
    interrupted: bool = False


def measure(
    place: str | Path,
    *,
    policy: str | None = None,
    render: Backend = "cpu",
    out: Path | None = None,
    limit: int | str = 3,
    aside: Unknown = None,  # noqa: F821 - only a type checker knows it.
    workers: int | None = None,
    cache: bool = True,
    listener: Unknown = None,  # noqa: F821
    progress: Unknown = None,  # noqa: F821
    **changes: object,
) -> Answer:
    """Measure a place.

    Args:
        place: a folder, or
            a name.
        policy: who measures (default: no one).
        render: the renderer.
        out: what to write (default: nothing).
        limit: how many.
        workers: of Python alone.

    Raises:
        OSError: a disk is full.
    """
    if progress is not None:
        progress("half", 2)
    own = {"place": place, "policy": policy, "render": render, "out": out, "limit": limit}
    how = {"workers": workers, "cache": cache, "listens": listener is not None, "aside": aside}
    return Answer({**own, **how, **changes})


@pytest.fixture(autouse=True)
def _measured(monkeypatch):
    monkeypatch.setattr(api, "measure", measure, raising=False)


def kinds(form):
    hints = get_type_hints(form)
    return {each.name: hints[each.name] for each in fields(form)}


def told(form):
    return {option.name: (option.flags, option.help) for option in options_of(form)}


def test_names_types_defaults_and_sentences_are_those_of_the_function():
    @verb_of("measure", without=("aside",))
    class Measure(Verb):
        """Measure."""

    assert kinds(Measure) == {
        "place": str,
        "policy": str | None,
        "render": Backend,
        "out": Path | None,
        "limit": str,
    }
    assert {each.name: each.default for each in fields(Measure)} == {
        "place": MISSING,
        "policy": None,
        "render": "cpu",
        "out": None,
        "limit": 3,
    }
    assert told(Measure) == {
        "place": ((), "A folder, or a name."),
        "policy": (("-p", "--policy"), "Who measures (default: no one)."),
        "render": (("--render",), "The renderer (default: cpu)."),
        "out": (("--out",), "What to write (default: nothing)."),
        "limit": (("--limit",), "How many (default: 3)."),
    }


def test_a_class_says_what_is_otherwise_on_the_command_line():
    @verb_of("measure", without=("aside",), flags=("place",), named={"limit": "most"})
    class Measure(Verb):
        """Measure."""

        place: Path
        out = Path("x.png")
        policy: str = "me"
        """Who."""
        twice: bool = False
        """Two times."""

        def more(self):
            return {"aside": "twice" if self.twice else "once"}

    assert kinds(Measure) == {
        "place": Path,
        "policy": str,
        "render": Backend,
        "out": Path,  # Where there is a default, there is no None.
        "most": str,
        "twice": bool,
    }
    assert told(Measure) == {
        "place": (("--place",), "A folder, or a name."),
        "policy": (("-p", "--policy"), "Who (default: me)."),
        "render": (("--render",), "The renderer (default: cpu)."),
        "out": (("--out",), "What to write (default: x.png)."),
        "most": (("--most",), "How many (default: 3)."),
        "twice": (("--twice",), "Two times."),
    }
    given = Measure(place=Path("a"), most="5", twice=True).call().given
    assert given.items() >= {"place": Path("a"), "out": Path("x.png"), "limit": "5"}.items()
    assert given["aside"] == "twice"
    assert "twice" not in given


def test_what_is_the_same_in_all_verbs_has_one_help_and_is_handed_on_under_its_name_in_python():
    @verb_of("measure", without=("aside",), changes=("workers", "no_cache", "checkpoint", "seed"))
    class Measure(Verb):
        """Measure."""

        checkpoint: Path | None

    found = told(Measure)
    assert list(found)[-4:] == ["workers", "no_cache", "checkpoint", "seed"]
    every = told(MADE["baseline save"])
    for name in ("workers", "no_cache", "checkpoint"):
        assert found[name] == every[name]
    assert found["workers"][0] == ("-j", "--workers")
    assert found["seed"][1].startswith("Use a different seed")
    given = Measure(place="a", workers=2, no_cache=True, seed=9).call().given
    assert given.items() >= {"workers": 2, "cache": False, "seed": 9, "checkpoint": None}.items()
    assert "no_cache" not in given
    assert Measure(place="a").call().given["cache"] is True


def test_a_parameter_without_a_sentence_is_refused_by_name():
    with pytest.raises(LookupError, match=r"api\.measure: .* 'aside' .* `without`"):

        @verb_of("measure")
        class Measure(Verb):
            """Measure."""


def test_a_listener_says_in_a_line_what_the_function_tells(capsys):
    @verb_of(
        "measure",
        without=("aside",),
        listens=True,
        heard=lambda word, count: f"{word} of {count}",
    )
    class Measure(Verb):
        """Measure."""

    assert Measure(place="a").call().given["listens"]
    assert "half of 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("answer", "code", "printed", "said"),
    [
        (Answer(), 0, "0\n", ""),
        (Answer(exit_code=5), 5, "5\n", ""),
        (Answer(exit_code=5, interrupted=True), 130, "5\n", "it goes on\n"),
        (Answer(exit_code=130), 130, "130\n", "it goes on\n"),
        ("has no code", 0, "", ""),
    ],
)
def test_an_answer_is_shown_and_says_how_the_command_ends(
    answer, code, printed, said, capsys, monkeypatch
):
    @verb_of("measure", without=("aside",))
    class Measure(Verb):
        """Measure."""

        goes_on = "it goes on"

        def show(self, found):
            return str(getattr(found, "exit_code", ""))

    monkeypatch.setattr(api, "measure", lambda **_: answer)
    assert Measure(place="a")() == code
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == (printed, said)


@pytest.mark.parametrize("name", MADE)
def test_the_function_of_a_verb_takes_each_of_its_options(name):
    function, options, listens, heard = MADE[name].made
    taken = inspect.signature(inspect.unwrap(getattr(api, function))).parameters
    loose = any(each.kind is each.VAR_KEYWORD for each in taken.values())
    known = {*taken, *(each.name for of in (Request, How) for each in fields(of) if loose)}
    assert {"cache" if each == "no_cache" else each for each in options} <= known
    needed = {
        each.name
        for each in taken.values()
        if each.default is each.empty and each.kind is not each.VAR_KEYWORD
    }
    assert needed <= options.keys()
    assert listens <= ("listener" in taken or loose)
    assert listens or "listener" not in taken or name in HEARD_ELSEWHERE
    assert (heard is not None) == ("progress" in taken)
    assert {option.name for option in options_of(MADE[name])} >= {*options.values()}
