"""What is said at the end of a training, and its exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.cli.terminal.interruption import INTERRUPTED

if TYPE_CHECKING:
    from nw_eval.learn.progress import Trained


def end_of_training(trained: Trained) -> int:
    """Say how far a training came and how to go on; return the exit code."""
    if not trained.is_done:
        more = f"go on with: nw-eval train {trained.program} --resume {trained.folder}"
        print(clean(f"stopped after {trained.step:,} steps; {more}"))
    print(clean(f"policy: {trained.policy}"))
    return INTERRUPTED if trained.is_interrupted else 0
