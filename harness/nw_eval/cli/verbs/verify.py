"""`nw-eval verify`: whether a run's rows and logs are as they were, and trials give them again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Say whether rows and logs of a run are as they were when it ended, and name what is not.

    Then run some of its trials again, drawn by a seed that nobody can foresee, and compare states,
    actions and images bit for bit. Nothing is written into the run's folder.
    """

    run: tyro.conf.Positional[Path]
    """The folder of a run."""
    offline: bool = False
    """Look at its files only, and run nothing."""
    sample: Annotated[str | None, tyro.conf.arg(metavar="N%|N")] = None
    """Run again so many of the trials that have a result, at least one; 5% when absent."""
    seed: int | None = None
    """Draw the trials of an earlier verification again, which printed this number."""
    root: Annotated[str | None, tyro.conf.arg(metavar="HEX")] = None
    """The Merkle root that the run ended with, if you have kept it elsewhere."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """The bundle that made it, when it has moved since."""
    checkpoint: Path | None = None
    """The weights that were used in place of the card's, when they have moved since."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.api.verifying.sample import SAMPLE
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.text.verification import verification_lines

        self._check()
        with RunProgress() as progress:
            verified = api.verify(
                self.run,
                offline=self.offline,
                sample=SAMPLE if self.sample is None else self.sample,
                seed=self.seed,
                root=self.root,
                policy=self.policy,
                checkpoint=self.checkpoint,
                allow_code=self.allow_code,
                workers=self.workers,
                listener=progress,
            )
        print(verification_lines(verified))
        if verified.interrupted:
            tell("interrupted; not all of the trials that were drawn have run")
            return INTERRUPTED
        return verified.exit_code

    def _check(self) -> None:
        from nw_eval.errors import UsageError

        run = {"--sample": self.sample, "--seed": self.seed, "--policy": self.policy}
        used = [option for option, value in run.items() if value is not None]
        if self.offline and used:
            raise UsageError(
                f"{used[0]} is for running trials again, --offline runs none", fix="drop one"
            )
