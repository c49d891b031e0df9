"""`nw-eval cache`: the results of earlier runs that a run takes over."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.plural import plural
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import CacheCleanup, CacheUse


@verb_of("cache_info")
class ShowCache(Verb):
    """Say where the cache of trials lies, how full it is, and of which policies."""

    def show(self, found: CacheUse) -> str:
        return cache_page(found)


@verb_of("prune_cache", flags=("limit_gb",), named={"limit_gb": "limit"})
class PruneCache(Verb):
    """Remove the trials that have not been used for longest, until the rest is within a size."""

    def show(self, found: CacheCleanup) -> str:
        return removed_line(found)


@verb_of("verify_cache")
class VerifyCache(Verb):
    """Read every kept row and log, and remove those that are not what was written.

    Compares the checksum of each row and the SHA-256 of each log. Exit code 4 if one was damaged;
    no run would have taken it over. Nothing is run: that trials still come to the results that are
    kept, each run finds out for 2 % of those that it takes over.
    """

    def show(self, found: CacheCleanup) -> str:
        return verified_line(found)

    def code(self, found: CacheCleanup) -> int:
        return StoreError.exit_code if found.removed else 0


_SHOWN = 20
"""Policies that are listed."""


def cache_page(use: CacheUse) -> str:
    """Return how full the cache is, and of what."""
    limit = f"of at most {_size(use.limit)}" if use.limit else "NW_EVAL_CACHE_GB=0 keeps nothing"
    lines = [
        f"folder     {use.folder}",
        f"size       {_size(use.bytes)}, {limit}",
        f"trials     {use.entries:,}",
    ]
    if use.oldest is not None:
        since = datetime.fromtimestamp(use.oldest, UTC)
        lines.append(f"last used  {since:%Y-%m-%d %H:%M} UTC or later, each of them")
    if use.damaged:
        lines.append(f"unusable   {use.damaged:,}; `nw-eval cache verify` removes them")
    for name, count in use.policies[:_SHOWN]:
        lines.append(f"  {count:>8,} {clean(name, at_most=60)}")
    if more := use.policies[_SHOWN:]:
        lines.append(f"  {sum(count for _, count in more):>8,} of {len(more)} more policies")
    return "\n".join(lines)


def removed_line(removed: CacheCleanup) -> str:
    """Return what was removed, and what is left."""
    return (
        f"{plural(removed.removed, 'trial')} removed ({_size(removed.bytes)}), "
        f"{removed.left:,} left ({_size(removed.left_bytes)}) in {removed.folder}"
    )


def verified_line(checked: CacheCleanup) -> str:
    """Return how many entries were read, and how many were damaged."""
    damaged = f"{checked.removed:,} damaged and removed" if checked.removed else "none damaged"
    return f"{plural(checked.looked_at, 'trial')} read, {damaged}; nothing was run"


def _size(count: int) -> str:
    """Return bytes as GB or MB."""
    return f"{count / 1e9:.2f} GB" if count >= 10**8 else f"{count / 1e6:.1f} MB"
