"""The tensors of a file of weights: described without memory, then read within limits.

Files of torch, safetensors, Stable-Baselines3 (a zip file with a torch file in it, `policy.pth`),
brax (a pickle) and flax (msgpack) are read.

Torch's own reader of archives looks members up without regard to case, takes its root from the
first of them, and looks for more of them than any policy has. So it is given an archive of ours:
what was checked, under the names that were checked, and nothing else.

The header of a safetensors file is eight bytes of length, JSON, then plain numbers.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import PolicyError, PrerequisiteError
from nw_policies.safety.archive import Archive, FileLimits, file_kind, kind_said, open_archive
from nw_policies.safety.objects import (
    ITEM_BYTES,
    Index,
    Record,
    StorageRef,
    TensorRef,
    read_index,
)

if TYPE_CHECKING:
    import torch

_NAME = "[A-Za-z_][A-Za-z_0-9]*"
_CODE = rf"code/__torch__(/{_NAME})*\.py"
_STATE = r"data\.pkl|data/[0-9]+|version|\.data/version|byteorder"
_MARKS = r"\.format_version|\.storage_alignment|\.data/serialization_id"
"""What torch notes about an archive; not needed here."""
_STATE_MEMBERS = re.compile(f"{_STATE}|{_MARKS}")
"""Members of a state dict."""
SCRIPT_MEMBERS = re.compile(
    rf"{_STATE}|{_MARKS}|constants\.pkl|constants/[0-9]+|{_CODE}"
    rf"|{_CODE}\.debug_pkl|extra/.*|traced_inputs(\.pkl|/[0-9]+)"
)
"""Members of a TorchScript file; those of the last line are for people, and left out."""
_KEPT = re.compile(rf"{_STATE}|constants\.pkl|constants/[0-9]+|{_CODE}")
_MOBILE = re.compile(r"bytecode\.pkl|mobile_debug_handles\.pkl|.*\.ff|.*\.ptl", re.IGNORECASE)
_SAFETENSORS_DTYPES = {
    "F64": "float64",
    "F32": "float32",
    "F16": "float16",
    "BF16": "bfloat16",
    "I64": "int64",
    "I32": "int32",
    "I16": "int16",
    "I8": "int8",
    "U8": "uint8",
    "BOOL": "bool",
}


@dataclass(frozen=True, kw_only=True)
class TensorFacts:
    """A tensor's entry in a file."""

    name: str
    """Keys on the way to it, joined by dots."""
    shape: tuple[int, ...]
    dtype: str


def tensor_facts(
    data: bytes, where: str, limits: FileLimits | None = None
) -> tuple[TensorFacts, ...]:
    """Describe all tensors of a file of weights or of a TorchScript file.

    Nothing is executed and no tensor is read, so this needs neither torch nor memory.

    Raises:
        PolicyError: as `read_tensors`.
    """
    limits = limits or FileLimits()
    kind = file_kind(data, where)
    if kind == "safetensors":
        entries = _read_header(data, where, limits)
        return tuple(TensorFacts(name=e.name, shape=e.shape, dtype=e.dtype) for e in entries)
    if kind == "stable-baselines3":
        return tensor_facts(_policy_member(data, where, limits), where, limits)
    if kind in {"pickle", "msgpack"}:
        index = _own_numbers(kind, data, where, limits)
    else:
        members = SCRIPT_MEMBERS if kind == "torchscript" else _STATE_MEMBERS
        _, index = checked_tree(data, where, limits, members)
    return tuple(
        TensorFacts(name=name, shape=ref.shape, dtype=ref.storage.dtype)
        for name, ref in leaves(index.tree, where, limits)
    )


def plain_entries(data: bytes, where: str, limits: FileLimits | None = None) -> tuple[str, ...]:
    """Return the names of what a file of weights holds beside its tensors: numbers, texts, lists.

    Raises:
        PolicyError: as `read_tensors`.
    """
    limits = limits or FileLimits()
    kind = file_kind(data, where)
    if kind == "stable-baselines3":
        return plain_entries(_policy_member(data, where, limits), where, limits)
    if kind == "safetensors":
        return ()
    if kind == "state-dict":
        tree = checked_tree(data, where, limits, _STATE_MEMBERS)[1].tree
    else:
        tree = _own_numbers(kind, data, where, limits).tree
    names: list[str] = []

    def walk(value: Any, name: str) -> None:
        if isinstance(value, TensorRef) or value is None:
            return
        items = list(_items(value))
        if items and not (isinstance(value, list) and not any(map(_holds, value))):
            for key, item in items[: limits.tensors]:
                walk(item, f"{name}.{key}" if name else str(key))
        elif (name and not _holds(value)) or items:
            names.append(name)

    for _ in _references(tree, where, limits):
        pass  # It refuses what nests too deep or repeats itself.
    walk(tree, "")
    return tuple(dict.fromkeys(names))


