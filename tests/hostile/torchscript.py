"""TorchScript files that attack, by what they do: for tests, fuzzers and demonstrations.

Each is a policy that takes 12 numbers and returns 12, and in whose `forward`, or while it is being
opened, something else happens. What writes, writes `ran` into the working directory; what only
reads, acts on what it read. `python torchscript.py FOLDER` writes them all, each with a card.
"""

from __future__ import annotations

import hashlib
import io
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import torch

CARD = """\
nw-policy: 1
name: crafted
robot: go1
adapter: torchscript
checkpoint: {file: policy.pt, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""
HONEST = "return torch.mul(x, 2.)"


class Doubling(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("numbers", torch.arange(4.0))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x * 2.0


class Waking(Doubling):
    """Runs code of its own while it is opened."""

    @torch.jit.export
    def __getstate__(self):
        return (self.numbers, self.training)

    @torch.jit.export
    def __setstate__(self, state: tuple[torch.Tensor, bool]) -> None:
        self.numbers = state[0]
        self.training = state[1]


def members(module: torch.nn.Module) -> dict[str, bytes]:
    """Return the members of a scripted module below its root, without notes for debuggers."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.script(module), buffer)
    with zipfile.ZipFile(buffer) as archive:
        return {
            name.split("/", 1)[1]: archive.read(name)
            for name in archive.namelist()
            if not name.endswith(".debug_pkl")
        }


def archive_of(content: dict[str, bytes]) -> bytes:
    """Return an archive with these members, full names, in this order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def rooted(content: dict[str, bytes], root: str = "archive") -> bytes:
    return archive_of({f"{root}/{name}": data for name, data in content.items()})


def scripted(forward: str, *, before: str = "", module: torch.nn.Module | None = None) -> dict:
    """Return a module's members with lines of `forward`, and lines of code before its class."""
    content = members(module or Doubling())
    (name,) = [name for name in content if b"def forward" in content[name]]
    code = content[name].decode()
    assert code.count(HONEST) == 1
    code = code.replace(HONEST, "\n    ".join(forward.splitlines()))
    content[name] = before.encode() + code.encode()
    return content


def saying(forward: str, **changes: str) -> Callable[[], bytes]:
    return lambda: rooted(scripted(forward, **changes))


def hidden(forward: str) -> bytes:
    """The same, where only a reader that ignores case finds the code."""
    content = scripted(forward)
    return rooted({name.replace("code/", "CODE/"): data for name, data in content.items()})


def waking(line: str, folder: str) -> bytes:
    """A line that runs while the file is opened."""
    content = scripted(HONEST, module=Waking())
    (name,) = [name for name in content if b"__setstate__" in content[name]]
    head = b"-> NoneType:\n"
    assert content[name].count(head) == 1
    content[name] = content[name].replace(head, head + f"    {line}\n".encode())
    return rooted({n.replace("code/", folder): data for n, data in content.items()})


def lying(content: dict[str, bytes]) -> dict[str, bytes]:
    """A tensor of 4 numbers that claims 200, in a file that holds 4."""
    index = content["data.pkl"]
    assert index.count(b"K\x04") == 2  # The count of its numbers, and its shape.
    return content | {"data.pkl": index.replace(b"K\x04", b"K\xc8")}


def two_cases() -> bytes:
    """The index that a reader of exact names finds is honest; the other one comes first."""
    honest = members(Doubling())
    return rooted({"DATA.PKL": lying(honest)["data.pkl"], **honest})


def two_roots() -> bytes:
    """Torch takes the root of the first member; the index at the top is for other readers."""
    honest = members(Doubling())
    top = {name: honest[name] for name in ("data.pkl", "constants.pkl", "data/0")}
    return archive_of({f"a/{name}": data for name, data in lying(honest).items()} | top)


def with_member(name: str, content: bytes) -> bytes:
    return rooted(members(Doubling()) | {name: content})


