"""A verb of the command line, made of the function of `nw_eval.api` that it calls.

    @verb_of("show_baseline")
    class Show(Verb):
        '''Show what a baseline was saved for, by whom and why.'''

        def show(self, found: ShownBaseline) -> str:
            return baseline_page(found)

Each parameter of the function is an option of its name, type and default, and the sentence of
`Args:` is its help; what Python takes by place is an argument. The class says what is otherwise on
the command line:

* `out = Path("scenes.png")`: the default there.
* `run: Path`: the type there, where the function takes others, too. It is also what a type checker
  knows of `self.run`.
* `trials: int | None = None` with a docstring: the help there. Where the function has no parameter
  of that name, it is an option that the class makes use of itself.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro

from nw_base import words
from nw_eval import api
from nw_eval.cli.terminal.final_output import tell
from nw_eval.cli.terminal.interruption import INTERRUPTED
from nw_eval.cli.verbs.help import told_of
from nw_eval.cli.verbs.printed import json_text
from nw_eval.cli.verbs.shared import SHARED
from nw_eval.engine.how import How

V = TypeVar("V", bound="Verb")

_HOW = frozenset({"progress", *(field.name for field in fields(How))})
"""Parameters on how a function works. They are options only of verbs that name them."""
_LETTERS = {"policy": "-p", "trials": "-n"}
_NONE: Mapping[str, str] = MappingProxyType({})


class _Call(NamedTuple):
    """How a verb calls its function."""

    function: str
    options: Mapping[str, str]
    """Fields of the verb by the parameters that they are handed to."""
    listens: bool
    heard: Callable[..., str] | None


@dataclass(frozen=True, kw_only=True)
class Verb:
    """What `verb_of` completes."""

    goes_on: ClassVar[str] = "interrupted"
    """What is said where a signal ended it."""
    made: ClassVar[_Call]

    def more(self) -> dict[str, Any]:
        """Return arguments of the function that are not handed on as they were given."""
        return {}

    def show(self, result: Any, /) -> str:
        """Return what is printed of an answer; nothing is where it is empty."""
        return str(result)

    def shown_json(self, result: Any, /) -> str:
        """Return what `--json` prints of an answer."""
        return json_text(result)

    def code(self, result: Any, /) -> int:
        """Return the exit code of an answer."""
        if getattr(result, "interrupted", False):
            return INTERRUPTED
        return getattr(result, "exit_code", 0)

    def call(self) -> Any:
        """Call the function with the options, and return its answer."""
        function, options, listens, heard = self.made
        values = {name: getattr(self, field) for name, field in options.items()} | self.more()
        if "no_cache" in values:
            values["cache"] = not values.pop("no_cache")
        if not listens:
            return getattr(api, function)(**values)
        from nw_eval.cli.terminal.progress import RunProgress

        with RunProgress() as progress:
            if heard is not None and "progress" not in values:
                values["progress"] = lambda *each: progress.message(heard(*each))
            return getattr(api, function)(listener=progress, **values)

    def __call__(self) -> int:
        result = self.call()
        if shown := self.shown_json(result) if getattr(self, "json", False) else self.show(result):
            print(shown)
        code = self.code(result)
        if code == INTERRUPTED:
            tell(self.goes_on)
        return code


def verb_of(
    function: str,
    *,
    changes: Sequence[str] = (),
    flags: Collection[str] = (),
    without: Collection[str] = (),
    named: Mapping[str, str] = _NONE,
    metavars: Mapping[str, str] = _NONE,
    listens: bool = False,
    heard: Callable[..., str] | None = None,
) -> Callable[[type[V]], type[V]]:
    """Return a decorator that gives a verb an option for each parameter of a function.

    Args:
        function: its name in `nw_eval.api`.
        changes: options that are the same in all verbs: those of `SHARED`, and other fields of
            `Request`. They are parameters of the function, or among its `**changes`.
        flags: parameters that are options though Python takes them by place.
        without: parameters that are no options.
        named: what an option is called, by the parameter, where it has another name.
        metavars: words for values, by the parameter.
        listens: whether the function has a `listener`, which shows how far it is.
        heard: the line for what the function tells its `progress`.
    """
    known = inspect.unwrap(getattr(api, function))
    by_name = {named.get(each.name, each.name): each for each in _options(known, changes, without)}

    def complete(form: type[V]) -> type[V]:
        own = inspect.get_annotations(form)
        stated = get_type_hints(form, include_extras=True) if own.keys() & by_name.keys() else {}
        hints: dict[str, Any] = {}
        for name, each in by_name.items():
            if name not in vars(form) and each.default is not inspect.Parameter.empty:
                setattr(form, name, each.default)
            hint = stated[name] if name in own else each.hint_for(getattr(form, name, None))
            marks = each.marks(metavars.get(each.name), is_flag=each.name in flags)
            hints[name] = Annotated[(hint, *marks)]
        form.__annotations__ = {**hints, **{n: hint for n, hint in own.items() if n not in hints}}
        options = {each.name: name for name, each in by_name.items()}
        form.made = _Call(function, options, listens, heard)
        return dataclass(frozen=True, kw_only=True)(form)

    return complete


class _Option(NamedTuple):
    """An option as a function has it."""

    name: str
    """Of the parameter."""
    hint: Any
    default: Any
    arg: Any
    """What tyro knows of it, with its help."""
    is_placed: bool = False
    """Whether Python takes it by place."""

    def hint_for(self, default: Any) -> Any:
        """Return the hint, without None where the option has a default."""
        kinds = [kind for kind in get_args(self.hint) if kind is not NoneType]
        optional = get_origin(self.hint) in {Union, UnionType} and len(kinds) == 1
        return kinds[0] if optional and default is not None else self.hint

    def marks(self, metavar: str | None, *, is_flag: bool) -> tuple[Any, ...]:
        """Return what the hint is annotated with."""
        arg = self.arg if metavar is None else replace(self.arg, metavar=metavar)
        if not self.is_placed or is_flag:
            return (arg,)
        return replace(arg, aliases=None), tyro.conf.Positional


def _options(
    known: Callable[..., Any], changes: Sequence[str], without: Collection[str]
) -> Iterator[_Option]:
    """Yield the parameters of a function that are options, then what else it is to take."""
    asked = {
        name: each
        for name, each in inspect.signature(known).parameters.items()
        if each.kind is not each.VAR_KEYWORD and name not in {*_HOW, *without}
    }
    own, told = [name for name in asked if name not in changes], _sentences(known)
    if unsaid := next((name for name in own if name not in told), None):
        raise LookupError(
            f"nw_eval.api.{known.__name__}: nothing is said of {unsaid!r} in `Args:`, and an "
            "option needs a help; write a sentence there, or leave it out with `without`"
        )
    hints = _hints_of(known, own)
    for name, each in asked.items():
        is_placed = each.kind is each.POSITIONAL_OR_KEYWORD
        if name in changes:
            yield _shared(name)._replace(is_placed=is_placed)
        else:
            arg = _arg(name, told[name])
            yield _Option(name, _plain(hints[name]), each.default, arg, is_placed)
    yield from (_shared(name) for name in changes if name not in asked)


def _shared(name: str) -> _Option:
    """Return an option that is the same in all verbs."""
    if name in SHARED:
        hint, arg = get_args(SHARED[name])
        default = {bool: False, str: inspect.Parameter.empty}.get(hint)
        return _Option(name, hint, default, arg)
    from nw_gate.results.request import Request

    hint, told = _hints_of(Request, [name])[name], told_of(Request)[name]
    default = Request.__dataclass_fields__[name].default
    return _Option(name, _plain(hint), default, _arg(name, " ".join(told.split())))


def _arg(name: str, told: str) -> Any:
    letters = [_LETTERS[name]] if name in _LETTERS else None
    return tyro.conf.arg(help=told, aliases=letters)


def _hints_of(known: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return the types of some parameters, or fields.

    The others may be of names that only a type checker knows.
    """
    annotated = {name: known.__annotations__[name] for name in names}
    room = vars(inspect.getmodule(known))
    common = {"Path": Path, "PathLike": PathLike, "Sequence": Sequence}
    scope = {**vars(words), **common, **room}
    return get_type_hints(type("Hints", (), {"__annotations__": annotated}), scope)


def _plain(hint: Any) -> Any:
    """Return the type of an option: a text where a path or a number would do, too.

    A file that Python takes as text or as `PathLike` is a path.
    """
    if get_origin(hint) is Sequence:
        return tuple[_plain(get_args(hint)[0]), ...]
    kinds = get_args(hint) if get_origin(hint) in {Union, UnionType} else ()
    if str not in kinds:
        return hint
    one: Any = Path if PathLike[str] in kinds else str
    return one | None if NoneType in kinds else one


def _sentences(known: Callable[..., Any]) -> dict[str, str]:
    """Return what a docstring says of each argument, in words of the command line."""
    _, _, rest = inspect.cleandoc(known.__doc__ or "").partition("\nArgs:\n")
    section = re.split(r"\n(?=\S)", rest, maxsplit=1)[0]
    parts = re.split(r"^ {4}(\w+): ", section, flags=re.MULTILINE)[1:]
    return {
        name: _said(" ".join(told.split()))
        for name, told in zip(parts[::2], parts[1::2], strict=True)
    }


def _said(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
