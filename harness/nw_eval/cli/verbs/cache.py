"""`nw-eval cache`: the results of earlier runs that a run takes over."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.plural import plural
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import CacheCleanup, CacheUse


@verb_of("cache_info")
class ShowCache(Printed, Verb):
    """Show where the trial cache is, how full it is, and which policies it has results of."""

    def show(self, result: CacheUse) -> str:
        return cache_page(result)


@verb_of("prune_cache", flags=("limit_gb",), named={"limit_gb": "limit"})
class PruneCache(Verb):
    """Remove the least recently used trials until the cache fits a size."""

    def show(self, result: CacheCleanup) -> str:
        return removed_line(result)


@verb_of("verify_cache")
class VerifyCache(Verb):
    """Check every cached row and log, and remove damaged ones.

    Compares each row's checksum and each log's SHA-256. Exit code 4 if one was damaged. Nothing is
    re-run: each run re-runs 2 % of the trials that it reuses.
    """

    def show(self, result: CacheCleanup) -> str:
        return verified_line(result)

    def code(self, result: CacheCleanup) -> int:
        return StoreError.exit_code if result.removed else 0


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