WRITES = 'torch.save(x, "ran")'
SHARES = 'torch.from_file("ran", True, 12)'
BEYOND = "ops.inductor._reinterpret_tensor(self.numbers, [12], [100], 0)"

CRAFTED: dict[str, Callable[[], bytes]] = {
    "saves a file": saying(f"{WRITES}\n{HONEST}"),
    "maps a file": saying(f"return torch.add(x, {SHARES})"),
    "saves a file, hidden by case": lambda: hidden(f"{WRITES}\n{HONEST}"),
    "maps a file, hidden by case": lambda: hidden(f"return torch.add(x, {SHARES})"),
    "saves a file while it is opened": lambda: waking('torch.save(1, "ran")', "code/"),
    "saves a file while it is opened, hidden by case": lambda: waking(
        'torch.save(1, "ran")', "CODE/"
    ),
    "maps a file while it is opened, hidden by case": lambda: waking(
        f"self.numbers = {SHARES}", "CODE/"
    ),
    "reads outside its storage": saying(f"return torch.add(x, {BEYOND})"),
    "reads outside its storage while it is opened": lambda: waking(
        f"self.numbers = {BEYOND}", "code/"
    ),
    "tells an address": saying("return torch.add(x, ops.mkldnn.data_ptr(x))"),
    "believes any size": saying(
        "return torch.add(x, torch._reshape_alias(self.numbers, [12], [100]))"
    ),
    "shows memory that nobody wrote": saying("return torch.empty_like(x)"),
    "has numbers on a device without any": saying(
        'return torch.linear(x, torch.zeros([12, 12], device=torch.device("meta")))'
    ),
    "resizes by a method": saying("return (x).resize_([1000], )"),
    "resizes by a method of its own name": saying(
        "return (x).resize_([1000], )",
        before="class Other:\n  def resize_(self: __torch__.torchscript.Other,\n"
        "    n: List[int]) -> Tensor:\n"
        "    return torch.zeros(n)\n",
    ),
    "calls by another name": saying(f'f = torch.save\nf(x, "ran")\n{HONEST}'),
    "renames the namespace": saying(f't = torch\nt.save(x, "ran")\n{HONEST}'),
    "calls in a default": saying(
        HONEST, before=f"def other(x: Tensor={SHARES}) -> Tensor:\n  return x\n"
    ),
    "has a class of a library": saying(
        HONEST,
        before="class Other:\n  part : __torch__.torch.classes.quantized.LinearPackedParamsBase\n",
    ),
    "forks": saying(f"def f():\n      return torch.neg(x)\n_1 = fork(f)\n{HONEST}"),
    "is no script": saying("import os"),
    "is nested deeply": saying(f"return {'(' * 5000}x{')' * 5000}"),
    "is chained deeply": saying(f"return x{'.x' * 50_000}"),
    "lies about a tensor": lambda: rooted(lying(members(Doubling()))),
    "lies about a tensor, hidden by case": two_cases,
    "lies about a tensor, hidden by roots": two_roots,
    "is for another interpreter": lambda: with_member("bytecode.pkl", b"\x80\x02N."),
    "brings a member of its own": lambda: with_member("attributes.pkl", b"\x80\x02N."),
}
"""Files that nothing may open, by what they do."""

PRINTS: Callable[[], bytes] = saying(
    f'print("::error::forged")\ntorch.warn("\\n::error::forged", 2)\n{HONEST}'
)
"""A file that does no harm but speaks to a CI runner."""


def write_bundle(folder: Path, data: bytes) -> Path:
    """Write a card and a checkpoint; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "policy.pt").write_bytes(data)
    (folder / "policy.yaml").write_text(CARD % hashlib.sha256(data).hexdigest())
    return folder


if __name__ == "__main__":
    for number, (title, make) in enumerate(CRAFTED.items()):
        print(write_bundle(Path(sys.argv[1]) / f"{number:02}", make()), title)  # noqa: T201
