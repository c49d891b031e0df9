"""What the site says that the code says: verbs, keys, columns, topics, scores, Python API.

A page has a line such as `<!-- generated: columns -->`. When MkDocs builds the site, this file, a
hook of mkdocs.yml, puts the text of that part there. The hook also turns what GitHub shows and
Python's Markdown does not into what both do: names of files behind fences, links to files that are
not on the site, escaped bars in code.
"""

from __future__ import annotations

import inspect
import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.cli.verbs.help import Option

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
EXAMPLE = ROOT / "build" / "example"
"""Where `make docs` puts pages of real runs."""

_UP = "{up}"
"""The way from a page to the site's folder."""
_PART = re.compile(r"^<!-- generated: ([\w -]+) -->$", re.MULTILINE)
_NAMED_FENCE = re.compile(r"^( *)```([\w-]+) ([^\s{}=]+)$", re.MULTILINE)
_FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?://)([^)\s#]+)(#[^)\s]*)?\)")
_DEFAULT = re.compile(r" \(default: ([^()]*)\)(?=\.)")
_SEARCH = 'data-md-component="search" role="dialog" aria-label="Search"'
_UNSEARCHED = re.compile(r"changelog\.md|reference/python/\w+\.md")
"""Pages that the search leaves out, since they are a third of its index; reference/api.md has the
names of all functions."""


def parts() -> Mapping[str, Callable[[], str]]:
    """Return what makes the text of each part, by its name."""
    return {
        "verbs": verbs,
        "suite keys": lambda: keys("suite"),
        "policy keys": lambda: keys("policy"),
        "scene keys": lambda: keys("scene", level=3),
        "collision keys": lambda: keys("collision", level=3),
        "ladder keys": lambda: keys("ladder", level=3),
        "robot keys": lambda: keys("robot"),
        "columns": columns,
        "topics": topics,
        "scores": scores,
        "ladders": ladders,
        "operators": network_operators,
        "system calls": system_calls,
        **{f"python {topic}": partial(api_of, topic) for topic in TOPICS},
        "changelog": changelog,
        **{f"example {name}": partial(example, name) for name in EXAMPLES},
    }


def filled(text: str) -> str:
    """Return a page with the parts that it names.

    Raises:
        KeyError: there is no part of a name.
    """
    made = parts()
    return _PART.sub(lambda found: made[found[1]](), text)


# The command line.


def verbs() -> str:
    """Return every verb with its options, as `--help` has them."""
    from nw_eval.cli.verbs import resolve
    from nw_eval.cli.verbs.table import VERBS

    sections: list[str] = []
    for name, verb in VERBS.items():
        if not verb.parts:
            sections += _verb(name, resolve(name), 2)
            continue
        sections += [f"## {name}", f"{verb.line.capitalize()}."]
        for part in verb.parts:
            sections += _verb(f"{name} {part}", resolve(name, part), 3)
    return "\n\n".join(sections)


def _verb(name: str, form: type, level: int) -> Iterator[str]:
    from nw_eval.cli.verbs.help import options_of

    yield f"{'#' * level} {name}"
    yield _prose(inspect.cleandoc(form.__doc__ or ""))
    if options := options_of(form):
        rows = [_option(option) for option in options]
        if any(default for _, default, _ in rows):
            yield _table(("option", "default", "meaning"), rows)
        else:
            yield _table(("option", "meaning"), [(option, told) for option, _, told in rows])


def _option(option: Option) -> tuple[str, str, str]:
    several = _DEFAULT.findall(option.help)
    one = several[0] if len(several) == 1 else ""
    told = _DEFAULT.sub("", option.help) if one else option.help
    default = "required" if option.is_required else one if " " in one else _code(one) if one else ""
    if not option.flags:
        return _code(option.metavar), default, _cell(told)
    value = f" {_code(option.metavar)}" if option.metavar else ""
    return ", ".join(map(_code, option.flags)) + value, default, _cell(told)


def ladders() -> str:
    """Return the built-in ladders: of scenes first, then of perturbations and commands."""
    from nw_eval import api

    rows = []
    for each in api.ladders():
        one, two, last = (each.rungs[index].value for index in (0, 1, -1))
        apart = f"{abs(two - one):.2g} {each.unit}".rstrip()
        ends = f"{each.told(one)} to {each.told(last)}"
        rows.append((_code(each.name), each.parameter, ends, apart, str(len(each.rungs))))
    return _table(("ladder", "number", "from easy to hard", "apart", "rungs"), rows)


# The files that people write.


