"""`nw-eval blame`: from when on a run's failures could not be averted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class Blame:
    """Find for each failed trial of a run the latest moment from which a baseline completes it.

    The trial goes its recorded way, and the baseline takes over at moments spread evenly over it,
    then by bisection after the last of them from which it completes. Between two moments that were
    tried nothing is known; where it is not so that it completes from all moments before and from
    none after, the answer says so.

    With --cause: perception or control? Old and new control run with old and new sight, in the
    trials of the run, and the drop is parted into what is due to either; reports of the run say so.
    """

    run: tyro.conf.Positional[Path]
    """A run's folder, with its mcap/."""
    baseline: str
    """Who takes over: the policy of a baseline (its name or path), which must be the very one; or,
    where the run's suite has no such baseline, a policy (a bundle's name, folder or card)."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Where the baseline's policy lies, if not where the baseline says."""
    checkpoint: Path | None = None
    """Weights in place of those that its card names."""
    at_most: int = 10
    """Trials to look at, the worst first: each takes about as long as ten others."""
    cause: bool = False
    """Exchange sight and control between the run's policy and the baseline's."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """With --cause: trials in each scene; the run's own number when absent."""
    out: Path | None = None
    """Write the answer to this file as well: a .md or a .json. With --cause, the new folder of the
    four policies' runs; one in the run's folder when absent."""
    allow_code: bool = False
    """Let `python:` adapters import code."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""

    def __call__(self) -> int:
        return self._cause() if self.cause else self._since_when()

    def _cause(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.text.table import aligned
        from nw_eval.reporting.cause.words import answer_words, cause_table

        with RunProgress() as progress:
            found = api.find_cause(
                self.run,
                baseline=self.baseline,
                policy=self.policy,
                checkpoint=self.checkpoint,
                trials=self.trials,
                workers=self.workers,
                allow_code=self.allow_code,
                out=self.out,
                listener=progress,
            )
        table = cause_table(found.cause)
        print("\n".join(aligned([table.columns, *table.rows], right={2, 3, 4})))
        print(answer_words(found.cause))
        page = api.report(self.run).page
        print(f"{found.out / 'cause.md'}; in the run's report, too: {page}")
        return 0

    def _since_when(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.text.blame import blame_page, forecast_line, trial_line, written

        if self.out is not None:
            self._check_out(self.out)
        blames = api.blame(
            self.run,
            baseline=self.baseline,
            policy=self.policy,
            checkpoint=self.checkpoint,
            at_most=self.at_most,
            workers=self.workers,
            allow_code=self.allow_code,
            planned=lambda plan: tell(forecast_line(plan)),
            ended=lambda trial: tell(trial_line(trial)),
        )
        print(blame_page(blames))
        if self.out is not None:
            from nw_eval.files.cache import atomic_path, followed

            with atomic_path(followed(self.out)) as temporary:
                temporary.write_text(written(blames, self.out.suffix), encoding="utf-8")
            print(self.out)
        return 0

    @staticmethod
    def _check_out(out: Path) -> None:
        from nw_eval.errors import UsageError

        if out.suffix not in {".md", ".json"}:
            raise UsageError(f"--out {out} is neither .md nor .json", fix="give it one ending")
