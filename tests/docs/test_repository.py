"""The repository's address is in one place; without it no page has a link to a repository."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def _hook() -> Any:
    spec = importlib.util.spec_from_file_location("repository", DOCS / "repository.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


repository = _hook()


@pytest.fixture
def config() -> SimpleNamespace:
    return SimpleNamespace(repo_url=None, repo_name=None, edit_uri=None)


def page(path: str, edit_url: str | None) -> SimpleNamespace:
    return SimpleNamespace(file=SimpleNamespace(src_uri=path), edit_url=edit_url)


def test_without_an_address_nothing_is_linked_and_the_placeholder_stays(
    config: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NW_EVAL_REPOSITORY", raising=False)
    assert vars(repository.on_config(config)) == dict.fromkeys(vars(config))
    text = (DOCS / "index.md").read_text("utf-8")
    found = repository.on_page_markdown(text, page=page("index.md", None), config=config, files=())
    assert found == text


@pytest.mark.parametrize(
    ("address", "edit"),
    [
        ("https://github.com/acme/nw-eval", "edit/main/docs/"),
        ("https://gitlab.acme.dev/dogs/tools/nw-eval.git", "-/edit/main/docs/"),
    ],
)
def test_one_address_fills_links_and_commands(
    address: str, edit: str, config: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NW_EVAL_REPOSITORY", address)
    repository.on_config(config)
    assert config.repo_url == address.removesuffix(".git")
    assert config.edit_uri == edit
    for name in ("index.md", "tutorials/checkpoint-to-check.md", "how-to/github.md"):
        text = (DOCS / name).read_text("utf-8")
        assert "OWNER/nw-eval" in text
        filled = repository.on_page_markdown(
            text, page=page(name, "https://x/y"), config=config, files=()
        )
        assert "OWNER/nw-eval" not in filled
        assert "`OWNER`" not in filled
        assert config.repo_name in filled


@pytest.mark.parametrize("address", ["acme/nw-eval", "http://x/y/z", "https://github.com", "x y"])
def test_what_is_no_address_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NW_EVAL_REPOSITORY", address)
    with pytest.raises(ValueError, match="is not the address of a repository"):
        repository.address()


def test_edit_this_page_leads_to_the_text_of_a_page(
    config: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NW_EVAL_REPOSITORY", "https://github.com/acme/nw-eval")
    edit = "https://github.com/acme/nw-eval/edit/main/docs/"
    changes = page("changelog.md", f"{edit}changelog.md")
    generated = page("reference/python/runs.md", f"{edit}reference/python/runs.md")
    for each in (changes, generated):
        repository.on_page_markdown("", page=each, config=config, files=())
    assert changes.edit_url == "https://github.com/acme/nw-eval/edit/main/CHANGELOG.md"
    assert generated.edit_url is None


def test_the_version_is_in_the_header_and_nothing_asks_for_stars() -> None:
    from nw_base import __version__

    header = (
        '<div class="md-header__topic">\n<span class="md-ellipsis">\nnw-eval\n</span></div>'
        '<a href="https://x/y" class="md-source" data-md-component="source">'
    )
    shown = repository.on_post_page(header, page=page("how-to/ci.md", None), config=None)
    assert f'nw-eval <a class="version" href="../changelog.html">{__version__}</a>' in shown
    assert "data-md-component" not in shown


def test_no_page_and_no_setting_has_another_address_of_this_project() -> None:
    files = [ROOT / "mkdocs.yml", ROOT / "README.md", *DOCS.rglob("*.md")]
    for file in files:
        found = re.findall(r"https://github\.com/([\w.-]+)/nw-eval", file.read_text("utf-8"))
        assert set(found) <= {"OWNER"}, file
    workflow = (ROOT / ".github" / "workflows" / "docs.yml").read_text("utf-8")
    assert "NW_EVAL_REPOSITORY: ${{ github.server_url }}/${{ github.repository }}" in workflow
