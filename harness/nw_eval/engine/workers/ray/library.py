"""Scenes and policies of a process on a node, by the names that the head has for them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.rollout.library import Library
from nw_eval.rollout.trial import run_trial

if TYPE_CHECKING:
    from nw_eval.policies import Bundle
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.result import TrialResult
    from nw_eval.scenes import Scene
    from nw_eval.words import Collision

_library: Library | None = None


class LibraryHere(Library):
    """A library whose references are those of another machine.

    Jobs stay as the head wrote them, so that a trial's log names scene and policy as they are found
    by whoever replays it there, and has the bytes that it would have there.

    Args:
        places: where on this machine lies what jobs refer to; what is not in it is the same
            everywhere, such as the name of a built-in scene.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        super().__init__()
        self._places = places

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        """Return the scene of a reference; errors are those of `Library.scene`."""
        return super().scene(self._places.get(reference, reference), collision)

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:
        """Return the bundle of a reference; errors are those of `Library.bundle`."""
        weights = None if checkpoint is None else here(checkpoint, self._places)
        return super().bundle(self._places.get(reference, reference), weights)


def here(path: Path, places: Mapping[str, str]) -> Path:
    """Return where on this machine lies what the head calls by a path."""
    return Path(places.get(str(path), path))


def run_job(places: Mapping[str, str], job: TrialJob) -> TrialResult:
    """Run one trial with this process's cache of scenes and policies."""
    global _library  # noqa: PLW0603 - one cache a process is the point.
    if _library is None:
        _library = LibraryHere(places)
    return run_trial(job, library=_library)
