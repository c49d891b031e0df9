"""The gallery has every kind of picture with its command, and pictures of pages are small."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"
GALLERY = (DOCS / "gallery.md").read_text("utf-8")
START = (DOCS / "index.md").read_text("utf-8")
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", GALLERY, re.MULTILINE | re.DOTALL))
PAGES = {"A report": "example report", "A leaderboard": "example leaderboard"}
LARGEST = 4_000_000
"""Bytes of a picture in the repository."""


def test_it_has_all_that_nw_eval_shows() -> None:
    wanted = ("Scenes", "Films", "A sweep", "The viewer", "A digital twin")
    assert set(SECTIONS) == {*wanted, *PAGES}
    for title, part in PAGES.items():
        assert f"<!-- generated: {part} -->" in SECTIONS[title]


@pytest.mark.parametrize("title", sorted(SECTIONS.keys() - PAGES.keys()))
def test_each_picture_is_there_and_its_caption_has_the_command(title: str) -> None:
    shown = re.findall(r"^!\[(.+)\]\((.+)\)\n\n(.+)$", SECTIONS[title], re.MULTILINE)
    assert len(shown) == SECTIONS[title].count("![") > 0
    for words, file, caption in shown:
        assert len(words) > 10
        assert re.search(r"`nw-eval [^`]+`", caption), caption
        with Image.open(DOCS / file) as picture:
            assert picture.width >= 700


def test_no_picture_of_the_docs_is_large() -> None:
    sizes = {each.name: each.stat().st_size for each in (DOCS / "images").iterdir()}
    assert {name: size for name, size in sizes.items() if size > LARGEST} == {}


def test_the_start_page_begins_with_a_card_for_each_kind_of_reader() -> None:
    cards = re.findall(
        r"^\* \[!\[.+\]\((.+)\) \*\*I have (.+)\*\* .+\]\((.+)\)$", START, re.MULTILINE
    )
    assert [what for _, what, _ in cards] == ["a checkpoint", "a robot", "photographs", "a CI"]
    assert START.index("I have a CI") < START.index("\n## ")
    for picture, _, page in cards:
        assert (DOCS / page).is_file()
        assert (DOCS / picture).stat().st_size < 150_000
        with Image.open(DOCS / picture) as image:
            assert image.size == (400, 225)
