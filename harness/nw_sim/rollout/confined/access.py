"""What a policy's process may do, which reads its files, and a world's, which writes logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_base.confinement import Rules, memory_to_open, memory_to_run, raise_fence
from nw_base.confinement.rights import give_up
from nw_base.errors import StoreError
from nw_base.files.cache import cache_dir
from nw_policies.bundle import senses_by_code
from nw_policies.safety import FileLimits
from nw_sim.catalogue import scene_paths

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from nw_base.words import Backend, Kernels
    from nw_policies import Bundle

_FREE_PORTS = 1024
"""The first port at which anybody may listen."""
OPENING_SECONDS = 25
"""Of processor time to open a checkpoint in: imports take 2 to 5 s of it, 100 MB another 1."""


def inspecting_rules(
    checkpoint: Path, *, robot: Path | None = None, also: Sequence[Path] = ()
) -> Rules:
    """Return the rules of a process that reads one checkpoint, without a card.

    It may read the folder of the robot that the checkpoint drives, files that `also` names, and
    what LEAPP wrote beside it of the state that a pipeline begins with.
    """
    beside = sorted(checkpoint.parent.glob("*_initial_values.safetensors"))[:4]
    paths = (checkpoint, robot, *also, *beside, *robots_kept())
    return Rules(
        reads=tuple(path.resolve() for path in paths if path is not None),
        memory=memory_to_open(_size(checkpoint)),
        seconds=OPENING_SECONDS,
    )


def folding_rules(checkpoint: Path, folder: Path) -> Rules:
    """Return the rules of a process that writes a checkpoint of several files into a folder."""
    place = checkpoint.resolve()
    return Rules(
        reads=(place if place.is_dir() else place.parent,),
        writes=(folder.resolve(),),
        memory=memory_to_open(FileLimits().file_bytes),
        seconds=OPENING_SECONDS,
    )


def opening_rules(bundle: Bundle, *, allow_code: bool, also: Sequence[Path] = ()) -> Rules:
    """Return the rules of a process that checks a card, opens its checkpoint, and runs it once.

    It may read what `also` names.
    """
    is_code = allow_code and bool(bundle.code_sha256)
    return Rules(
        reads=(*_files(bundle), *also, *robots_kept()),
        memory=None if is_code else memory_to_open(_size(*bundle.files)),
        seconds=None if is_code else OPENING_SECONDS,
        off=why_off(code=allow_code and senses_by_code(bundle.card)),
        kernels=_kernels(bundle),
    )


def policy_rules(bundle: Bundle) -> Rules:
    """Return the rules of a process that opens a policy and answers for it in trials.

    Code that the caller allows has the memory that it wants, and what `--memory-limit` says.
    """
    return Rules(
        reads=_files(bundle),
        network="all" if bundle.card.adapter == "remote" else "none",
        memory=None if bundle.code_sha256 else memory_to_run(_size(*bundle.files), scenes=0),
        python=bundle.python,
    )


def running_rules(
    bundle: Bundle,
    *,
    scenes: Iterable[str],
    logs: Path | None = None,
    allow_code: bool = False,
    render: Backend = "cpu",
    also: Sequence[Path] = (),
) -> Rules:
    """Return the rules of a process that runs trials, of which it simulates the world.

    Args:
        bundle: the policy, whose digest it takes, and which it does not open.
        scenes: what `get_scene` understands of those that it runs in.
        logs: the folder of their logs; None = none is written.
        allow_code: whether Python code that the card names may be imported.
        render: the splat backend.
        also: further files that it reads.
    """
    places = tuple(dict.fromkeys(scenes))
    return Rules(
        reads=(
            *_files(bundle),
            *(folder for scene in places for folder in scene_paths(scene)),
            *(path.resolve() for path in also),
            *_cache(),
        ),
        writes=() if logs is None else (logs.resolve(),),
        memory=memory_to_run(_size(*bundle.files), scenes=len(places)),
        off=why_off(code=allow_code and senses_by_code(bundle.card), render=render),
        kernels=(*_kernels(bundle), "rays"),
    )


def drawing_rules(*, scenes: Iterable[str], also: Sequence[Path]) -> Rules:
    """Return the rules of a process that draws scenes and recorded trials, and asks no policy.

    Args:
        scenes: what `get_scene` understands of those that it opens.
        also: further files and folders that it reads.
    """
    places = tuple(dict.fromkeys(scenes))
    return Rules(
        reads=(*(folder for scene in places for folder in scene_paths(scene)), *also, *_cache()),
        memory=memory_to_run(0, scenes=len(places)),
    )


def fence_in_server(bundle: Bundle, *, port: int) -> None:
    """Fence this process in, which serves a policy, before it opens it.

    It may listen, but open no connection; its memory has no limit, each client takes some.

    Args:
        bundle: of the policy.
        port: where it will listen; 0 = any.
    """
    if not 0 < port < _FREE_PORTS:  # Others take a capability.
        give_up()
    raise_fence(reads=_files(bundle), writes=(), network="server")


def _kernels(bundle: Bundle) -> tuple[Kernels, ...]:
    return ("networks",) if bundle.card.needs_executor else ()


def why_off(*, code: bool, render: Backend = "cpu", in_process: bool = False) -> str:
    """Return why a process that runs trials is not fenced in; empty if it is.

    Args:
        code: whether sensors of the card are Python code that may run. It runs beside the world
            that it measures; code of a policy runs in the policy's process, which is fenced.
        render: the splat renderer.
        in_process: whether trials run in the calling process.
    """
    if in_process:
        return "in the calling process"
    if code:
        return "--allow-code"
    return "--render cuda" if render == "cuda" else ""


def _files(bundle: Bundle) -> tuple[Path, ...]:
    return (bundle.folder.resolve(), *(path.resolve() for path in bundle.files))


def robots_kept() -> tuple[Path, ...]:
    """Return the folder of the cache in which robots are kept; none where it cannot be made."""
    try:
        return (cache_dir("robots"),)
    except StoreError:
        return ()


def _cache() -> tuple[Path, ...]:
    try:
        return (cache_dir(),)
    except StoreError:  # It is not a folder, or full; whoever needs it says so.
        return ()


def _size(*files: Path) -> int:
    try:
        return sum(path.stat().st_size for path in files)
    except OSError:  # It is gone; whoever reads it says so.
        return 0