@cache
def keys(kind: str, *, level: int = 2) -> str:
    """Return the keys of a kind of file, one table for each of its parts, from its models.

    Args:
        kind: of the file, as `nw-eval schema` names it, or `robot`.
        level: of the headings of its parts.
    """
    whole = _schema(kind)
    named = _headings(whole)
    sections = [_keys(whole, named)]
    for name, heading in named.items():
        part = whole["$defs"][name]
        if "properties" in part:
            sections += [f"{'#' * level} {heading}", _prose(part.get("description", ""))]
            sections.append(_keys(part, named))
    return "\n\n".join(section for section in sections if section)


def _schema(kind: str) -> dict[str, Any]:
    from nw_eval import api

    if kind != "robot":
        return api.schema(kind)  # type: ignore[arg-type]
    from nw_base.files.yaml_file import json_schema_of
    from nw_scenes.robots.robot_file import RobotFile

    return json_schema_of(RobotFile)


def _headings(whole: dict[str, Any]) -> dict[str, str]:
    """Return what each part is called, in the order in which the keys lead to them.

    That is the key that tells it from others, such as `sensor: depth`, or where it stands.
    """
    named: dict[str, str] = {}
    waiting = [("", whole)]
    while waiting:
        path, part = waiting.pop(0)
        for key, value in part.get("properties", {}).items():
            where = f"{path}.{key}" if path else key
            for name in _references(value):
                if name in named:
                    continue
                inner = whole["$defs"][name]
                kinds = [
                    (each, of["const"])
                    for each, of in inner.get("properties", {}).items()
                    if isinstance(of.get("const"), str)
                ]
                heading = f"`{kinds[0][0]}: {kinds[0][1]}`" if kinds else f"`{where}`"
                same = heading in named.values()
                named[name] = f"{heading} ({name.strip('_')})" if same else heading
                waiting.append((kinds[0][1] if kinds else where, inner))
    return named


