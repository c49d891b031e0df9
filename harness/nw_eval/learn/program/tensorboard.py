"""Events for TensorBoard: a file for each process that worked on a training.

A new file begins where the state stood; TensorBoard then hides what an earlier one has beyond.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from nw_eval.errors import StoreError


def events(folder: Path, *, first: int) -> EventFile | None:
    """Return where events go; None where TensorBoard is not installed.

    Args:
        folder: of the files.
        first: step that this process goes on from.
    """
    return None if find_spec("tensorboard") is None else EventFile(folder, first=first)


class EventFile:
    """Events in one file, made with the first of them."""

    def __init__(self, folder: Path, *, first: int) -> None:
        number = len(list(folder.glob("events.out.tfevents.*")))
        self._path = folder / f"events.out.tfevents.{number:04d}.nw-eval"
        self._first = first
        self._has_begun = False

    def write(self, rows: Iterable[tuple[int, Mapping[str, float]]]) -> None:
        """Add rows.

        Raises:
            StoreError: the file cannot be written.
        """
        writer_of: Any = import_module("tensorboard.summary.writer.record_writer").RecordWriter
        pb: Any = import_module("tensorboard.compat.proto.event_pb2")
        scalar: Any = import_module("tensorboard.plugins.scalar.summary_v2").scalar_pb
        now = time.time()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("ab") as file:
                writer = writer_of(file)
                if not self._has_begun:
                    writer.write(_bytes(pb.Event(wall_time=now, file_version="brain.Event:2")))
                    start = pb.SessionLog(status=pb.SessionLog.START)
                    begun = pb.Event(wall_time=now, step=self._first + 1, session_log=start)
                    writer.write(_bytes(begun))
                    self._has_begun = True
                for step, values in rows:
                    for name, value in values.items():
                        summary = scalar(name, value)
                        writer.write(_bytes(pb.Event(wall_time=now, step=step, summary=summary)))
                writer.flush()
        except OSError as error:
            raise StoreError(
                f"cannot write {self._path}: {error.strerror}", fix="free disk space"
            ) from error


def _bytes(event: Any) -> bytes:
    return event.SerializeToString(deterministic=True)
