"""The command line: `verbs`, a small module each; all of them call `nw_eval.api`.

Exit codes: 0 PASS or RAN (a suite without a bar), 1 REGRESSED, 2 usage, suite, scene or policy
error, 3 INCONCLUSIVE, 4 infrastructure error, 5 invalid comparison, 130 interrupted.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_DESCRIPTION = """Decides whether a legged-robot policy checkpoint is good enough to ship.
It evaluates the checkpoint in simulated scenes, synthetic ones or scans, and
returns a verdict as an exit code."""


def main(argv: Sequence[str] | None = None) -> None:
    """Run one verb and leave with its exit code; every error is one line on stderr.

    Args:
        argv: the arguments; None = those of this process, which then is the command line's own:
            its signals, its streams, its end.
    """
    # Nothing is imported before signals have somewhere to go, or Ctrl-C would show a traceback.
    from nw_eval.cli.terminal.interruption import leave_at_signals

    if argv is None:
        leave_at_signals()
        from nw_eval.cli.process import run_process

        run_process(description=_DESCRIPTION)
    from nw_eval.cli.process import end_of

    sys.exit(end_of(argv, description=_DESCRIPTION).code)
