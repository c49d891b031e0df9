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
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.limits import Limits
from nw_eval.policies.safety.operators import (
    NEVER_RUN,
    PRIM_OPERATORS,
    SCRIPT_OPERATORS,
    may_run,
)

GUARDS = "__torch__.nw_eval.policies.safety.guards"
"""Where the functions of `guards` lie in a script."""
_GUARDED = frozenset(
    """
    gru gru_cell lstm lstm_cell scaled_dot_product_attention _native_batch_norm_legit_no_training
    _scaled_dot_product_flash_attention_for_cpu
    """.split()
)
_PACKED = {
    "lstm": "never_three",
    "gru": "never_two",
    "rnn_relu": "never_two",
    "rnn_tanh": "never_two",
}
"""Recurrent layers to what stands for their second form, that for packed sequences."""

_PLAIN = "export the plain network: layers and arithmetic, without custom classes or operators"
_TYPES = frozenset(
    "Any Device Dict Final List NoneType Optional Tensor Tuple Union bool complex float int number "
    "str".split()
)
_RESERVED = frozenset(
    "CONSTANTS __torch__ annotate fork getattr inf infj isinstance nan nanj ops print range torch "
    "unchecked_cast uninitialized".split()
)
"""Names that mean something of their own, and may stand where the writer puts them only."""
_CASTS = frozenset({"bool", "float", "int", "sorted", "str"})
_LISTS = frozenset({"__buffers__", "__forward_hooks__", "__forward_pre_hooks__", "__parameters__"})
_AT_LOAD = frozenset({"__getstate__", "__setstate__"})
_Kind = Literal["class", "tuple", "function"]


@dataclass(frozen=True, kw_only=True)
class Definitions:
    """What a script defines."""

    kinds: Mapping[str, _Kind]
    """Classes, named tuples and functions by their full names."""
    methods: frozenset[str]
    """Names of all methods."""


class _RefusedError(Exception):
    """A part that no script of a network has; the first argument says what it is."""

    def __init__(self, node: ast.AST | None, what: str, fix: str = _PLAIN) -> None:
        super().__init__(what)
        self.line = getattr(node, "lineno", 1)
        self.fix = fix


def rewrite(
    members: Mapping[str, bytes], where: str, limits: Limits
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
    trees = {name: _parsed(name, text, where, limits) for name, text in members.items()}
    known = _definitions(trees)
    texts: dict[str, str] = {}
    for name, tree in trees.items():
        try:
            texts[name] = "".join(_definition(part, known) for part in tree.body)
        except _RefusedError as error:
            raise _refusal(where, name, error.line, str(error), error.fix) from None
        except RecursionError:
            raise _refusal(where, name, 1, "it is nested too deeply", _PLAIN) from None
    return texts, known


def check_type(text: str, known: Definitions, where: str) -> None:
    """Check a type that stands outside of the code.

    Raises:
        PolicyError: it is none of a network's.
    """
    try:
        _Types(known).text(ast.parse(text, mode="eval").body)
    except (_RefusedError, SyntaxError, ValueError, MemoryError, RecursionError):
        raise PolicyError(
            f"{where}: it has a list or dict of the type `{_short(text)}`", fix=_PLAIN
        ) from None


def _refusal(where: str, name: str, line: int, what: str, fix: str) -> PolicyError:
    return PolicyError(f"{where}: the script {clean(name, at_most=200)}:{line}: {what}", fix=fix)


def _parsed(name: str, raw: bytes, where: str, limits: Limits) -> ast.Module:
    if len(raw) > limits.code_bytes:
        raise _refusal(where, name, 1, f"it has {len(raw)} bytes, over the limit", _PLAIN)
    try:
        text = raw.decode("ascii")
        if _depth(text) > limits.depth:
            raise _refusal(where, name, 1, "its brackets are nested too deeply", _PLAIN)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Of strings whose escapes Python finds odd.
            return ast.parse(text)
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        line = getattr(error, "lineno", None) or 1
        reason = clean(getattr(error, "msg", None) or error, at_most=100)
        raise _refusal(where, name, line, f"it is no TorchScript: {reason}", _PLAIN) from None


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
    kinds: dict[str, _Kind] = {}
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
        raise _RefusedError(part, f"it has a {type(part).__name__} outside of classes")
    bases = [_identifier(base) for base in part.bases]
    if part.decorator_list or part.keywords or bases not in ([], ["Module"], ["NamedTuple"]):
        raise _RefusedError(part, f"the class {part.name!r} is no module")
    head = f"class {part.name}({bases[0]}):\n" if bases else f"class {part.name}:\n"
    return head + "".join(_attribute(line, known) for line in part.body)


def _attribute(line: ast.stmt, known: Definitions) -> str:
    """Write a line of a class: an attribute with its type, a constant, a list of names, a method.
    """
    types = _Types(known)
    match line:
        case ast.Pass():
            return "  pass\n"
        case ast.FunctionDef(name=name) if name in _AT_LOAD:
            raise _RefusedError(
                line,
                f"it defines `{name}`, which would run while the file is opened",
                "export a module without it, and without quantised parts",
            )
        case ast.FunctionDef():
            return _function(line, known, "  ")
        case ast.AnnAssign(target=ast.Name(id=name), annotation=kind, value=None):
            return f"  {name} : {types.text(kind)}\n"
        case ast.AnnAssign(target=ast.Name(id=name), annotation=kind, value=ast.expr() as value):
            return f"  {name} : {types.text(kind)} = {_literal(value)}\n"
        case ast.Assign(targets=[ast.Name(id="__annotations__")], value=ast.List(elts=[])):
            return "  __annotations__ = []\n"
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.List(elts=names)) if name in _LISTS:
            return f"  {name} = [{', '.join(_string(part) for part in names)}]\n"
        case ast.Assign(
            targets=[ast.Subscript(value=ast.Name(id="__annotations__"), slice=key)], value=kind
        ):
            return f"  __annotations__[{_string(key)}] = {types.text(kind)}\n"
        case _:
            raise _RefusedError(line, f"a class has a {type(line).__name__} that torch never writes")


