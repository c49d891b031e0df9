"""Folds a checkpoint of several files into one: ONNX with its weights apart, and Orbax.

An exporter has put the weights of an ONNX graph into a second file. brax, MuJoCo Playground and
flax save with Orbax: arrays in the Zarr format, each by the keys that lead to it
(`1.params.hidden_0.kernel`), together in a key-value store of TensorStore (OCDBT: `manifest.ocdbt`,
`ocdbt.process_0`, `d`) or, before that, in folders of their own. TensorStore reads them; nothing of
a checkpoint is code. They become one safetensors file. The activation, which no array says, is
taken from the JSON that brax writes beside them.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import PolicyError, PrerequisiteError, StoreError
from nw_base.files.inside import OutsideError, bounded_bytes, inside, regular, what_is
from nw_policies.safety import FileLimits, check_onnx
from nw_policies.safety.onnx import ONNX, ProtobufMessage, Reader, encoded

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_NESTED = 56
"""Messages in messages, as `check_onnx` takes them."""
_ELSEWHERE = 1
"""TensorProto.DataLocation.EXTERNAL."""


def fold(*, checkpoint: str, out: str) -> int:
    """Write a graph and the numbers in its other files as one file; return its bytes.

    Args:
        checkpoint: the ONNX file; the files that it names lie in its folder, or below.
        out: the file to write, in a folder of ours that exists.

    Raises:
        PolicyError: the file is damaged or no ONNX, is not safe to run, or a file that it names is
            missing, too short, too large or outside its folder.
        StoreError: `out` cannot be written.
    """
    data = _Fold(Path(checkpoint)).model()
    check_onnx(data, checkpoint)
    try:
        # `atomic_path` sets rights, which a confined process may not.
        Path(out).write_bytes(data)
    except OSError as error:
        raise StoreError(f"cannot write {out}: {error.strerror}", fix="free disk space") from None
    return len(data)


class _Fold:
    """One graph on its way into one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader = Reader(ONNX)
        self._files: dict[Path, memoryview] = {}
        self._left = FileLimits().file_bytes

    def model(self) -> bytes:
        """Return the whole file anew."""
        try:
            return self._anew(self._read(self._path), "Model", 0)
        except ValueError as error:
            raise PolicyError(
                f"{self._path}: not a usable ONNX file, cut short or damaged: {error}",
                fix="copy or download it again",
            ) from None

    def _anew(self, data: memoryview, kind: str, depth: int) -> bytes:
        if depth > _NESTED:
            raise ValueError("its graphs or types are nested too deeply")
        message = self._reader.read(data, kind)
        if kind == "Tensor" and message.integer("data_location") == _ELSEWHERE:
            self._fetch(message)
        for field in ONNX[kind].values():
            if field.kind in ONNX and field.name in message:
                message[field.name] = [
                    memoryview(self._anew(view, field.kind, depth + 1))
                    for view in message.views(field.name)
                ]
        return encoded(message, ONNX[kind])

    def _fetch(self, tensor: ProtobufMessage) -> None:
        """Give a tensor its numbers."""
        entries = [self._reader.read(e, "Entry") for e in tensor.views("external_data")]
        place = {entry.text("key"): entry.text("value") for entry in entries}
        name = clean(tensor.text("name"), at_most=100)
        file = clean(place.get("location", ""), at_most=200)
        try:
            numbers = self._read(inside(self._path.parent, place.get("location", "")))
            start = int(place.get("offset", 0))
            size = int(place.get("length", len(numbers) - start))
        except (OutsideError, ValueError) as error:
            raise PolicyError(
                f"{self._path}: tensor {name!r} lies in {file!r}, which cannot be used: {error}",
                fix="export it again",
            ) from None
        if not 0 <= start <= start + size <= len(numbers):
            raise PolicyError(
                f"{self._path}: tensor {name!r} lies at bytes {start} to {start + size} of "
                f"{file!r}, which has {len(numbers)}",
                fix="copy both files again, of one export",
            )
        del tensor["external_data"], tensor["data_location"]
        tensor["raw_data"] = [numbers[start : start + size]]

    def _read(self, path: Path) -> memoryview:
        if path not in self._files:
            try:
                size = regular(path).stat().st_size
                if size > self._left:
                    raise PolicyError(
                        f"{path}: the policy's files have over "
                        f"{FileLimits().file_bytes // 2**20} MiB together",
                        fix="export the actor alone",
                    )
                self._left -= size
                self._files[path] = memoryview(path.read_bytes())
            except OSError as error:
                raise PolicyError(
                    f"{path}: cannot be read: {error.strerror}",
                    fix="copy the file that the export wrote beside the graph to that path",
                ) from None
        return self._files[path]


_MARKS = ("_METADATA", "manifest.ocdbt", "_CHECKPOINT_METADATA")
_LEAF = re.compile(r"(?P<name>[^/]{1,1000})/(?P<kind>\.zarray|zarr\.json)")
_DRIVERS = {".zarray": "zarr", "zarr.json": "zarr3"}
_TYPES = {"float32": "F32", "float64": "F64", "int32": "I32", "int64": "I64"}
"""Types that are kept; halves become float32, and counters of other types are left out."""
_HALVES = {"float16", "bfloat16"}
_CONFIG_BYTES = 2**20


