"""Each word of the vocabulary says what it means; retired words are in no page and no code."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from nw_base import words
from nw_eval.cli.verbs import forms, program_page
from nw_eval.cli.verbs.help import verb_page

ROOT = Path(__file__).parents[1]
SURFACES = {
    "code": ("harness/**/*.py", "harness/**/*.j2"),
    "pages": ("README.md", "CHANGELOG.md", "docs/**/*.md"),
}

INSTEAD = {
    "nobody": "a sentence with its own subject",
    "likewise": "the same, too, or as above",
    "beyond doubt": "statistically significant",
    "what came of it": "the result",
    "nothing wrong": "no errors",
    "stranger": "third party, user, or untrusted",
    "convict": "flag as a regression",
    "condemn": "regressed",
    "charged to": "attributed to",
    "gambler": "bet, or test martingale",
    "foresee": "forecast",
    "two-by-two": "ablation",
    "onlooker": "shadow policy",
    "puppet": "replay policy",
    "handover": "policy switch",
    "take-over": "policy switch",
    "nursery": "fork server",
    "parcel": "file bundle",
    "panel of starts": "seed set",
    "a trail": "a course; the key of a scene file is `trail`",
    "the trail": "the course; the key of a scene file is `trail`",
    "a bank": "a baseline",
    "the bank": "the baseline",
    "a place": "a scene, position or index",
    "the place": "the scene, position or index",
    # Sentences of the verdict, the report and the pages.
    "by itself; those that speak most": "Largest drops: SCENE 1.00 -> 0.00",
    "is not excluded, more than": "is undecided: estimated drop 0.05",
    "the data fit": "is undecided: estimated drop 0.05",
    "trials need not run": "the rest were skipped",
    "came to the same bits": "matched",
    "is held back by": "PASS is withheld",
    "an even chance that": "decides with 50 % probability",
    "names it as fallen": "reported as regressed",
    "None of them is worth a verdict": "Reporting never changes the verdict",
    "is a result too": "A policy that crashes twice in the same way fails the trial",
    "whoever claims something bears it": "Scored worst-case",
    "rest while a number is typed": "they are off while you type",
}
"""Retired words and sentences, and what is said instead of each, in the singular."""


@cache
def texts(surface: str) -> tuple[tuple[str, str], ...]:
    """Return names and texts: all of the package, or what people read about it."""
    files = [file for kind in SURFACES[surface] for file in sorted(ROOT.glob(kind))]
    found = {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in files}
    if log := found.get("CHANGELOG.md"):
        newest = re.search(r"(?ms)^## .*?(?=^## |\Z)", log)
        found["CHANGELOG.md"] = "" if newest is None else newest[0]
    return tuple(found.items())


def uses(word: str, text: str) -> list[int]:
    """Return the lines that use a word: in a sentence, wrapped or not, or in an identifier."""
    lower, lines = text.lower(), []
    if max(word.lower().split(), key=len) not in lower:
        return []
    pattern = r"\s+(?:# )?".join(map(re.escape, word.lower().split())) + "(?:'?s|ed)?"
    for found in re.finditer(pattern, lower):
        start, end = found.span()
        before = text[max(0, start - 1) : start]
        is_part = before.isalpha() and not (before.islower() and text[start].isupper())
        if not is_part and not text[end : end + 1].islower():
            lines.append(text.count("\n", 0, start) + 1)
    return lines


@pytest.mark.parametrize("surface", ["code", "pages"])
def test_no_retired_word_is_used(surface: str) -> None:
    faults = []
    for word, instead in INSTEAD.items():
        places = [f"{n}:{line}" for n, text in texts(surface) for line in uses(word, text)]
        if places:
            faults.append(f"{word!r}: say {instead} ({len(places)}: {', '.join(places[-5:])})")
    assert not faults, "\n".join(faults)


PHRASES = {
    r"when absent|if None\b": "(default: X)",
    r"[Mm]ay be given (again|more than once)|\(repeatable\)": "Repeatable.",
    r"[,;] at most[.)]": "At most N.",
    r"(?<!output )\b[Ss]ays? (what|whether|how|where|which|that|if)\b": "show, print or check",
    r"\bbundle'?s?\b": "a policy folder",
    r"\bbanks?\b|(?<!in )\bplaces?\b(?! (the|it|them)\b)|\bpanels?\b": "baseline, scene, seed set",
    r"\b(goes|go|went) on\b|\b[Gg]o on with\b": "resume",
    r"\b(take|takes|taken|took) (it |them )?over (from|but|their|the results)": "reuse",
    r"\bthe same bits|\bother bits|bit for bit": "identical results",
    r"\b[Ww]hoever\b|\bof which\b|\bthat which\b|\bWhose\b": "a clause by its noun",
    r"\bheed(s|ed)?\b|\bparted\b|\bbreaks off\b|\bof use\b": "ignore, split, fail, invalid",
    r"class(es)? of machines?\b": "machine type",
    r"\bat most about\b": "about",
    r"\bthe very (same|one)\b|\bin this very\b": "the same",
    r"\bpreviously\b|\bof before\b": "old",
}
"""Phrases that no help page has, by a regular expression, and what is said instead."""
IN_PAGES = (0, 1, 6, 8, 11, 12)
"""Those that README, Get started, the tutorials and the how-to pages do not have, either."""


def help_pages() -> dict[str, str]:
    """Return the help page of the program and of each verb."""
    pages = {name: verb_page(name, form, []) for name, form in forms()}
    pages["nw-eval"] = program_page("")
    return pages


def said(phrase: str, text: str) -> list[str]:
    """Return where a phrase is in a text, with some words about it."""
    plain = " ".join(text.split())
    return [plain[max(0, m.start() - 30) : m.end() + 20] for m in re.finditer(phrase, plain)]


@pytest.mark.parametrize("phrase", PHRASES)
def test_help_is_in_the_words_of_the_field(phrase: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "10000")
    pages = {name: text for name, text in help_pages().items() if name != "twin place"}
    faults = [f"{name}: {each}" for name, text in pages.items() for each in said(phrase, text)]
    # `twin place` is a command, and its examples name folders.
    faults = [each for each in faults if not re.search(r"twin place|my-place", each)]
    assert not faults, f"say {PHRASES[phrase]}: {faults}"


@pytest.mark.parametrize("phrase", [list(PHRASES)[number] for number in IN_PAGES])
def test_pages_for_users_are_in_the_words_of_the_field(phrase: str) -> None:
    kinds = ("README.md", "docs/index.md", "docs/tutorials/*.md", "docs/how-to/*.md")
    faults = []
    for file in (file for kind in kinds for file in sorted(ROOT.glob(kind))):
        prose = re.sub(r"(?ms)^```.*?^```$|`[^`]*`", "", file.read_text("utf-8"))
        faults += [f"{file.relative_to(ROOT)}: {each}" for each in said(phrase, prose)]
    assert not faults, f"say {PHRASES[phrase]}: {faults}"


def test_a_phrase_is_found_across_lines() -> None:
    assert said(next(iter(PHRASES)), "its own when\n    absent.") == ["its own when absent."]
    assert not said(next(iter(PHRASES)), "absent-minded when tired")


def test_a_retired_word_is_found_in_sentences_and_identifiers() -> None:
    assert uses("nursery", "the Nursery\nclass BigNursery: nursery_pid = 1") == [1, 2, 2]
    assert uses("beyond doubt", "it fell beyond\n    # doubt") == [1]
    assert not uses("bank", "banker, embank")


def test_every_word_has_a_sentence_that_says_what_it_means() -> None:
    body = ast.parse(Path(words.__file__).read_text("utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and "Literal" in ast.unparse(node):
            assert isinstance(after, ast.Expr), ast.unparse(node)