def _function(part: ast.FunctionDef, known: Definitions, indent: str) -> str:
    given = part.args
    if part.decorator_list or given.posonlyargs or given.kwonlyargs or given.vararg or given.kwarg:
        raise _RefusedError(part, f"the function {part.name!r} has arguments that torch never writes")
    types = _Types(known)
    defaults = [None] * (len(given.args) - len(given.defaults)) + list(given.defaults)
    written: list[str] = []
    for argument, default in zip(given.args, defaults, strict=True):
        kind = f": {types.text(argument.annotation)}" if argument.annotation else ""
        written.append(argument.arg + kind + (f"={_literal(default)}" if default else ""))
    returns = f" -> {types.text(part.returns)}" if part.returns else ""
    body = _Body(part, known).lines(part.body, indent + "  ")
    return f"{indent}def {part.name}({', '.join(written)}){returns}:\n{body}"


@dataclass(frozen=True)
class _Types:
    """Types, as annotations and as arguments of `annotate` and its kind."""

    known: Definitions

    def text(self, node: ast.expr | None) -> str:
        match node:
            case ast.Name(id=name) if name in _TYPES:
                return name
            case ast.Constant(value=None):
                return "None"
            case ast.Attribute():
                name = _dotted(node)
                if self.known.kinds.get(name) not in {"class", "tuple"}:
                    raise _RefusedError(node, f"the class `{_short(name)}` is not in the file")
                return name
            case ast.Subscript(value=ast.Name(id=name), slice=inner) if name in _TYPES:
                parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
                return f"{name}[{', '.join(self.text(part) for part in parts) or '()'}]"
            case _:
                shown = _short(ast.unparse(node)) if node is not None else "nothing"
                raise _RefusedError(node, f"`{shown}` is no type of a network's")


