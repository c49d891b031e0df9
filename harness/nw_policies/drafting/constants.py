"""Constants of the text of Python files: what lines of a class come to, without running them.

Numbers, texts, lists and mappings of them, arithmetic, names of the same class, and loops over
lists, ranges and pairs of both. Everything else is `UNKNOWN`, and so is what grows too large.
"""

from __future__ import annotations

import ast
from collections import ChainMap
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard, cast

UNKNOWN = object()
"""In place of a value that is not a constant."""
_MOST = 100
"""Entries of a list that is repeated, letters of a text, and turns of a loop."""
_DEEPEST = 2
"""Loops in a loop, that one included."""
_LARGEST = 1e12
"""Of a number; what is larger is not one of a policy's."""


def follow_settings(
    line: ast.stmt,
    values: dict[str, Any],
    outer: Mapping[str, Any] | None = None,
    *,
    depth: int = 0,
) -> None:
    """Do to the names of a class what an assignment, or a loop of them, does.

    Args:
        line: of the class.
        values: what its names hold; changed.
        outer: what names outside of the class hold.
        depth: loops round the line.
    """
    names: Mapping[str, Any] = values if outer is None else ChainMap(values, cast("Any", outer))
    match line:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=items)):
            for target, item in zip(targets, items, strict=False):
                _assign(target, constant(item, names), values)
        case ast.Assign(targets=targets, value=value):
            for target in targets:
                _assign(target, constant(value, names), values)
        case ast.AnnAssign(target=target, value=ast.expr() as value):
            _assign(target, constant(value, names), values)
        case ast.For(target=target, iter=items, body=body) if depth < _DEEPEST:
            for turn in _turns(items, names)[:_MOST]:
                _assign(target, turn, values)
                for inner in body:
                    follow_settings(inner, values, outer, depth=depth + 1)
        case _:
            pass


def _assign(target: ast.expr, value: Any, values: dict[str, Any]) -> None:
    match target:
        case ast.Name(id=name):
            values.pop(name, None)
            if value is not UNKNOWN:
                values[name] = value
        case ast.Tuple(elts=targets) if isinstance(value, list):
            for one, part in zip(targets, cast("list[Any]", value), strict=False):
                _assign(one, part, values)
        case ast.Subscript(value=ast.Name(id=name), slice=key):
            held, word = values.get(name), constant(key, values)
            if isinstance(held, dict) and isinstance(word, str) and value is not UNKNOWN:
                # Not in place: a class may have the mapping from another.
                values[name] = {**cast("dict[str, Any]", held), word: value}
        case _:
            pass


def _turns(node: ast.expr, names: Mapping[str, Any]) -> list[Any]:
    """Return what a loop goes through; nothing where that is unknown."""
    match node:
        case ast.Call(func=ast.Name(id="range"), args=args):
            bounds = [constant(arg, names) for arg in args]
            if all(type(bound) is int for bound in bounds) and 1 <= len(bounds) <= 2:
                return list(range(*bounds)[:_MOST])
            return []
        case ast.Call(func=ast.Name(id="zip"), args=args):
            return [list(turn) for turn in zip(*(_turns(arg, names) for arg in args), strict=False)]
        case ast.Call(func=ast.Name(id="enumerate"), args=[arg]):
            return [[number, turn] for number, turn in enumerate(_turns(arg, names))]
        case _:
            value = constant(node, names)
            return list(cast("list[Any]", value)) if isinstance(value, list | str) else []


def constant(node: ast.expr, names: Mapping[str, Any]) -> Any:
    """Return what an expression of constants is, or `UNKNOWN`.

    Args:
        node: of the tree of a file.
        names: what is known so far of the same class.
    """
    match node:
        case ast.Constant(value=value):
            is_odd = isinstance(value, int | float) and not is_number(value + 0)
            return UNKNOWN if is_odd else value
        case ast.Name(id=name):
            return names.get(name, UNKNOWN)
        case ast.Attribute(value=base, attr=name):
            inner = constant(base, names)
            return inner.get(name, UNKNOWN) if isinstance(inner, dict) else UNKNOWN
        case ast.List(elts=items) | ast.Tuple(elts=items):
            values = [constant(item, names) for item in items]
            return UNKNOWN if UNKNOWN in values else values
        case ast.Dict(keys=keys, values=items):
            pairs = [
                (constant(key, names), constant(item, names))
                for key, item in zip(keys, items, strict=True)
                if key is not None
            ]
            return {k: v for k, v in pairs if isinstance(k, str) and v is not UNKNOWN}
        case ast.JoinedStr(values=parts):
            return _joined(parts, names)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _negated(constant(operand, names))
        case ast.Call():
            return _called(node, names)
        case ast.BinOp(left=left, op=op, right=right):
            return _computed(constant(left, names), op, constant(right, names))
        case _:
            return UNKNOWN


def _called(node: ast.Call, names: Mapping[str, Any]) -> Any:
    """Return what a conversion of a number, or the making of settings, comes to."""
    match node:
        case ast.Call(func=ast.Name(id="int" | "float" | "round" as kind), args=[inner]):
            return _cast(kind, constant(inner, names))
        case ast.Call(func=ast.Attribute(attr="array" | "tensor"), args=[ast.List() as listed, *_]):
            return constant(listed, names)
        case ast.Call(func=func, args=[], keywords=[_, *_] as keywords):
            return _made(func, keywords, names)
        case ast.Call(func=ast.Name(id=name), args=[]):
            made = names.get(name)
            return cast("dict[str, Any]", made) if isinstance(made, dict) else UNKNOWN
        case _:
            return UNKNOWN


def _made(
    func: ast.expr, keywords: Sequence[ast.keyword], names: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings of `Class(key=value, ...)`: its own, before those of the class.

    What is no constant is left out.
    """
    own = names.get(func.id) if isinstance(func, ast.Name) else None
    values = {word.arg: constant(word.value, names) for word in keywords if word.arg}
    known = {key: value for key, value in values.items() if value is not UNKNOWN}
    inherited = cast("dict[str, Any]", own) if isinstance(own, dict) else {}
    return {**{key: one for key, one in inherited.items() if key not in values}, **known}


def _joined(parts: Sequence[ast.expr], names: Mapping[str, Any]) -> Any:
    """Return the text of an f-string."""
    texts = [
        constant(part.value if isinstance(part, ast.FormattedValue) else part, names)
        for part in parts
    ]
    known = all(isinstance(text, str | bool) or type(text) is int for text in texts)
    return "".join(map(str, texts))[:_MOST] if known else UNKNOWN


def _cast(kind: str, value: Any) -> Any:
    if not is_number(value):
        return UNKNOWN
    return float(value) if kind == "float" else int(value)


def _negated(value: Any) -> Any:
    return -value if is_number(value) else UNKNOWN


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether a value is a finite number of a usual size, and not a truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _computed(left: Any, op: ast.operator, right: Any) -> Any:
    if isinstance(left, list) and isinstance(op, ast.Mult) and isinstance(right, int):
        items = cast("list[Any]", left)
        return items * right if len(items) * max(right, 0) <= _MOST else UNKNOWN
    if not is_number(left) or not is_number(right):
        return UNKNOWN
    match op:
        case ast.Add():
            value = left + right
        case ast.Sub():
            value = left - right
        case ast.Mult():
            value = left * right
        case ast.Div() if right:
            value = left / right
        case ast.FloorDiv() if right:
            value = left // right
        case ast.Pow() if 0 < left <= 10 and 0 <= right <= 30:
            value = left**right
        case _:
            return UNKNOWN
    return value if is_number(value) else UNKNOWN
