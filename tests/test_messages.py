"""All messages of errors stand in one golden file a package: `messages/<package>.txt`.

A change of words is reviewed as a diff of these files. They are recorded by

    python tests/test_messages.py

Elsewhere tests assert an error's class, its exit code, and the value that it names.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GOLDEN = Path(__file__).parent / "messages"
PACKAGES = sorted(path.name for path in (ROOT / "harness").glob("nw_*"))


def template(node: ast.expr | None) -> str | None:
    """Return a text with `{}` for each value in it; None if it is no text that stands there."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(template(part) or "{}" for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            both = [template(left), template(right)]
            return None if both == [None, None] else "".join(each or "{}" for each in both)
        case ast.IfExp(body=body, orelse=orelse):
            both = [each for each in (template(body), template(orelse)) if each]
            return " / ".join(both) or None
        case _:
            return None


def messages_of(source: str) -> Iterator[str]:
    """Yield the errors that a module makes: class, message and fix, as they stand there."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        name = node.func.id
        if not name.endswith("Error") or name in {"AssertionError", "NotImplementedError"}:
            continue
        text = template(node.args[0]) if node.args else None
        fix = next((template(each.value) for each in node.keywords if each.arg == "fix"), None)
        if text:
            found.append((node.lineno, f"{name}: {text}" + (f" -> {fix}" if fix else "")))
    yield from (line.replace("\n", "\\n") for _, line in sorted(found, key=lambda each: each[0]))


def recorded(package: str) -> str:
    """Return the golden file of a package as it is to be."""
    folder = ROOT / "harness" / package
    parts: list[str] = []
    for path in sorted(folder.rglob("*.py")):
        lines = list(messages_of(path.read_text(encoding="utf-8")))
        if lines:
            name = path.relative_to(folder).as_posix()
            parts.append("\n".join([f"{name}", *(f"  {line}" for line in lines)]))
    return "\n\n".join(parts) + "\n"


@pytest.mark.parametrize("package", PACKAGES)
def test_the_messages_of_a_package_are_those_that_were_reviewed(package: str) -> None:
    known = (GOLDEN / f"{package}.txt").read_text(encoding="utf-8")
    assert recorded(package) == known, "record them: python tests/test_messages.py; read the diff"


def test_each_message_stands_with_its_values_left_open_and_its_fix() -> None:
    source = (
        'def f(a):\n    raise UsageError(f"--n {a} is too low", fix="give " + str(a))\n'
        'x = ValueError("no" if y else "nothing")\nz = Error(x)\nprint("not one")\n'
    )
    assert list(messages_of(source)) == [
        "UsageError: --n {} is too low -> give {}",
        "ValueError: no / nothing",
    ]


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for each in sys.argv[1:] or PACKAGES:
        (GOLDEN / f"{each}.txt").write_text(recorded(each), encoding="utf-8")
