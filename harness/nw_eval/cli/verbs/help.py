"""What `--help` prints, made from the table of verbs and from the dataclass of each verb."""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from nw_eval.cli.verbs.table import OPTION_GROUPS, TITLES_OF_PACKAGES, VERBS, docs_line

_COLUMN = 28
"""Where the words on an option begin, unless the terminal is narrow."""
_MANY = 10
"""Options that are listed under one title."""


class Option(NamedTuple):
    """An argument of a verb, or an option."""

    name: str
    flags: tuple[str, ...]
    """None of an argument."""
    metavar: str
    """Empty of a switch."""
    choices: tuple[str, ...]
    help: str
    is_required: bool

    @property
    def shown(self) -> str:
        """As it stands in the list: `-n, --trials N`."""
        return " ".join(filter(None, (", ".join(self.flags), self.metavar)))


@cache
def options_of(form: type) -> tuple[Option, ...]:
    """Return the arguments and options of a verb's class, in the order of its fields."""
    import tyro

    hints, told = get_type_hints(form, include_extras=True), told_of(form)
    options: list[Option] = []
    for field in fields(form):
        kind, marks = _plain(hints[field.name])
        conf = next((mark for mark in marks if hasattr(mark, "metavar")), None)
        word = (getattr(conf, "name", None) or field.name).replace("_", "-")
        word = f"no-{word}" if kind is bool and field.default is True else word
        is_argument = tyro.conf.Positional in marks
        flags = () if is_argument else (*(getattr(conf, "aliases", None) or ()), f"--{word}")
        metavar = getattr(conf, "metavar", None) or _metavar(kind, field.name, is_argument)
        is_required = field.default is MISSING and field.default_factory is MISSING
        words = " ".join((told.get(field.name) or getattr(conf, "help", None) or "").split())
        if field.default not in (MISSING, None, False, True, (), ""):
            words = re.sub(r"( \(default: [^()]*\))?\.$", f" (default: {field.default}).", words)
        if tyro.conf.UseAppendAction in marks:
            words += " Repeatable."
        choices = tuple(map(str, get_args(kind))) if get_origin(kind) is Literal else ()
        options.append(Option(field.name, flags, metavar, choices, words.strip(), is_required))
    return tuple(options)


def _plain(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a hint without None and without annotations, and the annotations."""
    marks: tuple[Any, ...] = ()
    while True:
        if get_origin(hint) is Annotated:
            hint, *more = get_args(hint)
            marks += tuple(more)
        elif NoneType in (kinds := get_args(hint)):
            [hint] = (kind for kind in kinds if kind is not NoneType)
        else:
            return hint, marks


def _metavar(kind: Any, name: str, is_argument: bool) -> str:
    """Return the word for a value."""
    if kind is bool:
        return ""
    if get_origin(kind) is tuple:
        first, *more = get_args(kind)
        word = _metavar(first, name.removesuffix("s") if is_argument else name, is_argument)
        return f"{word} ..." if more == [...] else " ".join([word] * (1 + len(more)))
    if is_argument:
        return name.upper()
    if get_origin(kind) is Literal:
        return f"{{{','.join(map(str, get_args(kind)))}}}"
    return {int: "N", float: "X", Path: "PATH"}.get(kind, name.rpartition("_")[2].upper())


@cache
def told_of(form: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class."""
    told: dict[str, str] = {}
    for base in (each for each in reversed(form.__mro__) if is_dataclass(each) and fields(each)):
        [defined] = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(defined, ast.ClassDef)
        for field, text in pairwise(defined.body):
            match field, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=v)):
                    told[name] = str(v)
                case _:
                    pass
    return told


def verb_page(name: str, form: type, examples: Sequence[str]) -> str:
    """Return the help of a verb."""
    options = options_of(form)
    needed = [
        option.shown.rpartition(", ")[2] if option.flags else option.metavar
        for option in sorted(options, key=lambda option: bool(option.flags))
        if option.is_required
    ]
    loose = [f"[{each.metavar}]" for each in options if not each.flags and not each.is_required]
    lines = [_filled(" ".join(["usage: nw-eval", name, *needed, *loose, "[options]"])), ""]
    for paragraph in inspect.cleandoc(form.__doc__ or "").split("\n\n"):
        lines += [_filled(paragraph), ""]
    width = _width([each.shown for each in options])
    for title, listed in _grouped(options, form):
        lines += [f"{title}:", *_listed([(each.shown, _words(each)) for each in listed], width), ""]
    return _ended(lines, [f"{name} {example}".rstrip() for example in examples], name)


def family_page(name: str, lines: Sequence[tuple[str, str]], examples: Sequence[str]) -> str:
    """Return the help of a verb that has others below it, of which `lines` gives name and words."""
    head = [
        f"usage: nw-eval {name} COMMAND [options]",
        "",
        f"{VERBS[name].line[0].upper()}{VERBS[name].line[1:]}.",
        "",
    ]
    more = ["", _filled(f"`nw-eval {name} COMMAND --help` shows a command's options."), ""]
    listed = _listed(lines, _width([part for part, _ in lines]))
    return _ended([*head, "Commands:", *listed, *more], examples, name)


def _ended(lines: list[str], examples: Sequence[str], name: str) -> str:
    page = VERBS[name.split(maxsplit=1)[0]].page
    shown = [f"  nw-eval {example}" for example in examples]
    return "\n".join([*lines, "Examples:", *shown, "", *docs_line(page)]).rstrip()


def _words(option: Option) -> str:
    return f"{option.help} Required." if option.is_required and option.flags else option.help


def _grouped(options: Sequence[Option], form: type) -> Iterator[tuple[str, list[Option]]]:
    """Yield the options under their titles: arguments first, what has no title last."""
    if arguments := [each for each in options if not each.flags]:
        yield "Arguments", arguments
    left = [each for each in options if each.flags]
    if len(left) > _MANY:
        for title, names in OPTION_GROUPS.items():
            if not form.__module__.startswith(TITLES_OF_PACKAGES.get(title, "")):
                continue
            if listed := [each for name in names for each in left if each.name == name]:
                yield title, listed
                left = [each for each in left if each not in listed]
    if left:
        yield "Options", left


def _width(names: Sequence[str]) -> int:
    return min(max(map(len, names), default=0) + 4, _COLUMN)


def _listed(rows: Sequence[tuple[str, str]], width: int) -> Iterator[str]:
    """Yield rows of a name and its words, the words in a column that begins after `width`."""
    for name, words in rows:
        first, *more = textwrap.wrap(words, max(_terminal() - width, 30), **_WHOLE) or [""]
        if len(name) + 4 > width:
            yield f"  {name}"
            more.insert(0, first)
        else:
            yield f"  {name:<{width - 2}}{first}".rstrip()
        yield from (f"{'':{width}}{line}" for line in more)


_WHOLE: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}


def _filled(words: str) -> str:
    return textwrap.fill(" ".join(words.split()), max(_terminal(), 40), **_WHOLE)


def _terminal() -> int:
    return shutil.get_terminal_size().columns
