"""`nw-eval cache`: the results of earlier runs that a run takes over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class ShowCache:
    """Say where the cache of trials lies, how full it is, and of which policies."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.cache import cache_page

        print(cache_page(api.cache_info()))
        return 0


@dataclass(frozen=True, kw_only=True)
class PruneCache:
    """Remove the trials that have not been used for longest, until the rest is within a size."""

    limit: float | None = None
    """The size in GB, 0 for an empty cache; NW_EVAL_CACHE_GB or 5 when absent, which every run
    keeps to anyway."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.cache import removed_line

        print(removed_line(api.prune_cache(self.limit)))
        return 0


@dataclass(frozen=True, kw_only=True)
class VerifyCache:
    """Read every kept row and log, and remove those that are not what was written.

    Compares the checksum of each row and the SHA-256 of each log. Exit code 4 if one was damaged;
    no run would have taken it over. Nothing is run: that trials still come to the results that are
    kept, each run finds out for 2 % of those that it takes over.
    """

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.cache import verified_line
        from nw_eval.errors import StoreError

        checked = api.verify_cache()
        print(verified_line(checked))
        return StoreError.exit_code if checked.removed else 0


@dataclass(frozen=True, kw_only=True)
class CacheOfTrials:
    """Look into the results of earlier runs that a run takes over, prune or verify them."""

    action: (
        Annotated[ShowCache, tyro.conf.subcommand("info")]
        | Annotated[PruneCache, tyro.conf.subcommand("prune")]
        | Annotated[VerifyCache, tyro.conf.subcommand("verify")]
    )

    def __call__(self) -> int:
        return self.action()