def _holds(value: Any) -> bool:
    return isinstance(value, dict | list | tuple | Record | TensorRef)


def read_tensors(
    data: bytes, where: str, limits: FileLimits | None = None
) -> dict[str, torch.Tensor]:
    """Read a state dict, or several of them in one file.

    Args:
        data: a file of `torch.save` (1.6 or newer), safetensors, Stable-Baselines3, brax or flax.
        where: its path, for errors.
        limits: bounds that are checked before a tensor is allocated.

    Returns:
        Tensors of their own memory, in the order of the file. The name of a tensor in a nested
        dict is that of all keys, joined by dots: `model_state_dict.actor.0.weight`.

    Raises:
        PolicyError: the file is something else, damaged, too large, or asks to run code; a tensor
            is larger than the memory that the file holds for it.
    """
    import torch

    limits = limits or FileLimits()
    kind = file_kind(data, where)
    if kind == "safetensors":
        return {
            entry.name: _tensor(data[entry.start : entry.stop], entry.dtype).reshape(entry.shape)
            for entry in _read_header(data, where, limits)
        }
    if kind == "stable-baselines3":
        return read_tensors(_policy_member(data, where, limits), where, limits)
    if kind not in {"state-dict", "pickle", "msgpack"}:
        raise PolicyError(
            f"{where}: not a state dict: {kind_said(kind)}",
            fix="save one with torch.save(module.state_dict(), file), or change `adapter`",
        )
    archive, index = (
        checked_tree(data, where, limits, _STATE_MEMBERS)
        if kind == "state-dict"
        else (None, _own_numbers(kind, data, where, limits))
    )
    storages: dict[str, torch.Tensor] = {}
    result: dict[str, torch.Tensor] = {}
    for name, ref in leaves(index.tree, where, limits):
        storage = ref.storage
        if archive is None:
            numbers = _tensor(storage.raw or b"", storage.dtype)
            view = numbers.as_strided(ref.shape, ref.strides, ref.offset)
            result[name] = view.clone(memory_format=torch.contiguous_format)
            continue
        if storage.key not in storages:
            storages[storage.key] = _tensor(archive.read(f"data/{storage.key}"), storage.dtype)
        view = storages[storage.key].as_strided(ref.shape, ref.strides, ref.offset)
        result[name] = view.clone(memory_format=torch.contiguous_format)
    return result


def _policy_member(data: bytes, where: str, limits: FileLimits) -> bytes:
    """Return the torch file in a zip file of Stable-Baselines3; the pickles beside it stay shut."""
    return open_archive(data, where, limits).read("policy.pth", at_most=limits.tensor_bytes)


def _own_numbers(kind: str, data: bytes, where: str, limits: FileLimits) -> Index:
    """Read a file that holds its numbers itself.

    Raises:
        PolicyError: it is damaged or too large, or asks to run code.
        PrerequisiteError: it is msgpack, and the library is not installed.
    """
    if len(data) > limits.pickle_bytes:
        raise PolicyError(
            f"{where}: the file has {len(data) >> 20} MiB, over the limit of "
            f"{limits.pickle_bytes >> 20}",
            fix="save the policy's parameters alone",
        )
    if kind == "pickle":
        return read_index(data, where, limits, pickled=True)
    tree = _unpacked(data, where)
    return Index(tree=tree, storages=(), tensors=(), classes=frozenset(), types=frozenset())


