"""Pages load the rules that they can use, images in view, and the search's index on demand."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def _hook() -> Any:
    spec = importlib.util.spec_from_file_location("loading", DOCS / "loading.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


loading = _hook()


@pytest.mark.parametrize(
    ("css", "left"),
    [
        (".used{color:red}.never{color:red}", ".used{color:red}"),
        (".used,.never:hover{top:0}", ".used{top:0}"),
        (".used:not(.never){top:0}", ".used:not(.never){top:0}"),
        (".used:is(.never,.other) p,h1{top:0}", ".used:is(.never,.other) p,h1{top:0}"),
        ("@media print{.never{top:0}}p{top:0}", "p{top:0}"),
        ("@media print{.never{top:0}.used{top:0}}", "@media print{.used{top:0}}"),
        ("@keyframes x{0%{top:0}}", "@keyframes x{0%{top:0}}"),
        ('@charset "utf-8";.never{top:0}', '@charset "utf-8";'),
        (".used:after{content:'}.never{'}", ".used:after{content:'}.never{'}"),
        ("[dir=rtl] .used{top:0}[dir=ltr] .used{top:0}", "[dir=ltr] .used{top:0}"),
        ("[data-md-color-primary=red]{top:0}", ""),
    ],
)
def test_a_rule_stays_if_an_element_can_have_its_classes(css: str, left: str) -> None:
    assert "".join(loading.kept(css, frozenset({"used", "ltr"}))) == left


def test_an_image_has_its_size_and_waits_until_it_is_in_view() -> None:
    page = '<head></head><p><img alt="A" src="../images/trial.jpg"> <img src="https://x/y.png"></p>'
    written = loading.on_post_page(page, page=None, config=None)
    assert '<img loading="lazy" decoding="async" width="' in written
    assert '<img src="https://x/y.png">' in written


def test_the_index_of_the_search_waits_on_every_page() -> None:
    written = loading.on_post_page("<head></head>", page=None, config=None)
    assert "search_index" in written.partition("</head>")[0]
