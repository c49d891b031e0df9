"""YAML files as plain data with the position of every value, for errors that name file and line.

A file is composed to nodes, not constructed to objects: no tag of it can make anything but text,
numbers, booleans, null, lists and mappings, and every duplicate key is found, not the first only.

Of the models that files are checked by there are JSON Schemas, every key with its meaning.
"""

from __future__ import annotations

import ast
import inspect
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

from pydantic import BaseModel, ValidationError
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import ErrorDetails, core_schema
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from nw_base.errors import Problem, nearest
from nw_base.files.inside import regular

Location = tuple[str | int, ...]
Place = tuple[int, int]

KEY_LIMIT = 200
"""Most characters of a key."""
_SIZE_LIMIT = 1_000_000  # Bytes; a suite or a card is a few thousand.
_VALUE_LIMIT = 50_000  # Values after aliases are expanded: a few nested aliases can mean billions.
_DEPTH_LIMIT = 40  # Levels; a list that holds itself has no end.
_OPEN_LIMIT = 200
"""Brackets open at once; the time that the YAML library takes grows with their square."""
_UNREAD = re.compile(r"""(?:^|(?<=\s))#.*|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""", re.MULTILINE)
"""Comments and quoted texts, whose brackets open nothing."""
_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "map", "seq")
}


# What pydantic calls things, as people who write YAML call them.
_WORDS = {
    "bool_type": "should be true or false",
    "dict_type": "should be a mapping",
    "float_type": "should be a number",
    "int_type": "should be a whole number",
    "list_type": "should be a list, such as [a, b]",
    "model_type": "should be a mapping",
    "string_type": "should be text",
    "tuple_type": "should be a list, such as [a, b]",
}


