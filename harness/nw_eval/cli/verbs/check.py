"""`nw-eval check`: what would run, without running it."""

from __future__ import annotations

from dataclasses import dataclass, field

import tyro

from nw_eval.cli.verbs.options import Options


@dataclass(frozen=True, kw_only=True)
class Check(Options):
    """Say what a suite would run: scenes, trials, digests, expected minutes. Runs no physics.

    Takes the options of `run`. Tells everything that is wrong with the suite, its scenes and its
    policy at once (exit code 2).
    """

    suite: tyro.conf.Positional[str] = field()
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them)."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.forecast import forecast_page

        print(forecast_page(api.check(self.request, workers=self.workers)))
        return 0