def _references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key == "$ref":
                yield inner.rpartition("/")[2]
            elif key not in {"default", "discriminator"}:
                yield from _references(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _references(inner)


def _keys(part: dict[str, Any], named: dict[str, str]) -> str:
    required = part.get("required", ())
    rows = [
        (
            _code(key),
            _type(value, named),
            "required" if key in required else _default(value),
            _cell(value.get("description", "")),
        )
        for key, value in part["properties"].items()
    ]
    return _table(("key", "type", "default", "meaning"), rows)


def _default(value: dict[str, Any]) -> str:
    if isinstance(value.get("default"), dict) and "$ref" in value:
        return "as below"
    if "default" not in value:
        return "none"
    default = value["default"]
    return "none" if default in (None, "", [], {}) else _code(json.dumps(default))


def _type(value: dict[str, Any], named: dict[str, str]) -> str:
    """Return the type of a value in words."""
    if "$ref" in value:
        heading = named[value["$ref"].rpartition("/")[2]]
        return f"[{heading}](#{anchor(heading)})"
    for key in ("anyOf", "oneOf"):
        if key in value:
            kinds = dict.fromkeys(_type(each, named) for each in value[key])
            return " or ".join(kind for kind in kinds if kind != "null") or "null"
    if "enum" in value:
        return ", ".join(_code(json.dumps(each).strip('"')) for each in value["enum"])
    if "const" in value:
        return _code(json.dumps(value["const"]).strip('"'))
    kind = value.get("type", "any")
    if kind == "array":
        inner = value.get("prefixItems")
        if inner:
            return f"[{', '.join(_type(each, named) for each in inner)}]"
        return f"list of {_type(value.get('items', {}), named)}"
    if kind == "object":
        inner = [value.get("additionalProperties"), *value.get("patternProperties", {}).values()]
        of = next((_type(each, named) for each in inner if isinstance(each, dict)), "any")
        return f"mapping to {of}"
    return f"{kind}{_bounds(value)}"


def _bounds(value: dict[str, Any]) -> str:
    found = [
        f"{word} {value[key]:g}"
        for key, word in (
            ("minimum", "at least"),
            ("exclusiveMinimum", "over"),
            ("maximum", "at most"),
            ("exclusiveMaximum", "under"),
        )
        if key in value
    ]
    return f", {', '.join(found)}" if found else ""


# What runs leave.


def columns() -> str:
    """Return the columns of `trials.parquet`."""
    import pyarrow as pa

    from nw_gate.results.parquet import SCHEMA
    from nw_gate.results.row import COLUMNS

    lines = ["| column | type | what |", "|---|---|---|"]
    for name, column in COLUMNS.items():
        field = SCHEMA.field(name)
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        shown = f"{kind} or none" if field.nullable else kind
        lines.append(f"| `{name}` | {shown} | {column.about} |")
    return "\n".join(lines) + "\n"


def topics() -> str:
    """Return the topics of a log."""
    from nw_sim.rollout.mcap.topics import topics_table

    return topics_table()


def system_calls() -> str:
    """Return the system calls that the fence allows, and what arguments some may have."""
    from nw_base.confinement import seccomp

    groups = {
        **seccomp.ALLOWED,
        "processes that write files": seccomp.WRITING,
        "processes with sockets": seccomp.SERVING,
        "processes that connect to a server": seccomp.CONNECTING,
    }
    needs = [(group, _names(text)) for group, text in groups.items()]
    checked = [
        (f"`{call}`", _names(" ".join(places.values()))) for call, places in seccomp.CHECKED.items()
    ]
    heads = ("call", "values of its arguments that are allowed")
    return "\n\n".join((_table(("first needed by", "calls"), needs), _table(heads, checked)))


def network_operators() -> str:
    """Return the operators that nw-eval's networks have, of ONNX and of torch."""
    from nw_policies.executor.plan import OPERATORS
    from nw_policies.executor.planning import operators
    from nw_policies.networks.aten import RULES
    from nw_policies.networks.aten_layers import COMPOSED

    known = operators()
    kinds = {
        "by element and by row": "arithmetic",
        "products and convolutions": "products",
        "recurrent layers": "recurrent",
        "what moves numbers": "moves",
    }
    assert {f"nw_policies.executor.{kind}" for kind in kinds.values()} == {
        module.__name__ for module in OPERATORS
    }
    onnx = [(title, _names(" ".join(known[kind]))) for title, kind in kinds.items()]
    torch = _names(" ".join(sorted({*RULES, *COMPOSED})))
    return "\n\n".join(
        (_table(("kind", "operators of ONNX"), onnx), f"Operators of ATen: {torch}.")
    )


def _names(text: str) -> str:
    return ", ".join(dict.fromkeys(f"`{word.split('/')[0]}`" for word in text.split()))


def scores() -> str:
    """Return the scores that are built in, as they are declared."""
    from nw_gate.scores import BUILT_IN

    rows = [
        (
            _code(name),
            spec.unit or "none",
            spec.better,
            f"{spec.low:g} to {spec.high:g}",
            f"{spec.undefined:g}",
            _cell(spec.meaning),
        )
        for name, spec in ((name, cls.spec) for name, cls in BUILT_IN.items())
    ]
    return _table(("score", "unit", "better", "range", "undefined counts as", "what"), rows)


def changelog() -> str:
    """Return the changelog behind its title, with its links from the pages' folder."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n")[2]
    return text.replace("](docs/", "](").strip()


# Python.


TOPICS: Mapping[str, str] = MappingProxyType(
    {
        "runs": """api engine gate.results.request gate.results.row""",
        "judging": """gate api.baselines api.baselines_saved api.baselines_verified api.comparisons
            api.climbing api.ledgers api.series api.sweeping api.verifying api.watching
            reporting.html""",
        "logs": """viewing sim.rollout api.attribution api.cause api.replays api.site
            api.surfaces""",
        "policies": """policies sim.probe api.policies api.robots""",
        "scenes": """scenes sim splat api.hub api.scenes api.sensors api.splats""",
        "extending": """base sim.tasks sim.axes gate.scores splat.files.format splat.gaussians
            api.surfaces.Reporter""",
    }
)
"""Pages of the Python API, and where their names are at home; the longest beginning decides.

`api`, `engine` and `viewing` are parts of `nw_eval`, the others are packages.
"""


def topic_of(home: str) -> str:
    """Return the page that shows a name.

    Args:
        home: module and name, such as `nw_eval.api.runs.run`.

    Raises:
        LookupError: no page is about the package.
    """
    place = home.removeprefix("nw_").removeprefix("eval.")
    starts = {start: topic for topic, text in TOPICS.items() for start in text.split()}
    known = [start for start in starts if f"{place}.".startswith(f"{start}.")]
    if not known:
        raise LookupError(f"no page of the Python API is about {home}: name its place in TOPICS")
    return starts[max(known, key=len)]


def api_of(topic: str) -> str:
    """Return what tells mkdocstrings to show a page's functions, then its other public names.

    It reads sources, and finds a name where it is at home.

    Args:
        topic: of the page, one of `TOPICS`.
    """
    import nw_eval
    from nw_base.public import homes

    at_home = homes(f"{nw_eval.__file__}i")
    shown: dict[bool, list[str]] = {True: [], False: []}
    for name in sorted(nw_eval.__all__, key=str.lower):
        if not name.startswith("_") and topic_of(f"{at_home[name]}.{name}") == topic:
            is_function = inspect.isfunction(getattr(nw_eval, name))
            shown[is_function].append(f"::: {at_home[name]}.{name}")
    titles = {True: "## Functions", False: "## Values" if shown[True] else "## Classes"}
    return "\n\n".join(
        "\n\n".join([titles[is_function], *names]) for is_function, names in shown.items() if names
    )


# A real run.


EXAMPLES: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "report": (
            "report.html",
            "The report of a run that regressed",
            "nw-eval run gaps --policy go1-act-rgb --baseline go1-parkour",
        ),
        "leaderboard": (
            "leaderboard/index.html",
            "A leaderboard of three policies",
            "nw-eval report --site leaderboard reports/gaps-*",
        ),
    }
)
"""Pages that `make docs` makes of real runs: file in `EXAMPLE`, title, and command."""


def example(name: str) -> str:
    """Return what shows a page of a real run within a page; a sentence where none was made.

    Args:
        name: one of `EXAMPLES`.
    """
    file, title, command = EXAMPLES[name]
    told = f"<code>{command}</code>"
    if not (EXAMPLE / file).is_file():
        return f"<p>{told} writes it. <code>make docs</code> shows it here.</p>"
    page = f"{_UP}example/{file}"
    return (
        f'<figure class="example"><iframe src="{page}" title="{title}" loading="lazy"></iframe>\n'
        f'<figcaption>{title}: {told}. <a href="{page}">Open it in full</a></figcaption></figure>'
    )


# Markdown.


def anchor(heading: str, separator: str = "-") -> str:
    """Return the anchor of a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", separator)


def _table(heads: Iterable[str], rows: Iterable[tuple[str, ...]]) -> str:
    heads = list(heads)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |".replace("|  |", "| |") for line in lines)


def _cell(text: str) -> str:
    """Return text for a cell of a table: one line, nothing in it is markup but code and links."""
    pieces = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(
        piece if piece.startswith("`") else _plain(piece).replace("|", "\\|") for piece in pieces
    )


def _prose(text: str) -> str:
    pieces = re.split(r"(`[^`]*`)", text)
    return "".join(piece if piece.startswith("`") else _plain(piece) for piece in pieces)


def _plain(text: str) -> str:
    return re.sub(r"(?<=\w)_(?=\w)|\*", r"\\\g<0>", text.replace("<", "&lt;"))


def _code(text: str) -> str:
    return f"`{' '.join(text.split())}`"


def adapted(text: str, page: str) -> str:
    """Return a page as Python's Markdown needs it.

    Args:
        text: of the page, as GitHub shows it.
        page: its path in docs/, such as `how-to/ci.md`.
    """
    text = _NAMED_FENCE.sub(r'\1```\2 title="\3"', text)
    pieces = re.split(f"({_FENCE.pattern})", text, flags=_FENCE.flags)
    return "".join(piece if _FENCE.match(piece) else _links(piece, page) for piece in pieces)


def _links(text: str, page: str) -> str:
    def followed(found: re.Match[str]) -> str:
        target = ((DOCS / page).parent / found[2]).resolve()
        if target == ROOT / "CHANGELOG.md":
            up = "../" * page.count("/")
            return f"[{found[1]}]({up}changelog.md{found[3] or ''})"
        if target.is_relative_to(DOCS):
            return found[0]
        return f"{found[1]} (`{target.relative_to(ROOT)}` of the sources)"

    lines = _LINK.sub(followed, text).split("\n")
    # In code a bar needs no backslash here, and one would be shown.
    return "\n".join(
        re.sub(r"`[^`]*`", lambda code: code[0].replace("\\|", "|"), line)
        if line.startswith("|")
        else line
        for line in lines
    )


# The hook of MkDocs.


def on_config(config: Any) -> Any:
    """Make anchors as GitHub makes them, so that a link leads to the same heading on both."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = anchor
    return config


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:  # noqa: ARG001
    """Put the generated parts into a page."""
    if _UNSEARCHED.fullmatch(page.file.src_uri):
        page.meta["search"] = {"exclude": True}
    text = adapted(filled(markdown), page.file.src_uri)
    return text.replace(_UP, "../" * page.file.src_uri.count("/"))


def on_post_page(output: str, *, page: Any, config: Any) -> str:  # noqa: ARG001
    """Name the dialog of the search, which the theme leaves without a name."""
    return output.replace('data-md-component="search" role="dialog"', _SEARCH)


def on_post_template(output: str, *, template_name: str, config: Any) -> str:  # noqa: ARG001
    """Do the same for the page of an address that is none."""
    return output.replace('data-md-component="search" role="dialog"', _SEARCH)


def on_post_build(*, config: Any) -> None:
    """Add the pages of real runs, if there are some."""
    if EXAMPLE.is_dir():
        shutil.copytree(EXAMPLE, Path(config.site_dir) / "example", dirs_exist_ok=True)
