"""What travels from the head to the nodes of a cluster: files, known by what is in them.

What a node has got from the heads of runs is kept in its cache by digest, and checked at every use.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import mkdtemp
from typing import TYPE_CHECKING

from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import atomic_path, cache_dir, private_dir
from nw_base.files.inside import inside
from nw_policies.cards.motors import NetworkMotor
from nw_sim.catalogue import scene_files

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from nw_eval.engine.plan import Plan
    from nw_policies import Bundle

    Fetch = Callable[[str], Iterable[bytes]]
    """Returns the pieces of the file of a sha256."""

_FILES = 4096
_BYTES = 2**33
"""Of one file bundle: the largest published scene has 1.3 GB. A larger folder holds other things,
too."""
_UNSENT = frozenset({"__pycache__", ".git"})
_FOLDER = "received"


@dataclass(frozen=True, kw_only=True)
class Item:
    """One file of a file bundle."""

    name: str
    """Relative, with slashes."""
    sha256: str
    size: int


@dataclass(frozen=True, kw_only=True)
class FileBundle:
    """Files that lie beside each other."""

    reference: str
    """What jobs call it; empty for files of the cache, which code finds by their names there."""
    entry: str = ""
    """What lies in it under that reference, relative to its folder."""
    prefix: str = ""
    """What a reference to it begins with, before the path."""
    items: tuple[Item, ...]

    @property
    def digest(self) -> str:
        """Hex sha256 of names and contents."""
        content = [(item.name, item.sha256) for item in self.items]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


class Outgoing:
    """The file bundles of a run, and where on this machine their files lie.

    Args:
        plan: what is to be run; its splats are compiled.

    Raises:
        UsageError: a folder holds more than a file bundle may, or a link instead of a file.
    """

    def __init__(self, plan: Plan) -> None:
        self.sources: dict[str, Path] = {}
        """By sha256."""
        self.file_bundles = tuple(self._file_bundles(plan))

    def _file_bundles(self, plan: Plan) -> Iterator[FileBundle]:
        bundle, checkpoint = plan.bundle, plan.request.checkpoint
        if bundle.card_path is not None:
            files = _policy_files(bundle, bundle.card_path)
            yield self._packed(files, reference=bundle.reference, entry=bundle.card_path.name)
        if checkpoint is not None:
            name = checkpoint.name
            yield self._packed({name: checkpoint}, reference=str(checkpoint), entry=name)
        if (motion := plan.suite.motion) is not None:
            yield self._packed({motion.name: motion}, reference=str(motion), entry=motion.name)
        if plan.robot_folder is not None:
            files = _all_below(plan.robot_folder)
            yield self._packed(files, reference=str(plan.robot_folder))
        for found in plan.found:
            own = scene_files(found.reference)
            if own is not None:
                yield self._packed(
                    own.files, reference=found.reference, entry=own.entry, prefix=own.prefix
                )
        if plan.renders:
            root = cache_dir().resolve()
            splats = [path for scene in plan.scenes for path in scene.splat_stores()]
            for splat in splats:  # One each: a node may have some of them.
                yield self._packed({splat.resolve().relative_to(root).as_posix(): splat})

    def _packed(
        self, files: Mapping[str, Path], *, reference: str = "", entry: str = "", prefix: str = ""
    ) -> FileBundle:
        items: list[Item] = []
        size = 0
        for name in sorted(files):
            items.append(self._item(name, files[name]))
            size += items[-1].size
            if len(items) > _FILES or size > _BYTES:
                raise UsageError(
                    f"{reference} has over {_FILES} files or {_BYTES // 2**30} GiB beside it, too "
                    "many to send to other machines",
                    fix="put what belongs to the run into a folder of its own",
                )
        return FileBundle(reference=reference, entry=entry, prefix=prefix, items=tuple(items))

    def _item(self, name: str, path: Path) -> Item:
        try:
            with path.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
                size = os.fstat(file.fileno()).st_size
        except OSError as error:
            raise UsageError(
                f"{path} cannot be read: {error.strerror or error}", fix="check its rights"
            ) from error
        self.sources[sha256] = path
        return Item(name=name, sha256=sha256, size=size)


def _policy_files(bundle: Bundle, card_path: Path) -> dict[str, Path]:
    """Return card and all files that it names; with Python code, all that lies below the folder.

    Code may read whatever lies beside it, and its digest is that of the whole folder.
    """
    if bundle.code_sha256:
        return _all_below(card_path.parent)
    named = {} if bundle.card.checkpoint is None else {"": bundle.card.checkpoint.file}
    named |= {name: network.checkpoint.file for name, network in bundle.card.networks.items()}
    motion = bundle.card.reference and bundle.card.reference.file
    named |= {"reference": motion} if motion else {}
    motors = [one for one in bundle.card.control.motors or () if isinstance(one, NetworkMotor)]
    named |= {f"motors {number}": one.file for number, one in enumerate(motors)}
    files = [card_path.name, *(PurePosixPath(file).as_posix() for file in named.values())]
    # Where a checkpoint of the caller's replaces the card's, that one may be missing.
    return {name: path for name in files if (path := card_path.parent / name).is_file()}


def _all_below(folder: Path) -> dict[str, Path]:
    """Return all files below a folder by their names.

    Raises:
        UsageError: one is a link, which would be another one elsewhere.
    """
    found: dict[str, Path] = {}
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if name not in _UNSENT)
        for path in (Path(where, name) for name in sorted([*names, *folders])):
            if path.is_symlink():
                raise UsageError(
                    f"{path} is a link, and code that has links does not travel",
                    fix="restore the file, or use --engine local",
                )
            if path.is_file():
                found[path.relative_to(folder).as_posix()] = path
        if len(found) > _FILES:
            break  # The caller says so.
    return found


def missing(file_bundles: Iterable[FileBundle]) -> tuple[str, ...]:
    """Return the sha256 of all files that a node lacks, or has only damaged ones of."""
    lacking = (
        item.sha256
        for file_bundle in file_bundles
        for item in file_bundle.items
        if _lacks(file_bundle, item)
    )
    return tuple(dict.fromkeys(lacking))


def receive(file_bundles: Iterable[FileBundle], fetch: Fetch) -> None:
    """Keep file bundles, each of them whole or not at all.

    Several runs, and several nodes that share a cache, wait for each other: what one of them got,
    the next one finds.

    Args:
        file_bundles: what the run needs.
        fetch: called for the files that are not there.

    Raises:
        StoreError: a file is not what was sent, or the cache cannot be written.
    """
    with _one_at_a_time():
        for file_bundle in file_bundles:
            lacking = [item for item in file_bundle.items if _lacks(file_bundle, item)]
            if lacking and file_bundle.reference:
                _keep_folder(file_bundle, fetch)
            for item in lacking if not file_bundle.reference else ():
                with atomic_path(inside(cache_dir(), item.name)) as temporary:
                    _write(temporary, item, fetch(item.sha256))


def places(file_bundles: Iterable[FileBundle]) -> Mapping[str, str]:
    """Return where on this node lies what jobs refer to."""
    return {
        file_bundle.reference: f"{file_bundle.prefix}{_place(file_bundle) / file_bundle.entry}"
        for file_bundle in file_bundles
        if file_bundle.reference
    }


def _place(file_bundle: FileBundle) -> Path:
    return private_dir(_FOLDER) / file_bundle.digest[:32] if file_bundle.reference else cache_dir()


def _lacks(file_bundle: FileBundle, item: Item) -> bool:
    try:
        with inside(_place(file_bundle), item.name).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() != item.sha256
    except (OSError, ValueError):
        return True


def _keep_folder(file_bundle: FileBundle, fetch: Fetch) -> None:
    place = _place(file_bundle)
    temporary = Path(mkdtemp(dir=place.parent, prefix=".incoming."))
    try:
        for item in file_bundle.items:
            path = inside(temporary, item.name)
            path.parent.mkdir(parents=True, exist_ok=True)
            _write(path, item, fetch(item.sha256))
        shutil.rmtree(place, ignore_errors=True)  # Damaged, if there is one.
        temporary.rename(place)
    except OSError as error:
        raise StoreError(
            f"cannot write {place}: {error.strerror or error}",
            fix="free space in the cache, or set NW_EVAL_CACHE to another folder",
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _write(path: Path, item: Item, pieces: Iterable[bytes]) -> None:
    digest = hashlib.sha256()
    with path.open("wb") as file:
        for piece in _bounded(item, pieces):
            digest.update(piece)
            file.write(piece)
    if digest.hexdigest() != item.sha256:
        raise StoreError(
            f"{item.name} arrived as {digest.hexdigest()[:12]}, {item.sha256[:12]} was announced",
            fix="run again when no program writes to it",
        )


def _bounded(item: Item, pieces: Iterable[bytes]) -> Iterator[bytes]:
    left = item.size
    for piece in pieces:
        left -= len(piece)
        if left < 0:
            return  # Its digest says the rest.
        yield piece


@contextmanager
def _one_at_a_time() -> Generator[None]:
    with (private_dir(_FOLDER) / ".lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