class _Body:
    """The statements of one function."""

    def __init__(self, function: ast.FunctionDef, known: Definitions) -> None:
        self.known = known
        self.types = _Types(known)
        arguments = [argument.arg for argument in function.args.args]
        stores = Counter(arguments)
        aliases: list[str] = []
        for node in ast.walk(function):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                stores[node.id] += 1
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=ast.Attribute() as value):
                    if known.kinds.get(_dotted(value)) == "function":
                        aliases.append(name)
                case _:
                    pass
        if taken := _RESERVED.intersection(stores):
            raise _RefusedError(function, f"it gives the name `{min(taken)}` another meaning")
        if double := [name for name in aliases if stores[name] > 1]:
            raise _RefusedError(function, f"`{double[0]}` is a function and something else")
        self.names = frozenset(stores)
        self.functions = frozenset(aliases)

    def lines(self, statements: Iterable[ast.stmt], indent: str) -> str:
        return "".join(indent + self.line(part, indent) for part in statements)

    def line(self, part: ast.stmt, indent: str) -> str:
        inner = indent + "  "
        match part:
            case ast.Pass():
                return "pass\n"
            case ast.Return(value=ast.expr() as value):
                return f"return {self.text(value)}\n"
            case ast.Expr(value=ast.Call(func=func, args=args) as call):
                if _dotted(func) in {"print", "torch.warn"}:
                    # Left out, but for what its arguments do to tensors.
                    return f"({', '.join(map(self.text, args))},)\n" if args else "pass\n"
                return f"{self.text(call)}\n"
            case ast.Assign(targets=[target], value=value):
                return f"{self.target(target)} = {self.text(value)}\n"
            case ast.AnnAssign(target=ast.Name(id=name), annotation=kind, value=ast.expr() as value):
                return f"{name} : {self.types.text(kind)} = {self.text(value)}\n"
            case ast.If(test=test, body=body, orelse=other):
                text = f"if {self.text(test)}:\n{self.lines(body, inner)}"
                return text + (f"{indent}else:\n{self.lines(other, inner)}" if other else "")
            case ast.While(test=test, body=body, orelse=[]):
                return f"while {self.text(test)}:\n{self.lines(body, inner)}"
            case ast.For(
                target=ast.Name(id=name),
                iter=ast.Call(func=ast.Name(id="range"), args=[count], keywords=[]),
                body=body,
                orelse=[],
            ):
                return f"for {name} in range({self.text(count)}):\n{self.lines(body, inner)}"
            case ast.With(items=[item], body=body):
                name = f" as {_identifier(item.optional_vars)}" if item.optional_vars else ""
                return f"with {self.text(item.context_expr)}{name}:\n{self.lines(body, inner)}"
            case _:
                kind = type(part).__name__
                raise _RefusedError(part, f"it has a statement {kind} that torch never writes")

    def target(self, node: ast.expr) -> str:
        match node:
            case ast.Name(id=name):
                return name
            case ast.Tuple(elts=parts) if parts:
                return "".join(f"{_identifier(part)}, " for part in parts)
            case ast.Attribute(value=value, attr=name):
                return f"{self.base(value)}.{name}"
            case _:
                raise _RefusedError(node, f"it assigns to `{_short(ast.unparse(node))}`")

    def text(self, node: ast.expr) -> str:
        """Write an expression."""
        match node:
            case ast.Constant() | ast.UnaryOp():
                return _literal(node)
            case ast.Name(id="inf" | "nan" as name):
                return name
            case ast.Name(id=name) if name in self.names and name not in self.functions:
                return name
            case ast.List(elts=parts):
                return f"[{', '.join(map(self.text, parts))}]"
            case ast.Tuple(elts=parts):
                return f"({', '.join(map(self.text, parts))}{',' * (len(parts) == 1)})"
            case ast.Dict(keys=keys, values=values):
                if None in keys:
                    raise _RefusedError(node, "it unpacks a dict")
                pairs = zip((k for k in keys if k), values, strict=True)
                return "{" + ", ".join(f"{self.text(k)}: {self.text(v)}" for k, v in pairs) + "}"
            case ast.Subscript(value=value, slice=ast.Slice(lower=low, upper=high, step=None)):
                ends = (self.text(end) if end else "" for end in (low, high))
                return f"{self.base(value)}[{':'.join(ends)}]"
            case ast.Subscript(value=value, slice=key):
                return f"{self.base(value)}[{self.text(key)}]"
            case ast.Attribute():
                return self.attribute(node)
            case ast.Call():
                return self.call(node)
            case _:
                raise _RefusedError(node, f"`{_short(ast.unparse(node))}` is not TorchScript's")

    def base(self, node: ast.expr) -> str:
        text = self.text(node)
        return text if isinstance(node, ast.Name) else f"({text})"

    def attribute(self, node: ast.Attribute) -> str:
        name = _dotted(node)
        root, _, rest = name.partition(".")
        if root == "CONSTANTS" and rest.startswith("c") and rest[1:].isdigit():
            return name
        if self.known.kinds.get(name) == "function":
            return name
        return f"{self.base(node.value)}.{node.attr}"

    def call(self, node: ast.Call) -> str:
        name = _dotted(node.func)
        match node:
            case ast.Call(func=ast.Name(id="annotate" | "unchecked_cast"), args=[kind, value]):
                return f"{name}({self.types.text(kind)}, {self.text(value)})"
            case ast.Call(func=ast.Name(id="uninitialized"), args=[kind], keywords=[]):
                return f"uninitialized({self.types.text(kind)})"
            case ast.Call(func=ast.Name(id="isinstance"), args=[value, kinds], keywords=[]):
                many = isinstance(kinds, ast.Tuple)
                written = ", ".join(map(self.types.text, kinds.elts if many else [kinds]))
                return f"isinstance({self.text(value)}, {f'({written})' if many else written})"
            case ast.Call(func=ast.Name(id="getattr"), args=[value, key], keywords=[]):
                return f"getattr({self.text(value)}, {_string(key)})"
            case ast.Call(func=ast.Name(), args=[_], keywords=[]) if name in _CASTS:
                return f"{name}{self.arguments(node)}"
            case ast.Call(func=ast.Name()) if name in self.functions:
                return f"{name}{self.arguments(node)}"
            case ast.Call(
                func=ast.Attribute(value=cls, attr="__new__"), args=[same], keywords=[]
            ) if self.known.kinds.get(_dotted(cls)) == "class" and _dotted(same) == _dotted(cls):
                return f"{name}({_dotted(cls)})"
            case ast.Call(func=ast.Attribute(attr=operator)) if name == f"torch.{operator}" and (
                stands := _never(operator, node)
            ):
                return f'{GUARDS}.{stands}("torch.{operator}")'
            case ast.Call(func=ast.Attribute(value=value, attr=method)):
                return self.callee(node, name, value, method) + self.arguments(node)
            case _:
                raise _not_allowed(node, name)

    def callee(self, node: ast.Call, name: str, value: ast.expr, method: str) -> str:
        """Write what is called: an operator, a function or class of the file, or a method."""
        prefix, _, operator = name.rpartition(".")
        root = name.partition(".")[0]
        if prefix == "torch":
            if not may_run(operator, SCRIPT_OPERATORS):
                raise _not_allowed(node, name)
            if operator == "device":
                _cpu_only(node)
            return f"{GUARDS}.{operator}" if operator in _GUARDED else f"torch.{operator}"
        if prefix == "ops.prim" and operator in PRIM_OPERATORS:
            return name
        if self.known.kinds.get(name) in {"function", "tuple"}:
            return name
        if root in _RESERVED or (method not in self.known.methods and method != "tolist"):
            raise _not_allowed(node, name or method)
        return f"({self.text(value)}).{method}"

    def arguments(self, node: ast.Call) -> str:
        parts = [self.text(part) for part in node.args]
        for keyword in node.keywords:
            if keyword.arg is None:
                raise _RefusedError(node, "it unpacks arguments")
            parts.append(f"{keyword.arg}={self.text(keyword.value)}")
        return f"({', '.join(parts)})"


