"""One recording of Rerun: entities with what stays, what changes, and numbers over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PrerequisiteError

TIME = "sim_time"
"""The timeline: simulated seconds since the trial's start."""

Times = Sequence[int]
"""Nanoseconds of simulated time."""

APPLICATION = "nw-eval"
"""The application of recordings and layouts; Rerun keeps one layout for each."""

_FIX = "pip install 'nw-eval[rerun]'"


class Track:
    """Writes to Rerun's file of one recording. No viewer is started, nothing goes over a network.

    Args:
        recording_id: of the recording; the same trial has the same one.
        path: of the file.
        name: of the recording, for people.
    """

    def __init__(self, recording_id: str, path: Path, *, name: str) -> None:
        self.rr = rerun_sdk()
        # Its own properties are the time of day.
        self._stream = self.rr.RecordingStream(
            APPLICATION, recording_id=recording_id, send_properties=False
        )
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.save(str(path))
        self._stream.send_recording_name(name)

    def lay_out(self, layout: Any) -> None:
        """Say what a viewer shows when it opens the file."""
        self._stream.send_blueprint(layout, make_active=True, make_default=True)

    def entity(self, *parts: str) -> str:
        """Return an entity's path; the parts may be untrusted words."""
        return str(self.rr.new_entity_path(list(parts)))

    def stays(self, entity: str, what: Any) -> None:
        """Write what does not change."""
        self._stream.log(entity, what, static=True, strict=True)

    def at(self, time_ns: int, entity: str, what: Any) -> None:
        """Write what is so from a time on."""
        self._stream.set_time(TIME, duration=np.timedelta64(time_ns, "ns"))
        self._stream.log(entity, what, strict=True)

    def moves(self, entity: str, times: Times, columns: Any) -> None:
        """Write what is another at each of some times."""
        since = np.asarray(times, np.int64).astype("timedelta64[ns]")
        self._stream.send_columns(
            entity, [self.rr.TimeColumn(TIME, duration=since)], columns, strict=True
        )

    def numbers(self, entity: str, times: Times, rows: NDArray[Any], names: Sequence[str]) -> None:
        """Write (T, N) numbers at T times, each with a name of its own."""
        self.stays(entity, self.rr.SeriesLines(names=list(names)))
        scalars = self.rr.Scalars.columns(scalars=rows.astype(np.float64).ravel())
        self.moves(entity, times, scalars.partition([rows.shape[1]] * len(rows)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        """Finish the file.

        Raises:
            OSError: the disk did not take it.
        """
        try:
            if error is None:
                self._stream.flush()
        except RuntimeError as lost:  # Rerun writes in a thread, which has told stderr why it died.
            raise OSError("Rerun could not write all of it") from lost
        finally:
            self._stream.disconnect()


def rerun_sdk() -> Any:
    """Return the package `rerun`, with its blueprints.

    Raises:
        PrerequisiteError: it is missing, too old, or another package of that name.
    """
    try:
        sdk: Any = import_module("rerun")
        import_module("rerun.blueprint")
    except ImportError as error:
        raise PrerequisiteError(f"Rerun's files need the package {error.name}", fix=_FIX) from error
    if not hasattr(sdk, "GaussianSplats3D"):
        found = getattr(sdk, "__version__", "another package")
        raise PrerequisiteError(f"Rerun's files need rerun-sdk 0.41, not {found}", fix=_FIX)
    return sdk


@dataclass(frozen=True, kw_only=True)
class WrittenRecording:
    """A recording of Rerun that was written."""

    file: Path
    bytes: int
    gaussians: int
    """Of the scene's splat; 0 = it is not in the recording."""
    no_splat: str
    """Why it is not; empty if it is."""
