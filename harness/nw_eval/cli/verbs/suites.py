"""`nw-eval suites`: which suites there are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import ListedSuite


@verb_of("list_suites")
class Suites(Printed, Verb):
    """List the named suites: scenes, trials, bar, policy, purpose."""

    def show(self, result: Sequence[ListedSuite]) -> str:
        return suite_table(result)


def suite_table(suites: Sequence[ListedSuite]) -> str:
    """Return a line for each suite: name, scenes and trials, bar, purpose; or what is wrong."""
    if not suites:
        return "no suites: neither shipped, nor in ./suites"
    lines = aligned([(suite.name, *_words(suite)) for suite in suites])
    if any(suite.baseline is not None for suite in suites):
        lines.append(
            "+ baseline: it counts for this policy of the suite; --baseline names one for others"
        )
    return "\n".join(lines)


def _words(suite: ListedSuite) -> tuple[str, str, str, str]:
    if suite.problem is not None:
        return "?", "?", "?", suite.problem
    bar = "no bar" if suite.bar is None else f"bar {suite.bar:g}"
    own = suite.policy if suite.baseline is None else f"{suite.policy} + baseline"
    return f"{plural(suite.scenes, 'scene')} x {suite.trials}", bar, own, suite.purpose
