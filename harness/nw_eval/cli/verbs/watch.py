"""`nw-eval watch`: evaluate the checkpoints of a training as they appear."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

import tyro

from nw_base.plural import plural
from nw_eval.cli.verbs.printed import json_line
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_base.words import Tracker
    from nw_eval.api.watching import WatchedCheckpoint, WatchedTraining


def checkpoint_line(made: WatchedCheckpoint) -> str:
    """Return what became of a checkpoint, in a line."""
    if made.problem:
        return f"step {made.step}: {made.name} cannot be used: {made.problem}"
    score = "" if made.success is None else f" · success {made.success:.3f}"
    fell = ""
    if made.drop is not None:
        fell = f" · drop {made.drop:.3f} against step {made.against}"
        if 0 < made.drop_trials < made.trials:
            fell += f" in the {made.drop_trials} trials that settled it"
    return (
        f"step {made.step}: {made.verdict}{score}{fell} · "
        f"completed {made.completed} of {plural(made.trials, 'trial')}"
    )


@verb_of(
    "watch",
    changes=("suite", "scenes", "trials", "allow_code", "workers", "no_cache"),
    without=("where",),
    listens=True,
    heard=checkpoint_line,
)
class Watch(Verb):
    """Evaluate each new checkpoint of a training, newest first, and gate it against the best.

    All checkpoints run the same trials. After each one, --out has its run, a table
    (`watch.parquet`) and a page with success over training steps (`index.html`). Run the same
    command again to resume. The exit code is that of the newest checkpoint's verdict.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.
    goes_on = "interrupted; run the same command again to resume"

    folder: Path
    trials: int | None
    """Trials per scene for each checkpoint (default: the suite's number)."""
    track: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TRACKER[,TRACKER]")
    ] = ()
    """Send scores by training step to trackers: wandb, mlflow, tensorboard."""
    json: bool = False
    """Print a JSON object in a line of its own for each checkpoint, as soon as it is judged."""

    def more(self) -> dict[str, Any]:
        from nw_eval import api

        words = [word.strip() for word in ",".join(self.track).split(",") if word.strip()]
        track = cast("tuple[Tracker, ...]", tuple(dict.fromkeys(words)))
        heard = {"progress": _print_line} if self.json else {}
        return {"where": api.Surfaces(track=track), **heard}

    def show(self, found: WatchedTraining) -> str:
        best = "none has a result" if found.best is None else f"best: {found.best.name}"
        last = f"{plural(len(found.checkpoints), 'checkpoint')}; {best}; page: {found.page}"
        return "\n".join([*map(checkpoint_line, found.checkpoints), last])

    def shown_json(self, found: WatchedTraining) -> str:  # noqa: ARG002
        return ""  # Each checkpoint has had its line.


def _print_line(made: WatchedCheckpoint) -> None:
    print(json_line(made), flush=True)
