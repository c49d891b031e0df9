"""The statements of one function of a script, each written anew."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable

from nw_eval.policies.safety.torchscript.operators import (
    NEVER_RUN,
    PRIM_OPERATORS,
    SCRIPT_OPERATORS,
    may_run,
)
from nw_eval.policies.safety.torchscript.words import (
    Definitions,
    RefusedError,
    Types,
    dotted,
    identifier,
    literal,
    short,
    string,
)

GUARDS = "__torch__.nw_eval.policies.safety.guards"
"""Where the functions of `guards` lie in a script."""
_GUARDED = frozenset(
    {
        "gru",
        "gru_cell",
        "lstm",
        "lstm_cell",
        "scaled_dot_product_attention",
        "_native_batch_norm_legit_no_training",
        "_scaled_dot_product_flash_attention_for_cpu",
    }
)
"""Operators that are reached through the functions of their names there."""
_PACKED = {
    "lstm": "never_three",
    "gru": "never_two",
    "rnn_relu": "never_two",
    "rnn_tanh": "never_two",
}
"""Recurrent layers to what stands for their second form, that for packed sequences."""

_KEYWORDS = """
    CONSTANTS __torch__ annotate fork getattr inf infj isinstance nan nanj ops print range torch
    unchecked_cast uninitialized
