"""The words of TorchScript's language: names, plain values and types, each written anew."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from nw_eval.clean import clean

PLAIN = "export the plain network: layers and arithmetic, without custom classes or operators"
"""What to do about a script that says something else."""

_NAMES_OF_TYPES = """
    Any Device Dict Final List NoneType Optional Tensor Tuple Union bool complex float int number
    str
"""
_TYPES = frozenset(_NAMES_OF_TYPES.split())
Kind = Literal["class", "tuple", "function"]


class RefusedError(Exception):
    """A part that no script of a network has; the first argument says what it is."""

    def __init__(self, node: ast.AST | None, what: str, fix: str = PLAIN) -> None:
        super().__init__(what)
        self.line = getattr(node, "lineno", 1)
        self.fix = fix


@dataclass(frozen=True, kw_only=True)
class Definitions:
    """What a script defines."""

    kinds: Mapping[str, Kind]
    """Classes, named tuples and functions by their full names."""
    methods: frozenset[str]
    """Names of all methods."""


@dataclass(frozen=True)
class Types:
    """Types, as annotations and as arguments of `annotate` and its kind."""

    known: Definitions

    def text(self, node: ast.expr | None) -> str:
        """Write a type."""
        match node:
            case ast.Name(id=name) if name in _TYPES:
                return name
            case ast.Constant(value=None):
                return "None"
            case ast.Attribute():
                name = dotted(node)
                if self.known.kinds.get(name) not in {"class", "tuple"}:
                    raise RefusedError(node, f"the class `{short(name)}` is not in the file")
                return name
            case ast.Subscript(value=ast.Name(id=name), slice=inner) if name in _TYPES:
                parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
                return f"{name}[{', '.join(self.text(part) for part in parts) or '()'}]"
            case _:
                shown = short(ast.unparse(node)) if node is not None else "nothing"
                raise RefusedError(node, f"`{shown}` is not a type that networks use")


def dotted(node: ast.expr | None) -> str:
    """Return `a.b.c` for names and attributes of names; "" for all else."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return ""
    return ".".join([node.id, *reversed(parts)])


def identifier(node: ast.expr) -> str:
    """Write a name."""
    if not isinstance(node, ast.Name):
        raise RefusedError(node, f"`{short(ast.unparse(node))}` stands in place of a name")
    return node.id


def literal(node: ast.expr) -> str:
    """Write a plain value: None, a bool, a number, a string, or a list, tuple or dict of them."""
    match node:
        case ast.Constant(value=str()):
            return string(node)
        case ast.Constant(value=None | bool() | int() | float() as value):
            return repr(value)
        case ast.Name(id="inf" | "nan" as name):
            return name
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as value)):
            return f"-{value!r}"
        case ast.UnaryOp(op=ast.USub(), operand=ast.Name(id="inf" | "nan" as name)):
            return f"-{name}"
        case ast.List(elts=parts):
            return f"[{', '.join(map(literal, parts))}]"
        case ast.Tuple(elts=parts):
            return f"({', '.join(map(literal, parts))}{',' * (len(parts) == 1)})"
        case ast.Attribute() if (name := dotted(node)).startswith("CONSTANTS.c"):
            return name
        case _:
            raise RefusedError(node, f"`{short(ast.unparse(node))}` is not a plain value")


def string(node: ast.expr) -> str:
    """Write a string as torch writes it: its reader knows octal escapes, and no others for all."""
    if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
        raise RefusedError(node, f"`{short(ast.unparse(node))}` stands in place of a string")
    if any(ord(character) > 255 for character in node.value):
        raise RefusedError(node, "it has a string that torch never writes")
    return '"' + "".join(map(_character, node.value)) + '"'


def _character(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if " " <= character <= "~" else f"\\{ord(character):03o}"


def short(text: str) -> str:
    """Return a part of a script as an error shows it."""
    return clean(text, at_most=80)
