"""README, the start page and the tutorials read easily: Flesch's formula, and short sentences."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    "README.md",
    "docs/index.md",
    *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs/tutorials").glob("*.md"))),
]
LEAST_EASE = 60
"""Flesch reading ease of plain English; a scientific paper has 30."""
MOST_WORDS = 30
"""Of a sentence."""


def prose(text: str) -> list[str]:
    """Return the sentences of a page: no code blocks, tables, headings, pictures or addresses."""
    text = re.sub(r"(?ms)^```.*?^```$", "\n\n", text)
    text = re.sub(r"(?m)^(\||#|!\[|<).*$", "\n", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`", "code", text)  # A name is one word, whatever it is spelt like.
    text = re.sub(r"(?m)^\s*(?:[*-]|\d+\.) ", "\n\n", text)
    found: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text.replace("*", "")):
        plain = " ".join(paragraph.split())
        found += [each for each in re.split(r"(?<=[.!?:])\s+(?=\S)", plain) if words(each)]
    return found


def words(sentence: str) -> list[str]:
    """Return the words of a sentence, numbers left out."""
    return re.findall(r"[A-Za-z]+(?:['-][A-Za-z]+)*", sentence)


def syllables(word: str) -> int:
    """Return about how many syllables a word has: its groups of vowels, a mute e left out."""
    lower = re.sub(r"(?<=[^aeiouyl])e$|(?<=[^aeiouydt])ed$|(?<=[^aeiouysxz])es$", "", word.lower())
    return max(1, len(re.findall(r"[aeiouy]+", lower)))


def reading_ease(sentences: list[str]) -> float:
    """Return the Flesch reading ease: 206.835 - 1.015 words a sentence - 84.6 syllables a word."""
    found = [word for sentence in sentences for word in words(sentence)]
    heavy = sum(map(syllables, found)) / len(found)
    return 206.835 - 1.015 * len(found) / len(sentences) - 84.6 * heavy


@pytest.mark.parametrize("page", PAGES)
def test_a_page_for_new_users_reads_easily(page: str) -> None:
    assert reading_ease(prose((ROOT / page).read_text("utf-8"))) >= LEAST_EASE


@pytest.mark.parametrize("page", PAGES)
def test_no_sentence_of_a_page_for_new_users_is_long(page: str) -> None:
    sentences = prose((ROOT / page).read_text("utf-8"))
    assert not [each for each in sentences if len(words(each)) > MOST_WORDS]


def test_the_formula_agrees_with_texts_whose_ease_is_known() -> None:
    # Counted by hand: 6 words of 6 syllables; 4 words of 13 syllables.
    assert reading_ease(["The cat sat on the mat."]) == pytest.approx(116.145)
    assert reading_ease(["Considerable computational requirements dominate."]) < 0
    assert [syllables(word) for word in ("robot", "trained", "table", "since")] == [2, 1, 2, 1]


def test_code_tables_and_addresses_are_no_prose() -> None:
    page = "# Head\n\nIt [runs](a.md#long). Run `a b c`:\n\n```bash\nrun all\n```\n\n| a | b |\n"
    assert prose(page) == ["It runs.", "Run code:"]
