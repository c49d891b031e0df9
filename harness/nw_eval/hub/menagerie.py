"""Robots of MuJoCo Menagerie: `menagerie:NAME`, through the package `mujoco-menagerie`.

The package, an extra, holds a list of robots with their licences and the digest of each archive,
fetches an archive and compares it. What a robot's default model needs of it is kept as a robot's
folder like what comes from a hub, with a robot.yaml that has the name; the rest is derived.
"""

from __future__ import annotations

import platform
import shutil
import tarfile
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import FetchError, PrerequisiteError, nearest
from nw_eval.hub import listener
from nw_eval.hub.fetched import Fetched, digest_of, kept, put_in_place
from nw_eval.hub.reference import Reference

_YAML = """\
# {title} of MuJoCo Menagerie, licence {licence}, revision {revision}.
# All that is not here is derived from the model file.
nw-robot: 1
name: {name}
model: {{file: {file}, sha256: {digest}}}
"""


def bring(reference: Reference) -> Fetched:
    """Return a robot as the installed package has it, fetched as far as it is not kept.

    Raises:
        RobotError: the package knows no such robot, or it has another revision.
        FetchError: it cannot be fetched, or what came is not what the package announces.
        PrerequisiteError: the extra `robots` is not installed.
        OSError: it cannot be kept.
    """
    try:
        module: Any = import_module("mujoco_menagerie")
    except ImportError as error:
        raise PrerequisiteError(
            f"{reference.text} needs the package mujoco-menagerie: {error}",
            fix="pip install 'nw-eval[robots]'",
        ) from None
    if not hasattr(tarfile, "data_filter"):  # The package unpacks archives with it.
        raise PrerequisiteError(
            f"{reference.text} needs Python 3.11.4 or newer, this is {platform.python_version()}",
            fix="use a newer Python, or give robot.yaml and its model as a folder",
        )
    name, installed = reference.label, f"mujoco-menagerie {version('mujoco-menagerie')}"
    try:
        robot = module.get(name)
    except LookupError:
        raise reference.error(
            f"{installed} has no robot {name!r}", fix=nearest(name, module.names())
        ) from None
    if reference.is_pinned and reference.revision != robot.oid:
        raise reference.error(
            f"{installed} has revision {robot.oid} of it",
            fix=f"write {reference.name}, or install the version of the package that has yours",
        )
    found = kept(reference, robot.oid)
    if found is not None:
        return found
    listener().message(f"fetching {reference.name}, revision {robot.oid[:12]}: {installed}")
    try:
        root = robot.path(progress=listener().fetching).resolve()
        entry = robot.default_model
        if robot.default_scene is not None and not _has_pose(robot.files(entry)):
            # Its keyframes stand in the file with the floor, which is left out of a robot.
            scene = robot.default_scene
            entry = scene if _has_pose(robot.files(scene)) else entry
        files = [path.resolve() for path in robot.files(entry)]
    except module.MenagerieError as error:
        raise FetchError(
            f"{reference.text}: {clean(error, at_most=300)}",
            fix="check the network and proxy; what was fetched once needs none",
        ) from None
    own = [path for path in (root / "LICENSE", root / "README.md") if path.is_file()]
    names = sorted({str(path.relative_to(root)) for path in (*files, *own)})

    def fill(folder: Path) -> list[str]:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, folder / name)
        model = robot.entry(entry).file
        text = _YAML.format(
            title=robot.display_name,
            licence=robot.license,
            revision=robot.oid,
            name=robot.name,
            file=model,
            digest=digest_of(folder / model),
        )
        (folder / "robot.yaml").write_text(text, encoding="utf-8")
        return [*names, "robot.yaml"]

    return put_in_place(reference, robot.oid, "mujoco-menagerie", fill)


def _has_pose(files: list[Path]) -> bool:
    """Whether a model has a keyframe, in any of its files."""
    return any(path.suffix == ".xml" and b"<key " in path.read_bytes() for path in files)
