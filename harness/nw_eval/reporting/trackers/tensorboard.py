"""TensorBoard: one file of events in the run's folder, which `tensorboard --logdir reports` reads.

Written record by record with the run's own time, so that the same run gives the same file; neither
TensorFlow nor torch is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from io import BytesIO
from pathlib import PurePath
from typing import Any

from nw_base.clean import clean
from nw_base.files.cache import atomic_path
from nw_base.files.pictures import open_picture
from nw_eval.reporting.html.evidence import Clip
from nw_eval.reporting.trackers.tracked import TrackedRun

_FILE = "events.out.tfevents.nw-eval"
"""TensorBoard looks for `tfevents` in a name; one name, so that a second time replaces it."""


def track(run: TrackedRun) -> None:
    """Write a run's events, whole or not at all.

    Raises:
        StoreError: the folder cannot be written.
    """
    records = BytesIO()
    writer: Any = import_module("tensorboard.summary.writer.record_writer").RecordWriter(records)
    for event in _events(run):
        writer.write(event.SerializeToString(deterministic=True))
    # Of several files in one folder TensorBoard makes one curve.
    name = _FILE if run.step is None else f"{_FILE}.{run.step}"
    with atomic_path(run.folder / name) as temporary:
        temporary.write_bytes(records.getvalue())


def _events(run: TrackedRun) -> Iterator[Any]:
    Event: Any = import_module("tensorboard.compat.proto.event_pb2").Event
    scalar: Any = import_module("tensorboard.plugins.scalar.summary_v2").scalar_pb
    text: Any = import_module("tensorboard.plugins.text.summary_v2").text_pb
    time, step = run.ended.timestamp(), run.step or 0
    yield Event(wall_time=time, file_version="brain.Event:2")
    for key, number in run.numbers.items():
        yield Event(wall_time=time, step=step, summary=scalar(key, number))
    for key, words in (*_literal(run), *_pages(run)):
        yield Event(wall_time=time, step=step, summary=text(key, words))
    for name, clip in run.clips.items():
        key = f"{run.place}/clips/{PurePath(name).stem}"
        yield Event(wall_time=time, step=step, summary=_moving(key, clip))


def _moving(key: str, clip: Clip) -> Any:
    """Return a clip as a GIF: of what moves, TensorBoard shows nothing else."""
    metadata: Any = import_module("tensorboard.plugins.image.metadata")
    tensors: Any = import_module("tensorboard.util.tensor_util")
    Summary: Any = import_module("tensorboard.compat.proto.summary_pb2").Summary
    picture = BytesIO()
    with open_picture(BytesIO(clip.data)) as frames:
        frames.save(picture, "GIF", save_all=True)
    parts = [str(clip.width).encode(), str(clip.height).encode(), picture.getvalue()]
    about = metadata.create_summary_metadata(None, _code(clean(clip.caption)))
    tensor = tensors.make_tensor_proto(parts)
    return Summary(value=[Summary.Value(tag=key, metadata=about, tensor=tensor)])


def _literal(run: TrackedRun) -> Iterator[tuple[str, str]]:
    for key, words in run.words.items():
        yield key, _code(words)


def _code(text: str) -> str:
    """Return words as code: TensorBoard draws Markdown, and they may be a third party's."""
    quoted = text.replace("`", "'")
    return f"`{quoted}`" if quoted else ""


def _pages(run: TrackedRun) -> Iterator[tuple[str, str]]:
    """Return the report, which TensorBoard draws as Markdown."""
    for file in run.files:
        if file.suffix == ".md":
            yield f"{run.place}/report", file.read_text(encoding="utf-8")
