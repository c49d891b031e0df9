"""Every link and anchor of the pages leads somewhere, and the navigation leads to every page."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
SITE = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
    ROOT / "CODE_OF_CONDUCT.md",
    *SITE,
    *sorted((ROOT / "policies").glob("*/README.md")),
    *sorted((ROOT / "robots").rglob("README.md")),
]
LONGEST = 200
"""Lines of a page of the site: what one reads in one sitting, and finds again."""
_CODE = re.compile(r"^ *```[\s\S]*?^ *```$|^    .*$|`[^`\n]*`", re.MULTILINE)
_FENCES = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def prose(page: Path) -> str:
    """A page without its code, which is full of brackets."""
    return _CODE.sub("", page.read_text(encoding="utf-8"))


@cache
def filled() -> Callable[[str], str]:
    """What fills the generated parts of a page, which have headings, too."""
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.filled


@cache
def headings(page: Path) -> list[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    text = page.read_text(encoding="utf-8")
    text = _FENCES.sub("", filled()(text) if page.parent.name == "reference" else text)
    found = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return [re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in found]


def navigation() -> list[str]:
    """The pages of the navigation in its order."""

    def pages(part: Any) -> list[str]:
        if isinstance(part, str):
            return [part]
        inner = part.values() if isinstance(part, dict) else part
        return [page for each in inner for page in pages(each)]

    return pages(YAML(typ="safe").load(ROOT / "mkdocs.yml")["nav"])


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.is_file(), f"{page.name} links to {target}"
        assert file.is_relative_to(ROOT), f"{page.name} links out of the project: {target}"
        assert not anchor or anchor in headings(file), f"{page.name} links to {target}"


def test_the_navigation_has_every_page_once() -> None:
    docs = ROOT / "docs"
    assert sorted(navigation()) == [page.relative_to(docs).as_posix() for page in SITE]


def test_every_path_of_the_docs_that_a_message_or_comment_names_is_there() -> None:
    folders = ("harness", "tests", "training", "suites", "robots", "policies", ".github")
    texts = {
        path: path.read_text(encoding="utf-8")
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.suffix in {".py", ".yaml", ".yml", ".md"}
    }
    for path, text in texts.items():
        for named in re.findall(r"(?<![\w/.])docs/[\w/-]+\.(?:md|png|jpg)", text):
            assert (ROOT / named).is_file(), f"{name(path)} names {named}"


@pytest.mark.parametrize("page", SITE, ids=name)
def test_a_page_can_be_read_by_every_engine(page: Path) -> None:
    """Python's Markdown, which makes the site, is stricter than GitHub's."""
    text = page.read_text(encoding="utf-8")
    lines = text.splitlines()
    assert len(lines) <= LONGEST, "split it"
    assert text.startswith("# "), "its first line is its title"
    assert len(re.findall(r"^# ", _FENCES.sub("", text), re.MULTILINE)) == 1
    assert len(set(headings(page))) == len(headings(page)), "two headings have one anchor"
    assert len(re.findall(r"^ *```", text, re.MULTILINE)) % 2 == 0
    assert "```mermaid" not in text, "what draws it would come from elsewhere: draw an SVG"
    fence, in_list, before = False, False, ""
    for number, line in enumerate(lines, 1):
        where = f"{name(page)}:{number}"
        if line.lstrip().startswith("```"):
            fence = not fence
        elif not fence:
            starts_list = bool(re.match(r"(\*|-|\d+\.) ", line))
            assert not (starts_list and before and not in_list), f"{where}: a list after text"
            if line and not line.startswith(" "):
                in_list = starts_list or (in_list and bool(before))
            assert not re.match(r" {1,3}(\*|-|\d+\.) ", line), f"{where}: indent by four"
            starts_table = line.startswith("|") and not before.startswith("|")
            assert not (starts_table and before), f"{where}: a table after text"
            indented = bool(re.match(r" {4}\S", line)) and not before
            assert not indented or in_list, f"{where}: fence the code"
        before = line
