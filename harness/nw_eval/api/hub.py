"""Scenes, policies and robots of a hub: fetched ahead of a run, and pushed."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_scenes.hub import FetchListener
    from nw_scenes.hub.reference import Fetched

_BESIDE = ("README.md", "LICENSE", "LICENSE.md", "LICENSE.txt", "NOTICE")
"""What is pushed of a scene's folder besides the files that the scene is made of."""


@dataclass(frozen=True, kw_only=True)
class PushedScene:
    """A scene as it lies on a hub."""

    reference: str
    """`hub:org/name@commit`: what names this very revision, for ever."""
    files: tuple[str, ...]
    bytes: int
    """Of all files together."""


def fetch_scene(
    reference: str,
    *,
    file: str | PathLike[str] | None = None,
    listener: FetchListener | None = None,
) -> Fetched:
    """Return a scene as its hub has it now, fetched as far as it is not on this machine.

    Runs use it without a network from then on. What they find missing they fetch by themselves.

    Args:
        reference: `hub:org/name[@revision]`, `neverwhere:NAME` for a scene of the release, or
            `real:NAME`.
        file: of `real:NAME`, the file itself, fetched on another machine; None = it is fetched.
        listener: receives how far it is.

    Raises:
        SceneError: there is no such scene, or it is none; or not for this user.
        FetchError: the hub cannot be reached or fails; the next call goes on from what came.
        PrerequisiteError: the extra `hub` is not installed.
        StoreError: it cannot be kept.
    """
    from nw_sim import catalogue

    file = as_path(file)
    with _heard(listener):
        return catalogue.fetch_scene(reference, file=file)


def fetch_policy(reference: str, *, listener: FetchListener | None = None) -> Fetched:
    """Return a policy as its hub has it now, fetched as far as it is not on this machine.

    Nothing of it is run, and its code never without `allow_code`.

    Args:
        reference: `hub:org/name`, or `hub:org/name@revision`.
        listener: receives how far it is.

    Raises:
        PolicyError: there is no such policy, or it has no card; or not for this user.
        FetchError, PrerequisiteError, StoreError: as `fetch_scene`.
    """
    from nw_policies.bundle import card_of_fetched
    from nw_scenes.hub.fetch import fetch
    from nw_scenes.hub.reference import parse

    with _heard(listener):
        fetched = fetch(parse(reference, "policy"))
    card_of_fetched(fetched)
    return fetched


def fetch_robot(reference: str, *, listener: FetchListener | None = None) -> Fetched:
    """Return a robot as its hub, or MuJoCo Menagerie, has it now, fetched as far as it is not here.

    Of Menagerie it is the revision that the installed package `mujoco-menagerie` has.

    Args:
        reference: `hub:org/name`, `hub:org/name@revision`, or `menagerie:NAME`.
        listener: receives how far it is.

    Raises:
        RobotError: there is no such robot, or it cannot be used; or not for this user.
        FetchError, StoreError: as `fetch_scene`.
        PrerequisiteError: the extra `hub`, or `robots`, is not installed.
    """
    from nw_scenes.hub.fetch import fetch
    from nw_scenes.hub.reference import parse
    from nw_scenes.robots import find_robot

    with _heard(listener):
        fetched = fetch(parse(reference, "robot"))
        find_robot(reference)
    return fetched


def push_scene(folder: str | PathLike[str], to: str, *, private: bool = False) -> PushedScene:
    """Put a scene folder into a repository of a hub, in one commit, and return where it lies.

    The files that the scene is made of are pushed, and README and licence if they lie beside it;
    others are not.

    Args:
        folder: the folder, with its scene.yaml.
        to: `hub:org/name`; a missing repository is created.
        private: create a private repository.

    Raises:
        SceneError: it is not a scene folder, or its health check finds errors; or the hub does not
            let this user.
        UsageError: `to` names a revision.
        FetchError: the hub cannot be reached or fails; nothing was changed.
        PrerequisiteError: the extra `hub` is not installed.
    """
    from nw_base.errors import SceneError
    from nw_scenes.folder import folder_files, load_folder
    from nw_scenes.hub.client import push
    from nw_scenes.hub.reference import parse
    from nw_sim.catalogue import inspect_scene

    folder = as_path(folder)
    reference = parse(to, "scene")
    files = folder_files(folder)
    faults = [str(each) for each in inspect_scene(folder).findings if each.severity == "error"]
    if faults:
        raise SceneError((f"{folder} is not pushed as it is:", *faults), fix="fix the scene first")
    beside = {name: folder / name for name in _BESIDE}
    files |= {name: path for name, path in beside.items() if _is_own_file(path)}
    commit = push(
        reference,
        dict(sorted(files.items())),
        private=private,
        message=f"{load_folder(folder).name}, pushed by nw-eval",
    )
    return PushedScene(
        reference=f"{reference.text}@{commit}",
        files=tuple(sorted(files)),
        bytes=sum(path.stat().st_size for path in files.values()),
    )


def _is_own_file(path: Path) -> bool:
    """Whether a file lies there itself: a link may lead outside of the folder."""
    return path.is_file() and not path.is_symlink()


@contextmanager
def _heard(listener: FetchListener | None) -> Generator[None]:
    from nw_scenes.hub import heard_by

    if listener is None:  # Whoever listens already.
        yield
        return
    with heard_by(listener):
        yield
