"""What a page of the site loads: CSS that it can use, images in view, and the search's index late.

A hook of mkdocs.yml. Style sheets become one, cut to the rules whose classes occur in a page or in
a script. Images are loaded when they come into view, and have their size, so that nothing moves.
The search's index, the largest file of the site, is loaded when a reader opens the search.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent

_AS_IT_IS = re.compile(
    r"(<(?:pre|script|style|textarea)\b.*?</(?:pre|script|style|textarea)>)", re.DOTALL
)
"""What has its spaces for a reason."""
_SPACES = re.compile(r"\s{2,}")
_IMAGE = re.compile(r'<img (?=[^>]*\bsrc="((?:\.\./)*images/[^"]+)")')
_CLASSES = re.compile(r'\bclass="([^"]*)"')
_VALUES = re.compile(r'\b(?:data-md-color-[\w-]+|dir)="([^"]*)"')
_OF_SELECTOR = re.compile(r"\.((?:[\w-]|\\.)+)|\[(?:data-md-color-[\w-]+|dir)=\"?([\w-]+)")
_SIGNATURES = re.compile(r'\s*<link rel="stylesheet" href="[^"]*_mkdocstrings\.css">')
_JOINED = re.compile(r'\s*<link rel="stylesheet" href="[^"]*(?:/palette\.\w+\.min|/site)\.css">')

_SEARCH = """\
<script>
(() => { // Requests for the index wait until the search is opened, or the address has a query.
  const {open, send} = XMLHttpRequest.prototype
  XMLHttpRequest.prototype.open = function (method, url, ...more) {
    this.waits = /search_index\\.json$/.test(url) && !new URLSearchParams(location.search).has("q")
    return open.call(this, method, url, ...more)
  }
  XMLHttpRequest.prototype.send = function (...words) {
    if (!this.waits) return send.apply(this, words)
    const kinds = ["focusin", "change"]
    const asked = ({target}) => {
      if (!target.matches(".md-search__input, #__search")) return
      kinds.forEach((kind) => removeEventListener(kind, asked))
      send.apply(this, words)
    }
    kinds.forEach((kind) => addEventListener(kind, asked))
  }
})()
</script>
"""


def on_post_page(output: str, *, page: Any, config: Any) -> str:  # noqa: ARG001
    """Let a page load less, and that later."""
    pieces = _AS_IT_IS.split(output)
    pieces[::2] = [_SPACES.sub(_one_space, piece) for piece in pieces[::2]]
    output = "".join(pieces)
    if 'class="doc' not in output:
        output = _SIGNATURES.sub("", output)
    output = _JOINED.sub("", output)
    output = _IMAGE.sub(lambda found: f"<img {_attributes(found[1])} ", output)
    return output.replace("</head>", f"{_SEARCH}</head>", 1)


def _one_space(found: re.Match[str]) -> str:
    return "\n" if "\n" in found[0] else " "


def _attributes(source: str) -> str:
    file = DOCS / source.replace("../", "")
    size = _size(file) if file.suffix != ".svg" else ""
    return f'loading="lazy" decoding="async"{size}'


@cache
def _size(file: Path) -> str:
    from PIL import Image

    with Image.open(file) as image:
        return f' width="{image.width}" height="{image.height}"'


def on_post_build(*, config: Any) -> None:
    """Put the style sheets into one, and cut it."""
    site = Path(config.site_dir)
    (main,) = site.glob("assets/stylesheets/main.*.css")
    sheets = [main, *site.glob("assets/stylesheets/palette.*.css"), site / "assets" / "site.css"]
    text = "".join(each.read_text(encoding="utf-8").split("/*# source")[0] for each in sheets)
    main.write_text("".join(kept(text, words_of(site))), encoding="utf-8")


def words_of(site: Path) -> frozenset[str]:
    """Return classes, colours and directions of a site's pages, and words of the theme's script."""
    found: set[str] = set()
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        found.update(" ".join(_CLASSES.findall(text)).split(), _VALUES.findall(text))
    for script in (site / "assets" / "javascripts").glob("*.js"):
        found.update(re.findall(r"[\w-]+", script.read_text(encoding="utf-8")))
    return frozenset(found)


def kept(css: str, known: frozenset[str]) -> Iterator[str]:
    """Yield the rules of a style sheet that can fit an element.

    Args:
        css: minified, or not.
        known: classes that elements may have. A rule with `:not(.x)` stays whatever `x` is.
    """
    for prelude, body in _rules(css):
        if prelude.lstrip().startswith(("@media", "@supports", "@layer", "@container")):
            inner = "".join(kept(body, known))
            if inner:
                yield f"{prelude}{{{inner}}}"
        elif body is None or prelude.lstrip().startswith("@"):
            yield prelude if body is None else f"{prelude}{{{body}}}"
        else:
            selectors = [each for each in _selectors(prelude) if _can_fit(each, known)]
            if selectors:
                yield f"{','.join(selectors)}{{{body}}}"


def _can_fit(selector: str, known: frozenset[str]) -> bool:
    while selector != (outside := re.sub(r":[\w-]+\([^()]*\)", "", selector)):
        selector = outside
    words = (name or value for name, value in _OF_SELECTOR.findall(selector))
    return all(word.replace("\\", "") in known for word in words)


_TOKEN = re.compile(r"""/\*.*?\*/|"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*'|\\.|[{};]""", re.DOTALL)
"""What a brace or a semicolon of a rule is told by: comments and strings may have them too."""


def _rules(css: str) -> Iterator[tuple[str, Any]]:
    """Yield preludes and bodies; a statement such as `@charset` has no body."""
    depth = start = opened = 0
    for token in _TOKEN.finditer(css):
        match token[0]:
            case "{":
                opened = token.start() if depth == 0 else opened
                depth += 1
            case "}":
                depth -= 1
                if depth == 0:
                    yield css[start:opened], css[opened + 1 : token.start()]
                    start = token.end()
            case ";" if depth == 0:
                yield css[start : token.end()], None
                start = token.end()
    yield css[start:], None


def _selectors(prelude: str) -> list[str]:
    """Return the selectors of a list; commas in parentheses and strings do not part them."""
    return re.findall(r"""(?:\([^()]*(?:\([^()]*\)[^()]*)*\)|"[^"]*"|\\.|[^,])+""", prelude)