def _unpacked(data: bytes, where: str) -> Any:
    """Return what `flax.serialization.to_bytes` wrote: arrays are entries of the extended type 1.

    Such an entry is (shape, name of the type, numbers row by row), packed once more.
    """
    try:
        import msgpack
    except ImportError:
        raise PrerequisiteError(
            f"{where}: msgpack is not installed, and the file is of that format",
            fix="install nw-eval with the extra `remote`",
        ) from None

    def array(code: int, packed: bytes) -> Any:
        if code != 1:
            return None  # A complex number, or a scalar of NumPy.
        shape, dtype, raw = msgpack.unpackb(packed, raw=False)
        shape, dtype = tuple(map(int, shape)), str(dtype)
        if dtype not in ITEM_BYTES or math.prod(shape) * ITEM_BYTES[dtype] != len(raw):
            raise ValueError(f"an array of {dtype[:20]} and shape {shape} with {len(raw)} bytes")
        return TensorRef(
            storage=StorageRef(key="", dtype=dtype, count=math.prod(shape), raw=raw),
            offset=0,
            shape=shape,
            strides=tuple(math.prod(shape[index + 1 :]) for index in range(len(shape))),
        )

    try:
        return msgpack.unpackb(data, ext_hook=array, raw=False, strict_map_key=False)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise PolicyError(
            f"{where}: the msgpack file is damaged: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None


def tensors_below(tensors: Mapping[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    """Return the tensors below a prefix, without it."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def checked_tree(
    data: bytes, where: str, limits: FileLimits, members: re.Pattern[str]
) -> tuple[Archive, Index]:
    """Open a torch archive and read its index; all its tensors lie in the file.

    Args:
        data: the whole file.
        where: its path, for errors.
        limits: bounds on sizes.
        members: names that its members may have.

    Raises:
        PolicyError: a check fails.
    """
    archive = open_archive(data, where, limits)
    _check_members(archive, members)
    if archive.size("byteorder") is not None and archive.read("byteorder", at_most=64) != b"little":
        raise PolicyError(
            f"{where}: the numbers are big-endian", fix="save it on a little-endian machine"
        )
    index = read_index(archive.read("data.pkl", at_most=limits.index_bytes), where, limits)
    for name, ref in _references(index.tree, where, limits):
        _check_reference(name, ref, archive, "data")
    return archive, index


def check_references(index: Index, archive: Archive, folder: str, limits: FileLimits) -> None:
    """Check all tensors of an index, also those that its result no longer holds.

    Args:
        index: read from the archive.
        archive: that holds their numbers.
        folder: in which of its folders, `data` or `constants`.
        limits: bounds on their sizes.

    Raises:
        PolicyError: the numbers of one are not in the file, or of all are too many.
    """
    taken = 0
    for storage in index.storages:
        _check_storage("a tensor", storage, archive, folder)
        taken += storage.count * ITEM_BYTES[storage.dtype]
    if taken > limits.tensor_bytes or len(index.tensors) > limits.tensors:
        raise PolicyError(
            f"{archive.where}: the file has {len(index.tensors)} tensors of {_size(taken)}, over "
            "the limit",
            fix="save the actor alone, without optimiser state",
        )
    for ref in index.tensors:
        _check_reference("a tensor", ref, archive, folder)


def leaves(tree: Any, where: str, limits: FileLimits) -> Iterator[tuple[str, TensorRef]]:
    """Give every tensor with its name, and stop where they are too many or too large.

    Raises:
        PolicyError: they are.
    """
    total = 0
    for name, ref in _references(tree, where, limits):
        total += _bytes(ref)
        if total > limits.tensor_bytes:
            raise PolicyError(
                f"{where}: the tensors up to {name!r} have {total / 2**30:.1f} GiB, over the limit "
                f"of {limits.tensor_bytes / 2**30:.1f}",
                fix="save the actor alone, without optimiser state",
            )
        yield name, ref


def _references(tree: Any, where: str, limits: FileLimits) -> Iterator[tuple[str, TensorRef]]:
    """Walk dicts, lists and scripted objects; an index can repeat parts, so steps are counted."""
    left = [limits.tensors * 4]

    def walk(value: Any, name: str, depth: int) -> Iterator[tuple[str, TensorRef]]:
        left[0] -= 1
        if left[0] < 0 or depth > limits.depth:
            raise PolicyError(
                f"{where}: the file nests or repeats too many objects (at {name[:80]!r})",
                fix="save the plain state dict",
            )
        if isinstance(value, Record) and isinstance(value.state, TensorRef):
            value = value.state
        if isinstance(value, TensorRef):
            yield name, value
            return
        for key, item in _items(value):
            yield from walk(item, f"{name}.{key}" if name else str(key), depth + 1)

    yield from walk(tree, "", 0)


def _items(value: Any) -> Iterator[tuple[Any, Any]]:
    if isinstance(value, Record):
        yield from _items(value.state)
    elif isinstance(value, dict):
        yield from value.items()
    elif isinstance(value, list | tuple):
        yield from enumerate(value)


def _check_reference(name: str, ref: TensorRef, archive: Archive, folder: str) -> None:
    """Check that a tensor lies inside its storage and the storage inside the file."""
    where, storage = archive.where, ref.storage
    _check_storage(f"tensor {name!r}", storage, archive, folder)
    negative = min((*ref.shape, *ref.strides, ref.offset), default=0) < 0
    last = ref.offset + sum((n - 1) * s for n, s in zip(ref.shape, ref.strides, strict=True))
    if negative or (0 not in ref.shape and last >= storage.count):
        raise PolicyError(
            f"{where}: tensor {name!r} of shape {ref.shape} reaches outside the "
            f"{storage.count} numbers that the file holds for it",
            fix="the file is damaged or forged: export the policy again",
        )


def _check_storage(what: str, storage: StorageRef, archive: Archive, folder: str) -> None:
    stored = archive.size(f"{folder}/{storage.key}")
    if folder == "data" and stored is None:  # TorchScript keeps shared constants elsewhere.
        stored = archive.size(f"constants/{storage.key}")
    claimed = storage.count * ITEM_BYTES[storage.dtype]
    if stored is None or stored != claimed:
        have = "nothing" if stored is None else f"{stored} bytes"
        raise PolicyError(
            f"{archive.where}: {what} claims {_size(claimed)}, the file holds {have} for it",
            fix="the file is damaged or forged: export the policy again",
        )


def _bytes(ref: TensorRef) -> int:
    # A stride of 0 makes a large tensor of one number, so sizes count, not storages.
    return math.prod(ref.shape) * ITEM_BYTES[ref.storage.dtype]


def _size(count: int) -> str:
    return f"{count} bytes" if count < 2**20 else f"{count / 2**30:.1f} GiB"


def _tensor(raw: bytes, dtype: str) -> torch.Tensor:
    import torch

    if not raw:
        return torch.empty(0, dtype=getattr(torch, dtype))
    return torch.frombuffer(bytearray(raw), dtype=getattr(torch, dtype))


def _check_members(archive: Archive, allowed: re.Pattern[str]) -> None:
    """Check that all members lie in one folder and are those of their kind, case and all.

    Raises:
        PolicyError: a member is another, or lies elsewhere.
    """
    where = archive.where
    if not archive.root:
        raise PolicyError(
            f"{where}: the archive's members do not lie in one folder, as those of torch do",
            fix="do not use this file; export the policy again",
        )
    for name in archive.names():
        if allowed.fullmatch(name):
            continue
        mobile = _MOBILE.fullmatch(name) is not None
        raise PolicyError(
            f"{where}: the archive has a member {clean(name, at_most=200)!r}, which "
            + ("is for torch's mobile interpreter" if mobile else "such a file does not have"),
            fix="save the module with torch.jit.save alone"
            if mobile
            else "do not use this file; export the policy again",
        )


@dataclass(frozen=True, kw_only=True)
class TensorEntry:
    """A tensor, and where in the file its numbers are: bytes `start` to `stop`."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    start: int
    stop: int


def _read_header(data: bytes, where: str, limits: FileLimits) -> tuple[TensorEntry, ...]:
    """Read and check the header.

    Raises:
        PolicyError: it is damaged, or a tensor's size is not that of its bytes in the file.
    """
    length = int.from_bytes(data[:8], "little")
    begin = 8 + length
    if length > limits.index_bytes or begin > len(data) or len(data) > limits.file_bytes:
        raise PolicyError(
            f"{where}: a safetensors header of {length} bytes in a file of {len(data)}",
            fix="copy or download the file again",
        )
    try:
        header: dict[str, Any] = json.loads(data[8:begin], object_pairs_hook=_once)
        entries = [
            _entry(name, fields, begin) for name, fields in header.items() if name != "__metadata__"
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise PolicyError(
            f"{where}: the safetensors header is damaged: {error}",
            fix="copy or download the file again",
        ) from None
    if len(entries) > limits.tensors:
        raise PolicyError(
            f"{where}: {len(entries)} tensors, over the limit of {limits.tensors}",
            fix="save the actor alone",
        )
    for entry in entries:
        wanted = math.prod(entry.shape) * ITEM_BYTES[entry.dtype]
        inside = begin <= entry.start <= entry.stop <= len(data)
        if not inside or entry.stop - entry.start != wanted or min(entry.shape, default=0) < 0:
            raise PolicyError(
                f"{where}: tensor {entry.name!r} of shape {entry.shape} is not where the header "
                "puts it",
                fix="the file is truncated or forged: export the policy again",
            )
    ordered = sorted((entry for entry in entries if entry.stop > entry.start), key=_place)
    for one, other in pairwise(ordered):
        if other.start < one.stop:
            raise PolicyError(
                f"{where}: tensors {one.name!r} and {other.name!r} share bytes of the file",
                fix="save it with safetensors, which gives each tensor bytes of its own",
            )
    return tuple(entries)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON; a name that stands twice would be one tensor or the other."""
    fields = dict(pairs)
    if len(fields) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it has {clean(twice, at_most=80)!r} twice")
    return fields


def _place(entry: TensorEntry) -> tuple[int, int]:
    return entry.start, entry.stop


def _entry(name: str, fields: dict[str, Any], begin: int) -> TensorEntry:
    start, stop = (begin + int(offset) for offset in fields["data_offsets"])
    return TensorEntry(
        name=name,
        shape=tuple(int(size) for size in fields["shape"]),
        dtype=_SAFETENSORS_DTYPES[fields["dtype"]],
        start=start,
        stop=stop,
    )
