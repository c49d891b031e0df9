"""Robots of folders, compiled once and kept in the user's cache.

What is kept follows from the bytes of the folder's files, this package's code and MuJoCo, whose
digest is its name, with the folder's path: what a confined process packed of a third party's folder
can stand for no other one. It is JSON, whose decimals are the same numbers again, to the bit.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter

from nw_base.errors import StoreError
from nw_base.files.cache import cache_dir, read_sealed, sealed_path
from nw_base.files.inside import bounded_bytes, inside
from nw_scenes.robots.derived import spec_of
from nw_scenes.robots.folder import MESH_BYTES, RobotFolder, digest_of
from nw_scenes.robots.spec import RobotSpec

_LARGEST = 2**28
"""Bytes of a robot, unpacked: more than all meshes that a folder may have take as text."""


@dataclass(frozen=True)
class _Kept:
    spec: RobotSpec
    notes: tuple[str, ...]
    __pydantic_config__ = ConfigDict(
        ser_json_bytes="base64", val_json_bytes="base64", ser_json_inf_nan="constants"
    )


def kept_spec(folder: RobotFolder) -> tuple[RobotSpec, tuple[str, ...]]:
    """Return the robot of a folder, and notes on what of it is not drawn, or not simulated.

    It is taken from the cache; on first use it is compiled, and kept where the cache can be
    written.

    Raises:
        RobotError: as `spec_of`.
    """
    # A file that is not there, or damaged, is written anew.
    with suppress(StoreError, OSError, ValueError, zlib.error):
        unpacking = zlib.decompressobj()
        text = unpacking.decompress(read_sealed(_path(folder.path, folder.digest)), _LARGEST)
        if unpacking.eof:
            kept = TypeAdapter(_Kept).validate_json(text)
            return kept.spec, kept.notes
    spec, notes = spec_of(folder), notes_of(folder)
    _write(folder.path, folder.digest, packed(spec, notes))
    return spec, notes


def notes_of(folder: RobotFolder) -> tuple[str, ...]:
    """Return notes on what of a robot that was compiled is not drawn, or not simulated."""
    said = (f"not simulated: {each}" for each in folder.account.sentences())
    return (*folder.notes, *said)


def packed(spec: RobotSpec, notes: tuple[str, ...]) -> bytes:
    """Return what is kept of a robot."""
    return zlib.compress(TypeAdapter(_Kept).dump_json(_Kept(spec, notes)), 1)


def keep(folder: Path, files: Sequence[str], content: bytes) -> None:
    """Keep what a confined process packed of a robot, as that of the files as they are here.

    Nothing is kept where a file cannot be read, or the cache not be written.

    Args:
        folder: of the robot.
        files: that are read of it, `robot.yaml` among them.
        content: from `packed`.
    """
    with suppress(ValueError, OSError):
        read = {name: bounded_bytes(inside(folder, name), MESH_BYTES) for name in files}
        seen = {name: hashlib.sha256(each).hexdigest() for name, each in read.items()}
        _write(folder, digest_of(seen), content)


def _write(folder: Path, digest: str, content: bytes) -> None:
    with suppress(StoreError), sealed_path(_path(folder, digest)) as temporary:
        temporary.write_bytes(content)


def _path(folder: Path, digest: str) -> Path:
    key = hashlib.sha256(
        f"{_code()}{digest}{folder.resolve()}".encode(errors="surrogateescape")
    ).hexdigest()
    return cache_dir("robots") / f"{key[:32]}.json.z"


@cache
def _code() -> str:
    """Return a digest of what makes robots of files."""
    own = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    libraries = " ".join(f"{name} {version(name)}" for name in ("mujoco", "numpy", "trimesh"))
    return hashlib.sha256(own + libraries.encode()).hexdigest()
