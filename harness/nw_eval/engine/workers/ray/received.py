"""What a node has got from the heads of runs: kept in its cache by digest, checked at every use."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path, cache_dir, private_dir
from nw_eval.files.inside import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from nw_eval.engine.workers.ray.parcels import Item, Parcel

    Fetch = Callable[[str], Iterable[bytes]]
    """Returns the pieces of the file of a sha256."""

_FOLDER = "received"


def missing(parcels: Iterable[Parcel]) -> tuple[str, ...]:
    """Return the sha256 of all files that a node lacks, or has only damaged ones of."""
    lacking = (item.sha256 for parcel in parcels for item in parcel.items if _lacks(parcel, item))
    return tuple(dict.fromkeys(lacking))


def receive(parcels: Iterable[Parcel], fetch: Fetch) -> None:
    """Keep parcels, each of them whole or not at all.

    Several runs, and several nodes that share a cache, wait for each other: what one of them got,
    the next one finds.

    Args:
        parcels: what the run needs.
        fetch: called for the files that are not there.

    Raises:
        StoreError: a file is not what was sent, or the cache cannot be written.
    """
    with _one_at_a_time():
        for parcel in parcels:
            lacking = [item for item in parcel.items if _lacks(parcel, item)]
            if lacking and parcel.reference:
                _keep_folder(parcel, fetch)
            for item in lacking if not parcel.reference else ():
                with atomic_path(inside(cache_dir(), item.name)) as temporary:
                    _write(temporary, item, fetch(item.sha256))


def places(parcels: Iterable[Parcel]) -> Mapping[str, str]:
    """Return where on this node lies what jobs refer to."""
    return {
        parcel.reference: f"{parcel.prefix}{_place(parcel) / parcel.entry}"
        for parcel in parcels
        if parcel.reference
    }


def _place(parcel: Parcel) -> Path:
    return private_dir(_FOLDER) / parcel.digest[:32] if parcel.reference else cache_dir()


def _lacks(parcel: Parcel, item: Item) -> bool:
    try:
        with inside(_place(parcel), item.name).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() != item.sha256
    except (OSError, ValueError):
        return True


def _keep_folder(parcel: Parcel, fetch: Fetch) -> None:
    place = _place(parcel)
    temporary = Path(mkdtemp(dir=place.parent, prefix=".incoming."))
    try:
        for item in parcel.items:
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
            fix="run again once nobody writes to it any more",
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