def is_orbax(folder: Path) -> bool:
    """Whether a folder is a checkpoint of Orbax."""
    return any(what_is(folder / mark) == "file" for mark in _MARKS)


def newest_orbax(folder: Path) -> Path | None:
    """Return the Orbax checkpoint of the highest step in a folder of a training, or itself."""
    if is_orbax(folder) and _has_arrays(folder):
        return folder
    for pattern in ("*", "*/*"):
        folders = [p for p in folder.glob(pattern) if what_is(p) == "folder" and is_orbax(p)]
        folders = [p for p in folders if _has_arrays(p)]
        if folders:
            return max(folders, key=lambda p: (_step(p, folder), p.name))
    return None


def _has_arrays(folder: Path) -> bool:
    """Whether the arrays lie in a folder itself; a step may hold several items, each in its own."""
    return what_is(folder / "manifest.ocdbt") == "file" or any(folder.glob("*/.zarray"))


def _step(path: Path, folder: Path) -> int:
    numbers = re.findall(r"\d+", path.relative_to(folder).parts[0])
    return int(numbers[-1]) if numbers else -1


def fold_orbax(*, checkpoint: str, out: str) -> int:
    """Write the arrays of a checkpoint as one safetensors file; return its bytes.

    Args:
        checkpoint: the folder of a step.
        out: the file to write, in a folder of ours that exists.

    Raises:
        PolicyError: it is no such checkpoint, is damaged, or has too many or too large arrays.
        PrerequisiteError: TensorStore is not installed.
        StoreError: `out` cannot be written.
    """
    folder = Path(checkpoint)
    arrays = dict(_arrays(folder))
    if not arrays:
        raise PolicyError(
            f"{folder}: no array of a checkpoint of Orbax can be read in it",
            fix="name the folder that holds `manifest.ocdbt`",
        )
    header: dict[str, Any] = {"__metadata__": _settings(folder)}
    start = 0
    for name, array in arrays.items():
        offsets = [start, start + array.nbytes]
        header[name] = {
            "dtype": _TYPES[array.dtype.name],
            "shape": list(array.shape),
            "data_offsets": offsets,
        }
        start = offsets[1]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    data = b"".join(
        [len(text).to_bytes(8, "little"), text, *(a.tobytes() for a in arrays.values())]
    )
    try:
        # `atomic_path` sets rights, which a confined process may not.
        Path(out).write_bytes(data)
    except OSError as error:
        raise StoreError(f"cannot write {out}: {error.strerror}", fix="free disk space") from None
    return len(data)


def _arrays(folder: Path) -> Iterable[tuple[str, NDArray[np.generic]]]:
    """Give each array with its name, in the order of the names."""
    try:
        tensorstore: Any = import_module("tensorstore")
    except ImportError:
        raise PrerequisiteError(
            f"{folder}: tensorstore is not installed, which reads checkpoints of Orbax",
            fix="install nw-eval with the extra `orbax`",
        ) from None
    limits, taken = FileLimits(), 0
    base: dict[str, Any] = {"driver": "file", "path": f"{folder.resolve()}/"}
    if what_is(folder / "manifest.ocdbt") == "file":
        base = {"driver": "ocdbt", "base": f"file://{folder.resolve()}/"}
    try:
        keys = tensorstore.KvStore.open(base).result().list().result()
        leaves = [m for k in sorted(keys) if (m := _LEAF.fullmatch(k.decode("utf-8", "replace")))]
        if len(leaves) > limits.tensors:
            raise PolicyError(
                f"{folder}: it has {len(leaves)} arrays, over the limit of {limits.tensors}",
                fix="save the policy's parameters alone",
            )
        for leaf in leaves:
            spec = {
                "driver": _DRIVERS[leaf["kind"]],
                "kvstore": {**base, "path": f"{base.get('path', '')}{leaf['name']}/"},
            }
            array = tensorstore.open(spec, open=True, read=True).result()
            kind = array.dtype.name
            if kind not in _TYPES and kind not in _HALVES:
                continue
            taken += math.prod(array.shape) * 8
            if taken > limits.tensor_bytes:
                raise PolicyError(
                    f"{folder}: the arrays up to {clean(leaf['name'], at_most=100)!r} have over "
                    f"{limits.tensor_bytes >> 20} MiB",
                    fix="save the policy's parameters alone",
                )
            numbers = array.read().result()
            yield leaf["name"], numbers.astype("float32" if kind in _HALVES else kind, order="C")
    except (ValueError, OSError, RuntimeError, OverflowError) as error:
        raise PolicyError(
            f"{folder}: the checkpoint is damaged: {clean(error, at_most=200)}",
            fix="copy it again, with all files of its folder",
        ) from None


def _settings(folder: Path) -> dict[str, str]:
    """Return the activation that brax wrote down."""
    try:
        text = bounded_bytes(folder / "ppo_network_config.json", _CONFIG_BYTES)
        said = json.loads(text)["network_factory_kwargs"]["activation"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}
    is_word = isinstance(said, str) and re.fullmatch(r"[a-z_]{1,30}", said)
    return {"activation": said} if is_word else {}
