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
_FOLLOWED = 8
"""Functions that an argument is followed through to its first layer."""
_KEEP_WIDTH = "clamp|clip|sub|add|mul|div|to|unsqueeze|squeeze|nan_to_num|contiguous|clone|tanh"
_NOWHERE = "\0"
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
    images: tuple[int | None, ...] = ()
    """Of a list of tensors: for each that is used, the channels of the convolution it goes into."""


def script_inputs(
    data: bytes, where: str, tensors: Sequence[TensorFacts]
) -> tuple[ScriptInput, ...]:
    """Return what `forward` takes; empty where the code does not say it plainly.

    Args:
        data: a whole TorchScript file.
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
            images = _images(parts[1], body, tensors) if parts[2] == "List[Tensor]" else ()
            found.append(ScriptInput(name=parts[1], kind=parts[2], size=size, images=images))
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
    """Return the width of the first layer that an argument goes into, one function at a time."""
    for _ in range(_FOLLOWED):
        call = re.search(rf"(?:(\w+) = |\()\(?(\w+)\)\.forward\w*\({argument}, ", body)
        if call is not None:
            prefix = _path(call[2], body)
            layers = (t for t in tensors if prefix and t.name.startswith(prefix))
            size = next((tensor.shape[1] for tensor in layers if len(tensor.shape) == 2), None)
            if size is not None:
                return size
        else:
            call = re.search(rf"(\w+) = torch\.(?:{_KEEP_WIDTH})\({argument}[,)]", body)
        if call is None or call[1] is None:
            return None
        argument = call[1]
    return None


def _images(argument: str, body: str, tensors: Sequence[TensorFacts]) -> tuple[int | None, ...]:
    """Return the channels of the convolutions that the items of a list go into, by their place."""
    used = [int(place) for place in re.findall(rf"\b{argument}\[(\d{{1,2}})\]", body)]
    found: list[int | None] = [None] * (max(used, default=-1) + 1)
    for call in re.finditer(rf"\((\w+)\)\.forward\w*\({argument}\[(\d{{1,2}})\], ", body):
        prefix = _path(call[1], body)
        layers = (t for t in tensors if prefix and t.name.startswith(prefix))
        found[int(call[2])] = next((t.shape[1] for t in layers if len(t.shape) == 4), None)
    return tuple(found)


def _path(name: str, body: str) -> str:
    """Return what the names of the tensors begin with of the submodule in a variable; or ""."""
    found = re.search(rf'\n    {name} = (?:(\w+)\.(\w+)|getattr\((\w+), "(\w+)"\))\n', body)
    if found is None:
        return ""
    of, own = found[1] or found[3], found[2] or found[4]
    return f"{own}." if of == "self" else f"{_path(of, body) or _NOWHERE}{own}."
