"""TorchScript's language: what a stranger's script may say, and the same script written anew.

A script keeps its code as text that looks like Python. Torch compiles it with a reader of its own,
which knows more than its writer ever writes: any operator of any loaded library, methods that run
while the file is opened, names that stand for such operators. Here the text is read as Python, each
of its parts must be one that torch's own writer makes, and only what was read is written, so that
torch never sees a byte that was not understood. (That writer: torch/csrc/jit/serialization/
python_print.cpp.) What a script would print or warn is left out; what it computes is not.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Mapping

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.limits import FileLimits
from nw_eval.policies.safety.torchscript.body import FunctionBody
from nw_eval.policies.safety.torchscript.words import (
    PLAIN,
    Definitions,
    Kind,
    RefusedError,
    Types,
    identifier,
    literal,
    short,
    string,
)

_LISTS = frozenset({"__buffers__", "__forward_hooks__", "__forward_pre_hooks__", "__parameters__"})


def rewrite(
    members: Mapping[str, bytes], where: str, limits: FileLimits
) -> tuple[dict[str, str], Definitions]:
    """Check a script and write it anew.

    Args:
        members: its files by their names in the archive, `code/__torch__/....py`.
        where: path of the archive, for errors.
        limits: bounds on the text, checked before it is read.

    Returns:
        The files as they may be compiled, and what they define.

    Raises:
        PolicyError: a part is none that torch writes for a network, or an operator is not allowed;
            the error names file and line.
    """
    size = sum(map(len, members.values()))
    if size > limits.code_bytes:
        raise PolicyError(
            f"{where}: its code has {size} bytes, over the limit of {limits.code_bytes}", fix=PLAIN
        )
    trees = {name: _parsed(name, text, where, limits) for name, text in members.items()}
    known = _definitions(trees)
    texts: dict[str, str] = {}
    for name, tree in trees.items():
        try:
            texts[name] = "".join(_definition(part, known) for part in tree.body)
        except RefusedError as error:
            raise _refusal(where, name, error.line, str(error), error.fix) from None
        except RecursionError:
            raise _refusal(where, name, 1, "it is nested too deeply", PLAIN) from None
    return texts, known


def check_type(text: str, known: Definitions, where: str) -> None:
    """Check a type that stands outside of the code.

    Raises:
        PolicyError: it is none of a network's.
    """
    try:
        Types(known).text(ast.parse(text, mode="eval").body)
    except (RefusedError, SyntaxError, ValueError, MemoryError, RecursionError):
        raise PolicyError(
            f"{where}: it has a list or dict of the type `{short(text)}`", fix=PLAIN
        ) from None


def _refusal(where: str, name: str, line: int, what: str, fix: str) -> PolicyError:
    return PolicyError(f"{where}: the script {clean(name, at_most=200)}:{line}: {what}", fix=fix)


def _parsed(name: str, raw: bytes, where: str, limits: FileLimits) -> ast.Module:
    try:
        text = raw.decode("ascii")
        if _depth(text) > limits.depth:
            raise _refusal(where, name, 1, "its brackets are nested too deeply", PLAIN)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of strings whose escapes Python finds odd.
            return ast.parse(text)
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        line = getattr(error, "lineno", None) or 1
        reason = clean(getattr(error, "msg", None) or error, at_most=100)
        raise _refusal(where, name, line, f"it is not TorchScript: {reason}", PLAIN) from None


def _depth(text: str) -> int:
    """Return how deeply brackets are nested; those in strings count too, which does no harm."""
    depth = deepest = 0
    for character in text:
        if character in "([{":
            depth += 1
            deepest = max(deepest, depth)
        elif character in ")]}":
            depth -= 1
    return deepest


def _definitions(trees: Mapping[str, ast.Module]) -> Definitions:
    kinds: dict[str, Kind] = {}
    methods: set[str] = set()
    for name, tree in trees.items():
        module = name.removeprefix("code/").removesuffix(".py").replace("/", ".")
        for part in tree.body:
            if isinstance(part, ast.FunctionDef):
                kinds[f"{module}.{part.name}"] = "function"
            elif isinstance(part, ast.ClassDef):
                bases = [base.id for base in part.bases if isinstance(base, ast.Name)]
                kinds[f"{module}.{part.name}"] = "tuple" if "NamedTuple" in bases else "class"
                methods |= {m.name for m in part.body if isinstance(m, ast.FunctionDef)}
    return Definitions(kinds=kinds, methods=frozenset(methods))


def _definition(part: ast.stmt, known: Definitions) -> str:
    """Write a class or function at the margin of a file."""
    if isinstance(part, ast.FunctionDef):
        return _function(part, known, "")
    if not isinstance(part, ast.ClassDef):
        raise RefusedError(part, f"it has a {type(part).__name__} outside of classes")
    bases = [identifier(base) for base in part.bases]
    if part.decorator_list or part.keywords or bases not in ([], ["Module"], ["NamedTuple"]):
        raise RefusedError(part, f"the class {part.name!r} is not a module")
    head = f"class {part.name}({bases[0]}):\n" if bases else f"class {part.name}:\n"
    return head + "".join(_attribute(line, known) for line in part.body)


def _attribute(line: ast.stmt, known: Definitions) -> str:
    """Write a line of a class: an attribute and its type, a constant, names, a method."""
    types = Types(known)
    match line:
        case ast.Pass():
            return "  pass\n"
        case ast.FunctionDef(name="__setstate__"):
            raise RefusedError(
                line,
                "it defines `__setstate__`, which would run while the file is opened",
                "export a module without it, and without quantised parts",
            )
        case ast.FunctionDef():
            return _function(line, known, "  ")
        case ast.AnnAssign(target=ast.Name(id=name), annotation=kind, value=None):
            return f"  {name} : {types.text(kind)}\n"
        case ast.AnnAssign(target=ast.Name(id=name), annotation=kind, value=ast.expr() as value):
            return f"  {name} : {types.text(kind)} = {literal(value)}\n"
        case ast.Assign(targets=[ast.Name(id="__annotations__")], value=ast.List(elts=[])):
            return "  __annotations__ = []\n"
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.List(elts=names)) if name in _LISTS:
            return f"  {name} = [{', '.join(string(part) for part in names)}]\n"
        case ast.Assign(
            targets=[ast.Subscript(value=ast.Name(id="__annotations__"), slice=key)], value=kind
        ):
            return f"  __annotations__[{string(key)}] = {types.text(kind)}\n"
        case _:
            raise RefusedError(line, f"a class has a {type(line).__name__} that torch never writes")


def _function(part: ast.FunctionDef, known: Definitions, indent: str) -> str:
    declared = part.args
    if (
        part.decorator_list
        or declared.posonlyargs
        or declared.kwonlyargs
        or declared.vararg
        or declared.kwarg
    ):
        raise RefusedError(
            part, f"the function {part.name!r} has arguments that torch never writes"
        )
    types = Types(known)
    defaults = [None] * (len(declared.args) - len(declared.defaults)) + list(declared.defaults)
    written: list[str] = []
    for argument, default in zip(declared.args, defaults, strict=True):
        kind = f": {types.text(argument.annotation)}" if argument.annotation else ""
        written.append(argument.arg + kind + (f"={literal(default)}" if default else ""))
    returns = f" -> {types.text(part.returns)}" if part.returns else ""
    body = FunctionBody(part, known).lines(part.body, indent + "  ")
    return f"{indent}def {part.name}({', '.join(written)}){returns}:\n{body}"
