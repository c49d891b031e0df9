"""How templates become a page: foreign words as text, and leave for nothing but what is ours.

The page asks no network for anything, and a policy of its own (a `Content-Security-Policy`) says
so to the browser: it runs the one script and draws by the one style sheet whose hashes stand there,
and shows pictures that are in the file. Text of third parties is made visible (`clean`) and escaped
wherever a template prints it; none of them could load or run anything even if that failed.
"""

from __future__ import annotations

import re
from base64 import b64encode
from functools import cache, lru_cache
from hashlib import sha256
from typing import Any, cast

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from nw_base.clean import clean

_LONGEST = 4000  # characters of a text
_UNITS = "%|ms|s|min|h|mm|cm|m|kg|rad|Hz|N m|N|W|J|[kM]B|[KMG]iB"
_BEFORE_UNIT = re.compile(rf"(?<=[0-9]) (?=(?:{_UNITS})(?![\w/]))")


def render(template: str, **values: Any) -> str:
    """Return a page.

    Args:
        template: its file.
        values: what it lays out.
    """
    environment = _environment()
    style, script = _source(environment, "page.css"), _source(environment, "page.js")
    return environment.get_template(template).render(
        style=Markup(style),  # noqa: S704 - A file of ours.
        script=Markup(script),  # noqa: S704 - A file of ours.
        leave=f"default-src 'none'; style-src {_hash(style)}; script-src {_hash(script)}; "
        "img-src data:; base-uri 'none'; form-action 'none'; require-trusted-types-for 'script'",
        **values,
    )


def compile_templates() -> None:
    """Compile all templates, which takes longer than to lay out a page by them."""
    environment = _environment()
    for name in environment.list_templates(filter_func=lambda name: name.endswith(".html.j2")):
        environment.get_template(name)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("nw_eval.reporting"),
        autoescape=True,
        finalize=_visible,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    cast("dict[str, Any]", environment.globals)["data_uri"] = data_uri
    environment.filters["typed"] = _typed
    environment.filters["coded"] = _coded
    return environment


def data_uri(data: bytes, mime: str) -> str:
    """Return bytes as an address that holds them."""
    # Markup: there may be millions of characters, none of which needs a look.
    return Markup(f"data:{mime};base64,{b64encode(data).decode('ascii')}")  # noqa: S704 - As above.


def _visible(value: Any) -> Any:
    return _kept_together(value) if type(value) is str else value


def _typed(text: str) -> str:
    """Return what is to be copied and typed: its spaces stay what they are."""
    return escape(clean(text, at_most=_LONGEST))


def _coded(sentence: str) -> str:
    """Return a sentence in which what stands between backticks is set as code."""
    parts = clean(sentence, at_most=_LONGEST).split("`")
    if len(parts) % 2 == 0:  # One has no other end.
        return escape(_kept_together(sentence))
    shown = [
        Markup("<code>{}</code>").format(part)
        if place % 2
        else escape(_BEFORE_UNIT.sub("\u00a0", part))
        for place, part in enumerate(parts)
    ]
    return Markup("").join(shown)


@lru_cache(maxsize=1024)
def _kept_together(text: str) -> str:
    """Return a text that can be seen, in which no number is parted from its unit."""
    return _BEFORE_UNIT.sub("\u00a0", clean(text, at_most=_LONGEST))


def _source(environment: Environment, name: str) -> str:
    if environment.loader is None:
        raise ValueError("templates come from the package")
    return environment.loader.get_source(environment, name)[0]


def _hash(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"
