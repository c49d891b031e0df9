"""The cache of trials: what it holds, and keeping it small and whole."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import UsageError

if TYPE_CHECKING:
    from nw_eval.engine.cache import CacheEntry, Kept, TrialStore

_GB = 10**9


@dataclass(frozen=True, kw_only=True)
class CacheUse:
    """How full the cache of trials is."""

    folder: Path
    entries: int
    bytes: int
    limit: int
    """Bytes that it may have; 0 where nothing is kept at all."""
    policies: tuple[tuple[str, int], ...]
    """Names of policies, each with its number of trials; those of most trials first."""
    damaged: int
    """What takes up room and is no entry that can be used."""
    oldest: float | None
    """When the entry was last used that was not for longest, s since 1970; None without any."""


@dataclass(frozen=True, kw_only=True)
class CacheCleanup:
    """What was removed from the cache of trials, and what is left."""

    folder: Path
    looked_at: int
    removed: int
    bytes: int
    """Of what was removed; a log that a run's folder has too goes on taking them there."""
    left: int
    left_bytes: int


def cache_info() -> CacheUse:
    """Return how full the cache of trials is, and of what.

    Raises:
        StoreError: its folder cannot be used.
        UsageError: `NW_EVAL_CACHE_GB` is no size.
    """
    from nw_eval.engine.cache import limit_bytes

    limit, store = limit_bytes(), _store()
    entries = [(kept, _entry(kept)) for kept in store]
    good = [(kept, entry) for kept, entry in entries if entry is not None]
    names = Counter(entry.row.policy for _, entry in good)
    return CacheUse(
        folder=store.folder,
        entries=len(good),
        bytes=sum(kept.bytes for kept, _ in entries),
        limit=limit,
        policies=tuple(names.most_common()),
        damaged=len(entries) - len(good),
        oldest=min((kept.used for kept, _ in good), default=None),
    )


def prune_cache(limit_gb: float | None = None) -> CacheCleanup:
    """Remove the entries that have not been used for longest, until the cache is within a size.

    Args:
        limit_gb: the size in GB; 0 empties the cache (default: `NW_EVAL_CACHE_GB` or 5, which every
            run applies anyway).

    Raises:
        StoreError: its folder cannot be used.
        UsageError: an invalid size.
    """
    from nw_eval.engine.cache import limit_bytes

    if limit_gb is not None and not 0.0 <= limit_gb < float("inf"):
        raise UsageError(f"--limit {limit_gb:g} is not a size", fix="give a size in GB, 0 or more")
    limit = limit_bytes() if limit_gb is None else round(limit_gb * _GB)
    store = _store()
    before = len(list(store))
    return _removed(store, store.prune(limit), looked_at=before)


def verify_cache() -> CacheCleanup:
    """Read every entry and its log, and remove those that are not what was written.

    Nothing is run: that a trial still comes to the result that is kept, each run finds out for some
    of those that it takes over.

    Raises:
        StoreError: its folder cannot be used.
    """
    from nw_eval.engine.cache import remove

    store = _store()
    kept = list(store)
    damaged: list[Kept] = []
    for each in kept:
        if not _is_whole(each):
            try:
                remove(each.path)
            except OSError:
                continue  # It stays what it was: no entry.
            damaged.append(each)
    return _removed(store, damaged, looked_at=len(kept))


def _store() -> TrialStore:
    from nw_eval.engine.cache import TrialStore

    return TrialStore.of_user()


def _entry(kept: Kept) -> CacheEntry | None:
    from nw_eval.engine.cache import NO_ENTRY, read_entry

    try:
        return read_entry(kept.path)
    except NO_ENTRY:
        return None


def _is_whole(kept: Kept) -> bool:
    from nw_eval.engine.cache import NO_ENTRY

    entry = _entry(kept)
    if entry is None:
        return False
    try:
        entry.check_log()
    except NO_ENTRY:
        return False
    return True


def _removed(store: TrialStore, removed: list[Kept], *, looked_at: int) -> CacheCleanup:
    left = list(store)
    return CacheCleanup(
        folder=store.folder,
        looked_at=looked_at,
        removed=len(removed),
        bytes=sum(each.bytes for each in removed),
        left=len(left),
        left_bytes=sum(each.bytes for each in left),
    )
