"""What a scripted module takes, read from its code as text; nothing of it is run or compiled.

TorchScript keeps a module's code in members `code/__torch__/...py`, in a small language that
always writes a method as `def forward(self: Type,`, one line for each argument, `) -> Type:`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.errors import PolicyError
from nw_eval.policies.safety import FileLimits, TensorFacts, open_archive
from nw_eval.policies.safety.objects import Record, read_objects

_CODE_BYTES = 2**20
_ARGUMENT = re.compile(r"^(\w+): ([\w.\[\], ]+?)(?:\s*=.*)?$")


@dataclass(frozen=True, kw_only=True)
class ScriptInput:
    """An argument of a module's `forward` that has no default."""

    name: str
    kind: str
    """`Tensor`, or another type as TorchScript writes it."""
    size: int | None
    """How many numbers the layer takes that it is passed to; None where other code sees it first.
    """


def script_inputs(
    data: bytes, where: str, tensors: Sequence[TensorFacts]
) -> tuple[ScriptInput, ...]:
    """Return what `forward` takes; empty where the code does not say it plainly.

    Args:
        data: a whole TorchScript file that passed `check_torchscript`.
        where: its path, for errors.
        tensors: the file's, for sizes.
    """
    archive = open_archive(data, where)
    index = archive.read("data.pkl", at_most=FileLimits().index_bytes)
    module = read_objects(index, where)
    if not isinstance(module, Record):
        return ()
    file, _, name = module.name.rpartition(".")
    try:
        code = archive.read(f"code/{file.replace('.', '/')}.py", at_most=_CODE_BYTES)
    except PolicyError:  # Absent or long: then it says nothing.
        return ()
    body = _forward(code.decode("utf-8", "replace"), name)
    signature = re.match(r"  def forward\(\w+: [\w.]+(?:,\s*([^)]*))?\) ->", body)
    if signature is None or signature[1] is None:
        return ()
    found: list[ScriptInput] = []
    for argument in re.split(r",\s*\n\s*", signature[1].strip()):
        parts = _ARGUMENT.match(argument)
        if parts is None:
            return ()
        if "=" not in argument:
            size = _size(parts[1], body, tensors)
            found.append(ScriptInput(name=parts[1], kind=parts[2], size=size))
    return tuple(found)


def _forward(code: str, name: str) -> str:
    """Return the lines of `forward` of a class; "" if there is none."""
    start = code.find(f"class {name}(Module):\n")
    start = -1 if start < 0 else code.find("\n  def forward(", start) + 1
    # A later class may have one where this has none; both begin at the margin.
    if start < 1 or "\nclass " in code[code.find(f"class {name}(Module):\n") : start]:
        return ""
    end = re.search(r"\n(?=\S|  \S)", code[start:])
    return code[start : start + end.start()] if end else code[start:]


def _size(argument: str, body: str, tensors: Sequence[TensorFacts]) -> int | None:
    """Return the width of the first layer of a submodule that an argument goes straight into."""
    call = re.search(rf"\((\w+)\)\.forward\({argument}, \)", body)
    if call is None:
        return None
    path = re.search(rf'\n    {call[1]} = (?:\w+\.(\w+)|getattr\(\w+, "(\w+)"\))\n', body)
    if path is None:
        return None
    prefix = f"{path[1] or path[2]}."
    layers = (t for t in tensors if t.name.startswith(prefix) and len(t.shape) == 2)
    return next((tensor.shape[1] for tensor in layers), None)
