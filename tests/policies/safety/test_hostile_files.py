"""Files that attack: each is refused as a PolicyError with a fix, runs nothing and takes no memory.

All tests run with 512 MiB of address space beyond what the process has, so that a reader which
believes a header fails here.
"""

from __future__ import annotations

import hashlib
import io
import stat
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.networks.exported import ExportedGraph
from nw_policies.safety import read_tensors, tensor_facts

resource = pytest.importorskip("resource")  # Address-space limits are a Unix matter.


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc to know the size of this process")
    torch.zeros(1000).sum()
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    old = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + 2**29
    resource.setrlimit(resource.RLIMIT_AS, (limit, old[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, old)


def text(value: str) -> bytes:
    return b"X" + struct.pack("<I", len(value)) + value.encode()


def integer(value: int) -> bytes:
    raw = value.to_bytes(9, "little", signed=True)
    return b"\x8a" + bytes([len(raw)]) + raw


def integers(values: tuple[int, ...]) -> bytes:
    return b"(" + b"".join(map(integer, values)) + b"t"


def index(
    *, count: int, shape: tuple[int, ...], strides: tuple[int, ...] = (1,), offset: int = 0
) -> bytes:
    """The index of a state dict {"weight": tensor}, in the instructions that torch.save writes."""
    storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text("0") + text("cpu")
    storage += integer(count) + b"tQ"
    hooks = b"ccollections\nOrderedDict\n)R"
    tensor = b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + integer(offset)
    tensor += integers(shape) + integers(strides) + b"\x89" + hooks + b"tR"
    return b"\x80\x02}" + text("weight") + tensor + b"s."


def torch_file(pkl: bytes, storage: bytes = b"\0" * 16, **extra: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a/data.pkl", pkl)
        archive.writestr("a/byteorder", b"little")
        archive.writestr("a/data/0", storage)
        archive.writestr("a/version", b"3\n")
        for name, content in extra.items():
            archive.writestr(f"a/{name}", content)
    return buffer.getvalue()


def with_member(name: str, content: bytes, *, compress: bool = False, mode: int = 0) -> bytes:
    buffer = io.BytesIO(torch_file(index(count=4, shape=(4,))))
    with zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED if compress else 0) as archive:
        info = zipfile.ZipInfo(name)
        info.external_attr = mode << 16
        info.compress_type = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
        archive.writestr(info, content)
    return buffer.getvalue()


def call(module: str, name: str, argument: str) -> bytes:
    return b"\x80\x02c" + f"{module}\n{name}\n".encode() + text(argument) + b"\x85R."


def laughs() -> bytes:
    """Forty levels of pairs of the level below: 2**40 tensors in some hundred bytes."""
    program = b"\x80\x02" + index(count=4, shape=(4,))[2:-1]
    for level in range(40):
        program += b"q" + bytes([level]) + b"h" + bytes([level]) + b"\x86"
    return program + b"."


def truncated() -> bytes:
    buffer = io.BytesIO()
    torch.save({"weight": torch.ones(64, 64)}, buffer)
    return buffer.getvalue()[:9000]


def lying_size() -> bytes:
    """A member whose headers claim 3 GB."""
    data = with_member("a/data/1", b"\0" * 8)
    claimed = struct.pack("<I", 3_000_000_000)
    place = data.rindex(b"PK\x01\x02")
    return data[: place + 20] + claimed * 2 + data[place + 28 :]


HUGE = b'{"w":{"dtype":"F32","shape":[25000000000],"data_offsets":[0,100000000000]}}'

HOSTILE = {
    "pickle that runs a command": (
        lambda: torch_file(call("posix", "system", "touch ran")),
        "asks to call 'posix.system'",
    ),
    "pickle that evaluates": (
        lambda: torch_file(call("builtins", "eval", "open('ran', 'w')")),
        "asks to call 'builtins.eval'",
    ),
    "pickle with an old-style object": (
        lambda: torch_file(b"\x80\x02(cposix\nsystem\n" + text("touch ran") + b"o."),
        "has the instruction OBJ",
    ),
    "class of somebody": (
        lambda: torch_file(b"\x80\x02csubprocess\nPopen\n)\x81."),
        "makes an object of subprocess.Popen",
    ),
    "class whose name repaints a terminal": (
        lambda: torch_file(b"\x80\x02c\x1b[31m\n::error::x\n)\x81."),
        r"makes an object of \\x1b\[31m\.::error::x",
    ),
    "bare pickle": (
        lambda: call("posix", "system", "touch ran"),
        "asks to call 'posix.system'",
    ),
    "storage of 100 GB": (
        lambda: torch_file(index(count=25_000_000_000, shape=(25_000_000_000,))),
        "claims 93.1 GiB, the file holds 16 bytes",
    ),
    "tensor of 100 GB": (
        lambda: torch_file(index(count=4, shape=(25_000_000_000,))),
        "reaches outside the 4 numbers",
    ),
    "tensor of 100 GB that repeats one number": (
        lambda: torch_file(index(count=4, shape=(25_000_000_000,), strides=(0,))),
        "have 93.1 GiB, over the limit",
    ),
    "tensor before its numbers": (
        lambda: torch_file(index(count=4, shape=(2,), offset=-2)),
        "reaches outside",
    ),
    "more axes than strides": (
        lambda: torch_file(index(count=4, shape=(2, 2))),
        "malformed shape",
    ),
    "laughs": (lambda: torch_file(laughs()), "nests or repeats too many objects"),
    "zip bomb": (
        lambda: with_member("a/data/1", b"\0" * 2**25, compress=True),
        "times, like a zip bomb",
    ),
    "member of 3 GB": (lying_size, "unpacks to 2861 MiB|damaged|truncated"),
    "path that climbs": (lambda: with_member("a/../../evil", b"x"), "points outside the archive"),
    "path from the root": (lambda: with_member("/etc/evil", b"x"), "points outside the archive"),
    "path of Windows": (lambda: with_member("C:\\evil", b"x"), "points outside the archive"),
    "link": (
        lambda: with_member("a/link", b"/etc/passwd", mode=stat.S_IFLNK | 0o777),
        "is a link",
    ),
    "truncated file": (truncated, "truncated"),
    "web page": (
        lambda: b"\n<!DOCTYPE html><html><title>Sign in</title></html>",
        "a web page, not a checkpoint",
    ),
    "pointer of Git LFS": (
        lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
        "pointer of Git LFS.*git lfs pull",
    ),
    "nothing": (lambda: b"", "empty"),
    "noise": (lambda: np.random.default_rng(0).bytes(4096), "format is unknown"),
    "safetensors header of 2 GB": (
        lambda: struct.pack("<Q", 2**31) + b"{" + b" " * 100,
        "format is unknown",
    ),
    "safetensors of 100 GB": (
        lambda: struct.pack("<Q", len(HUGE)) + HUGE,
        "tensor 'w' of shape .25000000000,. is not where the header puts it",
    ),
    "big-endian numbers": (
        lambda: torch_file(index(count=4, shape=(4,))).replace(b"little", b"bigggg"),
        "big-endian|damaged",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_state_dict_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make, reason = HOSTILE[name]
    with pytest.raises(PolicyError, match=reason) as caught:
        read_tensors(make(), "weights.pt")
    assert str(caught.value).startswith("weights.pt")
    assert caught.value.fix
    assert not list(tmp_path.iterdir())


def test_a_member_that_comes_twice_is_refused():
    with pytest.warns(UserWarning, match="Duplicate name"):
        data = with_member("a/data/0", b"\1" * 16)
    with pytest.raises(PolicyError, match="appears twice"):
        read_tensors(data, "weights.pt")


CARD = """\
nw-policy: 1
name: hostile
robot: go1
adapter: {adapter}
checkpoint: {{file: weights.pt, sha256: {sha256}}}
control: {{action: joint_position_offset}}
observations: {{proprio: {{sensor: proprio, layout: parkour53}}}}
"""


@pytest.mark.parametrize("adapter", ["lucidsim", "extreme-parkour", "act", "torch-export"])
@pytest.mark.parametrize("name", HOSTILE)
def test_no_adapter_opens_a_hostile_file(name, adapter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = HOSTILE[name][0]()
    (tmp_path / "weights.pt").write_bytes(data)
    sha256 = hashlib.sha256(data).hexdigest()
    (tmp_path / "policy.yaml").write_text(CARD.format(adapter=adapter, sha256=sha256))
    with pytest.raises(PolicyError, match=r"weights\.pt"):
        open_policy(load_bundle(tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["policy.yaml", "weights.pt"]


@pytest.mark.parametrize("name", [n for n in HOSTILE if "safetensors" not in n])
def test_a_hostile_scripted_module_is_refused_before_torch_sees_it(name):
    make, _ = HOSTILE[name]
    data = make()
    if data.startswith(b"PK") and name not in {"truncated file", "member of 3 GB"}:
        buffer = io.BytesIO(data)
        with zipfile.ZipFile(buffer, "a") as archive:
            archive.writestr("a/constants.pkl", b"\x80\x02).")
        data = buffer.getvalue()
    with pytest.raises(PolicyError):
        tensor_facts(data, "policy.pt")


def test_a_real_scripted_module_passes_until_its_header_lies():
    module = torch.jit.trace(torch.nn.Linear(53, 12), torch.zeros(1, 53))
    buffer = io.BytesIO()
    torch.jit.save(module, buffer)
    data = buffer.getvalue()
    facts = {fact.name: fact.shape for fact in tensor_facts(data, "policy.pt")}
    assert facts == {"weight": (12, 53), "bias": (12,)}
    source, forged = zipfile.ZipFile(io.BytesIO(data)), io.BytesIO()
    with zipfile.ZipFile(forged, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            # 636 = 12 x 53 numbers become 65,148: the same length of the index.
            content = content.replace(
                struct.pack("<BH", 0x4D, 636), struct.pack("<BH", 0x4D, 65148)
            )
            target.writestr(name, content)
    with pytest.raises(
        PolicyError, match="tensor 'weight' claims 260592 bytes, the file holds 2544"
    ):
        tensor_facts(forged.getvalue(), "policy.pt")


def plain_file() -> bytes:
    buffer = io.BytesIO()
    torch.save({"net": {"0.weight": torch.ones(5, 7), "0.bias": torch.zeros(5)}}, buffer)
    return buffer.getvalue()


def scripted_file() -> bytes:
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.trace(torch.nn.Linear(5, 3), torch.zeros(1, 5)), buffer)
    return buffer.getvalue()


def exported_file() -> bytes:
    buffer = io.BytesIO()
    network = torch.nn.Sequential(torch.nn.Linear(5, 4), torch.nn.ELU()).eval()
    torch.export.save(torch.export.export(network, (torch.zeros(1, 5),)), buffer)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("make", "reader"),
    [
        (plain_file, read_tensors),
        (scripted_file, tensor_facts),
        (exported_file, ExportedGraph),
    ],
)
def test_damage_anywhere_is_an_error_of_ours_or_harmless(make, reader):
    data = make()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 12))):
            damaged[int(rng.integers(len(damaged)))] = int(rng.integers(256))
        try:
            reader(bytes(damaged), "weights.pt")
        except PolicyError:
            refused += 1
    assert refused > 100
