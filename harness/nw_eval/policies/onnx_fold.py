"""Folds an ONNX graph whose weights an exporter has put into a second file into one file.

Every message is read by the table of onnx.proto and written anew; a tensor whose numbers lie in
another file gets them as `raw_data`. Nothing is run, and the package `onnx` is not needed.
"""

from __future__ import annotations

from pathlib import Path

from nw_eval.clean import clean
from nw_eval.errors import PolicyError, StoreError
from nw_eval.files.inside import OutsideError, inside, regular
from nw_eval.policies.safety import FileLimits, check_onnx
from nw_eval.policies.safety.onnx_format import ONNX, ProtobufMessage, Reader, encoded

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