def _never(name: str, node: ast.Call) -> str | None:
    """Return the function that stands for a call which is never run; None if it may be."""
    if name in _PACKED:
        # The fourth argument of a layer is a bool; of its form for packed sequences, its weights.
        packed = len(node.args) < 4 or not isinstance(node.args[3], ast.Constant)
        return _PACKED[name] if packed else None
    return NEVER_RUN.get(name.removesuffix("_"))


def _cpu_only(node: ast.Call) -> None:
    match node:
        case ast.Call(args=[ast.Constant(value="cpu")], keywords=[]):
            return
        case _:
            shown = _short(ast.unparse(node))
            raise _RefusedError(
                node, f"it names the device `{shown}`", "export it on the CPU: module.cpu()"
            )


def _not_allowed(node: ast.AST, name: str) -> _RefusedError:
    return _RefusedError(
        node, f"it calls `{_short(name)}`, which is not among the operators that may run"
    )


def _dotted(node: ast.expr | None) -> str:
    """Return `a.b.c` for names and attributes of names; "" for all else."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return ""
    return ".".join([node.id, *reversed(parts)])


def _identifier(node: ast.expr) -> str:
    if not isinstance(node, ast.Name):
        raise _RefusedError(node, f"`{_short(ast.unparse(node))}` stands in place of a name")
    return node.id


def _literal(node: ast.expr) -> str:
    """Write a plain value: None, a bool, a number, a string, or a list, tuple or dict of them."""
    match node:
        case ast.Constant(value=str()):
            return _string(node)
        case ast.Constant(value=None | bool() | int() | float() as value):
            return repr(value)
        case ast.Name(id="inf" | "nan" as name):
            return name
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as value)):
            return f"-{value!r}"
        case ast.UnaryOp(op=ast.USub(), operand=ast.Name(id="inf" | "nan" as name)):
            return f"-{name}"
        case ast.List(elts=parts):
            return f"[{', '.join(map(_literal, parts))}]"
        case ast.Tuple(elts=parts):
            return f"({', '.join(map(_literal, parts))}{',' * (len(parts) == 1)})"
        case ast.Attribute() if (name := _dotted(node)).startswith("CONSTANTS.c"):
            return name
        case _:
            raise _RefusedError(node, f"`{_short(ast.unparse(node))}` is no plain value")


def _string(node: ast.expr) -> str:
    """Write a string as torch writes it: its reader knows octal escapes, and no others for all."""
    if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
        raise _RefusedError(node, f"`{_short(ast.unparse(node))}` stands in place of a string")
    if any(ord(character) > 255 for character in node.value):
        raise _RefusedError(node, "it has a string that torch never writes")
    return '"' + "".join(map(_character, node.value)) + '"'


def _character(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if " " <= character <= "~" else f"\\{ord(character):03o}"


def _short(text: str) -> str:
    return clean(text, at_most=80)
