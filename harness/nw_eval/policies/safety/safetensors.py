"""The header of a safetensors file: eight bytes of length, JSON, then plain numbers."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from nw_eval.errors import PolicyError
from nw_eval.policies.safety.limits import FileLimits
from nw_eval.policies.safety.objects import ITEM_BYTES

_DTYPES = {
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
class TensorEntry:
    """A tensor, and where in the file its numbers are: bytes `start` to `stop`."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    start: int
    stop: int


def read_header(data: bytes, where: str, limits: FileLimits) -> tuple[TensorEntry, ...]:
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
        header: dict[str, Any] = json.loads(data[8:begin])
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
                "says",
                fix="the file is truncated or forged: export the policy again",
            )
    return tuple(entries)


def _entry(name: str, fields: dict[str, Any], begin: int) -> TensorEntry:
    start, stop = (begin + int(offset) for offset in fields["data_offsets"])
    return TensorEntry(
        name=name,
        shape=tuple(int(size) for size in fields["shape"]),
        dtype=_DTYPES[fields["dtype"]],
        start=start,
        stop=stop,
    )