"""
_RESERVED = frozenset(_KEYWORDS.split())
"""Names that mean something of their own, and may stand where the writer puts them only."""
_CASTS = frozenset({"bool", "float", "int", "sorted", "str"})


class FunctionBody:
    """The statements of one function."""

    def __init__(self, function: ast.FunctionDef, known: Definitions) -> None:
        self.known = known
        self.types = Types(known)
        arguments = [argument.arg for argument in function.args.args]
        stores = Counter(arguments)
        aliases: list[str] = []
        for node in ast.walk(function):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                stores[node.id] += 1
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=ast.Attribute() as value):
                    if known.kinds.get(dotted(value)) == "function":
                        aliases.append(name)
                case _:
                    pass
        if taken := _RESERVED.intersection(stores):
            raise RefusedError(function, f"it gives the name `{min(taken)}` another meaning")
        if double := [name for name in aliases if stores[name] > 1]:
            raise RefusedError(function, f"`{double[0]}` is a function and something else")
        self.names = frozenset(stores)
        self.functions = frozenset(aliases)

    def lines(self, statements: Iterable[ast.stmt], indent: str) -> str:
        """Write statements, each on lines of its own."""
        return "".join(indent + self.line(part, indent) for part in statements)

    def line(self, part: ast.stmt, indent: str) -> str:
        """Write a statement; `indent` is what stands before it."""
        match part:
            case ast.Pass():
                return "pass\n"
            case ast.Return(value=ast.expr() as value):
                return f"return {self.text(value)}\n"
            case ast.Expr(value=ast.Call(func=func, args=args) as call):
                if dotted(func) in {"print", "torch.warn"}:
                    # Left out, but for what its arguments do to tensors.
                    return f"({', '.join(map(self.text, args))},)\n" if args else "pass\n"
                return f"{self.text(call)}\n"
            case ast.Assign(targets=[target], value=value):
                return f"{self.target(target)} = {self.text(value)}\n"
            case ast.AnnAssign(
                target=ast.Name(id=name), annotation=kind, value=ast.expr() as value
            ):
                return f"{name} : {self.types.text(kind)} = {self.text(value)}\n"
            case _:
                return self.block(part, indent)

    def block(self, part: ast.stmt, indent: str) -> str:
        """Write a statement that has others inside."""
        inner = indent + "  "
        match part:
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
                name = f" as {identifier(item.optional_vars)}" if item.optional_vars else ""
                return f"with {self.text(item.context_expr)}{name}:\n{self.lines(body, inner)}"
            case _:
                kind = type(part).__name__
                raise RefusedError(part, f"it has a statement {kind} that torch never writes")

    def target(self, node: ast.expr) -> str:
        """Write what is assigned to."""
        match node:
            case ast.Name(id=name):
                return name
            case ast.Tuple(elts=parts) if parts:
                return "".join(f"{identifier(part)}, " for part in parts)
            case ast.Attribute(value=value, attr=name):
                return f"{self.base(value)}.{name}"
            case _:
                raise RefusedError(node, f"it assigns to `{short(ast.unparse(node))}`")

    def text(self, node: ast.expr) -> str:
        """Write an expression."""
        match node:
            case ast.Constant() | ast.UnaryOp():
                return literal(node)
            case ast.Name(id="inf" | "nan" as name):
                return name
            case ast.Name(id=name) if name in self.names and name not in self.functions:
                return name
            case ast.Attribute():
                return self.attribute(node)
            case ast.Call():
                return self.call(node)
            case ast.Subscript(value=value, slice=ast.Slice(lower=low, upper=high, step=None)):
                ends = (self.text(end) if end else "" for end in (low, high))
                return f"{self.base(value)}[{':'.join(ends)}]"
            case ast.Subscript(value=value, slice=key):
                return f"{self.base(value)}[{self.text(key)}]"
            case _:
                return self.collection(node)

    def collection(self, node: ast.expr) -> str:
        """Write a list, tuple or dict."""
        match node:
            case ast.List(elts=parts):
                return f"[{', '.join(map(self.text, parts))}]"
            case ast.Tuple(elts=parts):
                return f"({', '.join(map(self.text, parts))}{',' * (len(parts) == 1)})"
            case ast.Dict(keys=keys, values=values):
                if None in keys:
                    raise RefusedError(node, "it unpacks a dict")
                pairs = zip((k for k in keys if k), values, strict=True)
                return "{" + ", ".join(f"{self.text(k)}: {self.text(v)}" for k, v in pairs) + "}"
            case _:
                raise RefusedError(node, f"`{short(ast.unparse(node))}` is not TorchScript's")

    def base(self, node: ast.expr) -> str:
        """Write an expression of which a part is taken."""
        text = self.text(node)
        return text if isinstance(node, ast.Name) else f"({text})"

    def attribute(self, node: ast.Attribute) -> str:
        """Write a constant of the file, a function of it, or a part of a value."""
        name = dotted(node)
        root, _, rest = name.partition(".")
        if root == "CONSTANTS" and rest.startswith("c") and rest[1:].isdigit():
            return name
        if self.known.kinds.get(name) == "function":
            return name
        return f"{self.base(node.value)}.{node.attr}"

    def call(self, node: ast.Call) -> str:
        """Write a call: of a word of the language, or of what `callee` knows."""
        name = dotted(node.func)
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
                return f"getattr({self.text(value)}, {string(key)})"
            case ast.Call(func=ast.Name(), args=[_], keywords=[]) if name in _CASTS:
                return f"{name}{self.arguments(node)}"
            case ast.Call(func=ast.Name()) if name in self.functions:
                return f"{name}{self.arguments(node)}"
            case ast.Call(
                func=ast.Attribute(value=cls, attr="__new__"), args=[same], keywords=[]
            ) if self.known.kinds.get(dotted(cls)) == "class" and dotted(same) == dotted(cls):
                return f"{name}({dotted(cls)})"
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
        """Write what is passed."""
        parts = [self.text(part) for part in node.args]
        for keyword in node.keywords:
            if keyword.arg is None:
                raise RefusedError(node, "it unpacks arguments")
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
            shown = short(ast.unparse(node))
            raise RefusedError(
                node, f"it names the device `{shown}`", "export it on the CPU: module.cpu()"
            )


def _not_allowed(node: ast.AST, name: str) -> RefusedError:
    return RefusedError(
        node, f"it calls `{short(name)}`, which is not among the operators that may run"
    )