_LIMITS = {
    "greater_than": ("gt", "more than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}


def is_key(text: str) -> bool:
    """Whether a file may have this key, which goes where names of observations and inputs go."""
    return text.isprintable() and len(text) <= KEY_LIMIT


class YamlProblems(ValueError):  # noqa: N818 - a carrier that callers turn into their own error.
    """A file could not be read as one mapping. `problems` holds every fault that was found.

    `file` is what could be read all the same, so that a caller can look for more faults in it;
    None where nothing could.
    """

    def __init__(self, problems: Sequence[Problem], file: YamlFile | None = None) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)
        self.file = file


@dataclass(frozen=True, kw_only=True)
class YamlFile:
    """What a YAML file says, and where.

    `places` maps a location, e.g. `("gate", "max_drop")` or `("scenes", 0)`, to the line and
    column, counted from 1, of its key (in a mapping) or of its value (in a list).
    """

    path: str
    data: dict[str, Any]
    places: Mapping[Location, Place]

    def known(self, location: Sequence[str | int]) -> Location:
        """Return the parts of a location that the file has.

        pydantic puts the names of the branches of unions among the keys; they drop out here.
        """
        known: Location = ()
        for part in location:
            if (*known, part) in self.places:
                known = (*known, part)
        return known

    def place(self, location: Sequence[str | int]) -> Place:
        """Return line and column of a location, or of its nearest parent that the file has."""
        return self.places[self.known(location)]

    def problem(
        self, location: Sequence[str | int], message: str, fix: str | None = None
    ) -> Problem:
        """Return a Problem at a location of this file."""
        line, column = self.place(location)
        return Problem(file=self.path, line=line, column=column, message=message, fix=fix)


def read_yaml(path: Path) -> YamlFile:
    """Read one YAML mapping with the position of every value.

    Raises:
        YamlProblems: the file is missing, unreadable, no YAML, no mapping, or has duplicate keys.
    """
    file = str(path)
    return parse_yaml(_text(path, partial(_fault, file)), file=file)


def parse_yaml(text: str, *, file: str, foreign: bool = False) -> YamlFile:
    """Read one YAML mapping of a text with the position of every value.

    Args:
        text: of a file, or of a part of one.
        file: what errors call it.
        foreign: whether another program wrote it: tags, those of Python's objects too, are left
            out, and what they stand before is read as the list, mapping or text that it is; of
            equal keys the last one counts.

    Raises:
        YamlProblems: it is no YAML, no mapping, or has duplicate keys.
    """
    fail = partial(_fault, file)
    if (place := _too_deep(text)) is not None:
        raise fail(f"over {_OPEN_LIMIT} brackets are open here", "nest less", *place)
    try:
        root = cast("Node | None", YAML(typ="safe", pure=True).compose(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (1, 1) if mark is None else (mark.line + 1, mark.column + 1)
        if "'\\t'" in str(error.problem):
            raise fail("is not YAML: a tab stands here", "use spaces", line, column) from None
        fix = "correct the syntax"
        if (alias := re.search("undefined alias '(.*?):?'", str(error.problem))) is not None:
            fix = f'put a pattern that begins with `*` in quotes: "*{alias[1]}"'
        raise fail(f"is not YAML: {error.problem}", fix, line, column) from None
    except (YAMLError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise fail(f"is not YAML: {reason}", "correct the syntax") from None
    if not isinstance(root, MappingNode):
        kind = "empty" if root is None else "not a mapping"
        raise fail(f"the file is {kind}", "write `key: value` lines")
    reader = _Reader(file, text, foreign=foreign)
    read = YamlFile(path=file, data=reader.value(root, ()) or {}, places=reader.places)
    if reader.problems:
        raise YamlProblems(sorted(reader.problems, key=lambda p: (p.line, p.column)), read)
    return read


def _fault(file: str, message: str, fix: str, line: int = 1, column: int = 1) -> YamlProblems:
    return YamlProblems([Problem(file=file, line=line, column=column, message=message, fix=fix)])


def _text(path: Path, fail: Callable[[str, str], YamlProblems]) -> str:
    try:
        if regular(path).stat().st_size > _SIZE_LIMIT:
            raise fail("the file is over 1 MB", "is this the file you meant?")
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        reason = error.strerror or str(error)
        raise fail(f"cannot be read: {reason}", "check the path") from None
    except UnicodeDecodeError as error:
        raise fail(f"is not UTF-8 text (byte {error.start})", "save it as UTF-8") from None


def _too_deep(text: str) -> Place | None:
    """Return where too many brackets are open at once, or None."""
    depth = 0
    for number, line in enumerate(_UNREAD.sub("", text).splitlines(), start=1):
        for column, character in enumerate(line, start=1):
            depth += (character in "[{") - (character in "]}" and depth > 0)
            if depth > _OPEN_LIMIT:
                return number, column
    return None


class _Reader:
    """Turns nodes into plain values, noting places and faults."""

    def __init__(self, file: str, text: str, *, foreign: bool = False) -> None:
        self.file = file
        self._foreign = foreign
        self._lines = text.splitlines()
        self.places: dict[Location, Place] = {(): (1, 1)}
        self.problems: list[Problem] = []
        self._yaml = YAML(typ="safe", pure=True)
        self._budget = _VALUE_LIMIT
        self._overflown = False

    def _fault(self, node: Node, message: str, fix: str) -> None:
        line, column = node.start_mark.line + 1, node.start_mark.column + 1
        self.problems.append(
            Problem(file=self.file, line=line, column=column, message=message, fix=fix)
        )

    def value(self, node: Node, location: Location) -> Any:
        self._budget -= 1
        if self._budget < 0 or len(location) > _DEPTH_LIMIT:
            if not self._overflown:
                self._fault(node, "the file expands to too many values", "remove nested aliases")
            self._overflown = True
            return None
        if node.tag not in _PLAIN_TAGS and not self._foreign:
            kind = node.tag.rsplit(":", 1)[-1]
            fix = "put it in quotes" if kind in {"timestamp", "merge"} else "remove the tag"
            self._fault(node, f"a value has the tag {kind!r}", fix)
            return None
        if isinstance(node, MappingNode):
            return self._mapping(node, location)
        if isinstance(node, SequenceNode):
            items: list[Any] = []
            for index, child in enumerate(cast("list[Node]", node.value)):
                self.places[*location, index] = _mark(child)
                items.append(self.value(child, (*location, index)))
            return items
        return self._scalar(node)

    def _mapping(self, node: MappingNode, location: Location) -> dict[str, Any]:
        result: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for key_node, child in cast("list[tuple[Node, Node]]", node.value):
            if not isinstance(key_node, ScalarNode):
                self._fault(key_node, "a key must be a plain word", "use a name")
                continue
            key = str(key_node.value)
            if self._foreign:
                result[key] = self.value(child, (*location, key))
                self.places.setdefault((*location, key), _mark(key_node))
                continue
            if self._follows_mark(key_node):
                # YAML takes the mark as its own in `{?L_hip: 1}`, and the key is `L_hip`.
                message = f"a key that begins with `?` is read by YAML as {key[:40]!r}"
                self._fault(key_node, message, f'put it in quotes: "?{key[:40]}"')
                continue
            if not is_key(key):
                self._fault(key_node, f"{key[:40]!r}... is not a key", "use a short printable name")
                continue
            if key in result:
                message = f"duplicate key {key!r}, first on line {lines[key]}"
                self._fault(key_node, message, "keep one of them")
                continue
            lines[key] = key_node.start_mark.line + 1
            self.places[*location, key] = _mark(key_node)
            result[key] = self.value(child, (*location, key))
        return result

    def _follows_mark(self, node: ScalarNode) -> bool:
        """Whether a `?` stands right before a key."""
        mark = node.start_mark
        before = self._lines[mark.line][: mark.column] if mark.line < len(self._lines) else ""
        return before.endswith("?")

    def _scalar(self, node: Node) -> Any:
        if node.tag not in _PLAIN_TAGS:
            return str(node.value)
        try:
            return self._yaml.constructor.construct_object(node)
        except (YAMLError, ValueError):
            self._fault(node, f"{node.value!r} does not fit its tag", "put it in quotes")
            return None


def _mark(node: Node) -> Place:
    return node.start_mark.line + 1, node.start_mark.column + 1


def validation_problems(
    error: ValidationError,
    file: YamlFile,
    model: type[BaseModel],
    *,
    also: Mapping[str, str] | None = None,
) -> list[Problem]:
    """Turn pydantic's errors into Problems in file order, with the nearest valid name.

    `model` is the class that was validated; its field names (aliases) are the valid keys. `also`
    says what else people call keys: the valid one by the other name.
    Validators may raise `ValueError("what is wrong; what to do")`: both parts are kept.
    """
    problems: list[tuple[Location, Problem]] = []
    alternatives: dict[Location, list[str]] = {}
    for detail in error.errors():
        location = file.known(detail["loc"])
        name = ".".join(str(part) for part in location)
        message, fix = _explain(detail)
        match detail["type"]:
            case "extra_forbidden":
                message = f"unknown key {detail['loc'][-1]!r}"
                key, keys = str(detail["loc"][-1]), _keys_at(model, detail["loc"][:-1])
                called = (also or {}).get(key)
                fix = f"here it is {called!r}" if called in keys else nearest(key, keys)
            case "missing":
                missing = detail["loc"][-1]
                message = f"{name}: {missing!r} is missing" if name else f"{missing!r} is missing"
                fix = "add it"
            case "value_error":
                message = f"{name}: {message}" if name else message
            case _:
                alternatives.setdefault(location, []).append(message)
                message = f"{name}: {message}" if name else message
        problems.append((location, file.problem(location, message, fix)))
    return _without_echoes(problems, file, alternatives)


def _without_echoes(
    problems: list[tuple[Location, Problem]],
    file: YamlFile,
    alternatives: dict[Location, list[str]],
) -> list[Problem]:
    """Merge what pydantic says once for each branch of a union into one problem, in file order."""
    kept: dict[tuple[int, int, str], Problem] = {}
    for location, problem in problems:
        messages = alternatives.get(location, [])
        if messages and any(other[: len(location)] == location != other for other in alternatives):
            continue  # A longer location says it more precisely.
        if len(messages) > 1:
            name = ".".join(str(part) for part in location)
            merged = file.problem(location, f"{name}: {_either(messages)}")
            kept[problem.line, problem.column, "merged"] = merged
        else:
            kept[problem.line, problem.column, problem.message] = problem
    return [kept[key] for key in sorted(kept)]


def _either(messages: Sequence[str]) -> str:
    """Join what was expected instead, and say what was given only once."""
    split = [message.rpartition(", got ") for message in dict.fromkeys(messages)]
    values = {got for _, _, got in split}
    if len(values) > 1 or not all(expected for expected, _, _ in split):
        return ", or ".join(dict.fromkeys(messages))
    return f"{', or '.join(expected for expected, _, _ in split)}, got {values.pop()}"


def _explain(detail: ErrorDetails) -> tuple[str, str | None]:
    """Return what is wrong with a value, and the fix if one is known."""
    kind, message, value = detail["type"], detail["msg"], detail["input"]
    context = detail.get("ctx", {})
    shown = _short(value)
    if kind == "value_error":
        text, _, fix = str(context["error"]).partition("; ")
        return text, fix or None
    if kind == "too_long":
        return f"has {context['actual_length']} values, at most {context['max_length']} fit", None
    if kind == "too_short" and not value:
        return "is empty", "name at least one"
    if kind in {"literal_error", "enum"}:
        known = [word.strip(" '") for word in str(context["expected"]).split(" or ")]
        known = [word.strip(" '") for part in known for word in part.split(", ")]
        return f"{shown} is not one of them", nearest(str(value), known)
    if kind == "union_tag_invalid":
        known = str(context["expected_tags"]).replace("'", "").split(", ")
        return f"{context['tag']!r} is not known", nearest(str(context["tag"]), known)
    text = explain_limit(detail) or _WORDS.get(kind) or message.removeprefix("Input ")
    return f"{text[0].lower()}{text[1:]}, got {shown}", None


def explain_limit(detail: Mapping[str, Any]) -> str | None:
    """Return the limit that a number breaks, such as `must be at least 1`; None = another error."""
    words = _LIMITS.get(detail["type"])
    return None if words is None else f"must be {words[1]} {detail['ctx'][words[0]]:g}"


def _short(value: Any, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _keys_at(model: type[BaseModel], location: Sequence[str | int]) -> set[str]:
    """Return the keys that are valid in the mapping at a location of a model."""
    models = [model]
    for part in location:
        step = [
            inner
            for current in models
            for key, field in current.model_fields.items()
            if part in {key, field.alias}
            for inner in _models_in(field.annotation)
        ]
        tagged = [current for current in models if _is_tag(part, current)]
        # Indices and keys of free mappings stay among the same models.
        models = step or tagged or models
    keys = {field.alias or key for current in models for key, field in current.model_fields.items()}
    # A model may take keys that are no fields, and name them.
    return keys.union(*(getattr(current, "other_keys", set[str])() for current in models))


def _is_tag(part: str | int, model: type[BaseModel]) -> bool:
    """Say whether pydantic uses `part` as the name of this model among those of a union."""
    return any(
        typing.get_origin(field.annotation) is typing.Literal
        and part in typing.get_args(field.annotation)
        for field in model.model_fields.values()
    )


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif typing.get_origin(annotation) is not None or isinstance(annotation, types.UnionType):
        for inner in typing.get_args(annotation):
            yield from _models_in(inner)


def json_schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a model, described by its docstrings."""
    return model.model_json_schema(by_alias=True, schema_generator=_Described)


class _Described(GenerateJsonSchema):
    """Describes properties by the docstrings under the fields.

    Pydantic's own `use_attribute_docstrings` reads the sources whenever the classes are imported,
    which adds a third to the time in which a first card is read; here it is done on demand.
    """

    def model_schema(self, schema: core_schema.ModelSchema) -> dict[str, Any]:
        result = super().model_schema(schema)
        model: type[BaseModel] = schema["cls"]
        docstrings = _field_docstrings(model)
        for name, field in model.model_fields.items():
            key = result["properties"][field.alias or name]
            if name in docstrings:
                key["description"] = docstrings[name]
            elif "const" in key:  # `term: ang_vel` means what its class is.
                key["description"] = result["description"]
        return result


def _field_docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Return the strings that stand under the fields of a model and its bases, by name."""
    docstrings: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if cls is BaseModel or not issubclass(cls, BaseModel):
            continue
        (body,) = ast.parse(inspect.getsource(cls)).body
        assert isinstance(body, ast.ClassDef), "the source of a class is one statement"
        for field, note in pairwise(body.body):
            match field, note:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    docstrings[name] = inspect.cleandoc(text)
                case _:
                    pass
    return docstrings
