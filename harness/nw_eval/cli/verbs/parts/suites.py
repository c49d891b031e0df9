"""`nw-eval suites`: which suites there are."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Suites:
    """List the suites that can be asked for by name: scenes, trials, bar, policy, purpose."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.suites import suite_table

        print(suite_table(api.list_suites()))
        return 0
