"""What a node of the cluster is asked by the head; each function runs there, in a process of Ray's.

What is asked and what is answered are plain values. The first question goes to whatever version of
nw-eval the node has.
"""

from __future__ import annotations

import platform
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval import __version__
from nw_eval.engine import ray_file_bundles
from nw_eval.engine.ray_file_bundles import FileBundle
from nw_eval.words import Backend, Collision

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


@dataclass(frozen=True, kw_only=True)
class JobSpec:
    """What a node makes ready for a run."""

    token: str
    """Names the run's folders on nodes: letters and digits."""
    scenes: tuple[tuple[str, Collision], ...]
    """References of the head's, and how meshes collide."""
    file_bundles: tuple[FileBundle, ...]
    render: Backend
    renders: bool
    """Whether any trial may render."""
    memory_limit: int | None
    """Bytes that a worker may hold with its children."""


def facts(
    render: Backend, *, adapter: str, code: bool, plugins: Mapping[str, str]
) -> dict[str, str]:
    """Return what must be the same on all machines that one run's rows come from.

    The first line of a journal and run.json say it once, for all of them.

    Args:
        render: the splat renderer.
        adapter: of the policy's card.
        code: as for `fence_of`.
        plugins: the run's `Plan.plugins`, of which a node may have others.
    """
    from nw_eval.engine.provenance import engine_of, fence_of

    return {
        "nw-eval": __version__,
        "Python": platform.python_version(),
        **engine_of(render, plugins),
        "fence": fence_of(adapter, code=code, render=render),
    }


def lacking(file_bundles: tuple[FileBundle, ...]) -> tuple[str, ...]:
    """Return the sha256 of the files that this node does not have."""
    return ray_file_bundles.missing(file_bundles)


def make_ready(spec: JobSpec, pieces: Mapping[str, Sequence[Any]]) -> None:
    """Get what is missing, and compile what all workers need, as the head does for its own.

    Args:
        spec: of the run.
        pieces: references of Ray's to the pieces of each file that was missing, by sha256.

    Raises:
        StoreError: what arrived is not what was sent, or it cannot be kept.
        SceneError, PrerequisiteError: as `engine.prepare`.
    """
    import ray

    from nw_eval.catalogue import open_scene
    from nw_eval.engine.listener import NullListener
    from nw_eval.engine.prepare import build_splats, open_backend, ready_scans

    def fetch(sha256: str) -> Iterator[bytes]:
        for piece in pieces.get(sha256, ()):
            yield ray.get(piece)

    ray_file_bundles.receive(spec.file_bundles, fetch)
    places = ray_file_bundles.places(spec.file_bundles)
    scenes = [open_scene(places.get(name, name), collision) for name, collision in spec.scenes]
    ready_scans(scenes, NullListener())
    if spec.renders:
        open_backend(spec.render, NullListener(), is_fenced=False)
        build_splats(scenes, NullListener())


def scratch(token: str) -> Path:
    """Return the folder in which a run's node agent on this node writes, until the head has it."""
    return Path(tempfile.gettempdir()) / f"nw-eval-{token}"


def tidy(token: str) -> None:
    """Remove what a run's node agents have left: logs of trials that were killed."""
    shutil.rmtree(scratch(token), ignore_errors=True)
