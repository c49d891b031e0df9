"""`nw-eval limits`: how far a policy can go on ladders of ever harder scenes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.shared import AllowCode, Label, NoCache, Workers

if TYPE_CHECKING:
    from nw_eval.api import FoundLimits


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Find the hardest rung of each ladder that a policy still completes, with bounds.

    A ladder is a series of scenes from easy to hard, such as bars of 0.10 to 0.62 m (`nw-eval
    scenes ladders` lists them). Each next trial is run where it decides most; a ladder usually
    takes 20 to 60 trials. Writes limits.json, limits.md and limits.html.
    """

    ladders: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names or globs of ladders, such as hurdles/bar, or suites with gate.limits (default: all
    built-in ladders of scenes)."""
    policy: Annotated[str, tyro.conf.arg(aliases=["-p"])]
    """A shipped policy's name, a policy folder, a card, or hub:org/name[@revision]."""
    baseline: str | None = None
    """Another policy to compare with, on the same trials and in the same picture."""
    robot: str | None = None
    """A robot's name, such as go1, its folder, hub:org/name[@revision] or menagerie:NAME (default:
    the card's)."""
    checkpoint: Path | None = None
    """Use these weights instead of the card's."""
    share: float = 0.5
    """A rung is cleared if the policy completes at least this share of its trials there."""
    confidence: float = 0.95
    """Confidence level of each bound."""
    width: int = 2
    """A search ends when its bounds are at most this many rungs apart."""
    trials: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 120
    """Trials per ladder. At most N."""
    seed: int = 1
    """Use a different seed for the initial states (default: 1)."""
    out: Path | None = None
    """A new folder (default: `reports/limits-<number>`)."""
    write_suite: Path | None = None
    """Write a suite of the rungs around the limits into this file."""
    workers: Workers = None
    no_cache: NoCache = False
    allow_code: AllowCode = False
    contacts: bool = False
    """Let a trial continue when head or trunk touch something, which ends it otherwise."""
    no_films: bool = False
    """Do not show a trial on either side of each limit on the page, which takes some seconds."""
    label: Label = ()
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.final_output import tell
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_gate.results.labels import typed_labels

        with RunProgress() as progress:
            result = api.limits(
                self.ladders,
                policy=self.policy,
                baseline=self.baseline,
                robot=self.robot,
                checkpoint=self.checkpoint,
                share=self.share,
                confidence=self.confidence,
                width=self.width,
                trials=self.trials,
                seed=self.seed,
                out=self.out,
                write_suite=self.write_suite,
                allow_code=self.allow_code,
                contacts=self.contacts,
                films=not self.no_films,
                workers=self.workers,
                cache=not self.no_cache,
                labels=typed_labels(self.label),
                listener=progress,
            )
        print(limits_json(result) if self.json else limits_text(result))
        if result.interrupted:
            tell(f"interrupted; {self._again()}")
            return INTERRUPTED
        if errors := sum(each.errors for each in result.limits):
            tell(f"{plural(errors, 'trial')} ended in errors; {self._again()}")
            return 4
        if self.write_suite is not None:
            left = ", ".join(result.not_in_suite)
            tell(f"suite written to {self.write_suite}" + (f", without {left}" if left else ""))
        return 0

    def _again(self) -> str:
        """Return how to go on."""
        another = " with another --out" if self.out is not None else ""
        reuses = "" if self.no_cache else ", which reuses the finished trials"
        return f"give the same command{another} again{reuses}"


def limits_json(result: FoundLimits) -> str:
    """Return limits as JSON."""
    from nw_eval.api.climbing import limits_dict

    return json.dumps(limits_dict(result), indent=1)


def limits_text(result: FoundLimits) -> str:
    """Return the table of limits, a sentence for each, and where the files are."""
    from nw_eval.reporting.html.limits import limits_table, limits_words

    table = limits_table(result.limits)
    right = [place for place, name in enumerate(table.columns) if name in table.numbers]
    parts = ["\n".join(aligned([table.columns, *table.rows], right=right))]
    parts.append("\n".join(limits_words(result.limits)))
    parts.append("\n".join(str(result.out / f"limits.{end}") for end in ("html", "md", "json")))
    return "\n\n".join(parts)
