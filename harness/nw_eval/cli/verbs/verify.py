"""`nw-eval verify`: whether a run's rows and logs are as they were, and trials give them again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import VerifiedRun
    from nw_gate.results.evidence_check import CheckedFiles, Discrepancy
    from nw_sim.rollout.replaying.reports import RepeatedTrial, Repeats


@verb_of(
    "verify",
    changes=("allow_code", "workers"),
    metavars={"trials": "N%|N", "root": "HEX"},
    listens=True,
)
class Verify(Printed, Verb):
    """Check a run's results and logs for changes, and re-run a random sample of its trials.

    States, actions and images of the re-run trials must be identical. The run's folder is not
    changed.
    """

    goes_on = "interrupted; not all of the trials that were drawn have run"

    run: Path
    offline: bool
    trials: str | None = None
    seed: int | None
    policy: str | None

    def more(self) -> dict[str, Any]:
        from nw_base.errors import UsageError
        from nw_eval.api.verifying import SAMPLE

        given = {"--trials": self.trials, "--seed": self.seed, "--policy": self.policy}
        used = [option for option, value in given.items() if value is not None]
        if self.offline and used:
            raise UsageError(
                f"{used[0]} is for running trials again, --offline runs none", fix="drop one"
            )
        return {"trials": SAMPLE if self.trials is None else self.trials}

    def show(self, result: VerifiedRun) -> str:
        return verification_lines(result)


_MOST = 20
"""Lines about files; a run may have thousands."""
_DIGEST = 12  # digits that tell two apart


def verification_lines(verified: VerifiedRun) -> str:
    """Return what was found, in lines."""
    lines = [*_files(verified.files)]
    if verified.repeats is not None:
        lines += _repeats(verified.repeats)
    for ladder in verified.ladders:
        name = ladder.folder.relative_to(verified.folder).as_posix()
        lines += [f"{name}: {line}" for line in verification_lines(ladder).splitlines()]
    return "\n".join(clean(line, at_most=2000) for line in lines)


def _files(files: CheckedFiles) -> Iterator[str]:
    yield from (_finding(each) for each in files.findings[:_MOST])
    if len(files.findings) > _MOST:
        yield f"and {len(files.findings) - _MOST} more"
    yield from (f"* {remark}" for remark in files.remarks)
    looked = plural(files.rows, "row")
    if files.logs:
        looked += f" and {plural(files.logs, 'log')} of {files.log_bytes / 1e6:.1f} MB"
    if files.findings:
        yield f"NOT as the run ended: {plural(len(files.findings), 'finding')} in {looked}"
    elif files.root:
        yield f"as the run ended: {looked}"
    else:
        yield f"nothing speaks against {looked}"
    if files.root:
        yield f"Merkle root {files.root}"


def _finding(finding: Discrepancy) -> str:
    row = f": the row of {finding.trial}" if finding.trial and ".mcap" not in finding.file else ""
    about = f": {finding.about}" if finding.about else ""
    return f"{finding.what}: {finding.file}{row}{about}"


def _repeats(repeats: Repeats) -> Iterator[str]:
    if repeats.unable is not None:
        yield f"nothing was re-run: {repeats.unable}"
        return
    if not repeats.of:
        yield "nothing was re-run: no trial has a result"
        return
    yield from map(_trial, repeats.trials)
    same = sum(each.is_identical for each in repeats.trials)
    yield (
        f"re-run: {same} of {plural(len(repeats.trials), 'trial')} identical, drawn "
        f"from {repeats.of} by --seed {repeats.seed}"
    )


def _trial(trial: RepeatedTrial) -> str:
    if trial.fault:
        return f"{trial.trial}: no result now: {trial.fault}"
    if trial.is_identical:
        logs = {
            "same": "states, actions and the log, images included, byte for byte",
            "compared": "states, actions, and what both logs hold, images included",
            "gone": "states and actions; there is no log to compare images with",
        }
        return f"{trial.trial}: the same in {plural(trial.steps, 'step')}: {logs[trial.log]}"
    parts = [
        f"{each.name} was {_short(each.name, each.recorded)}, now {_short(each.name, each.now)}"
        for each in trial.differences
    ]
    parts += [
        f"{kind} in its log from step {step} on"
        for kind, step in sorted(trial.partings.items(), key=lambda item: item[1])
    ]
    return f"{trial.trial}: OTHER BITS: {'; '.join(parts)}"


def _short(name: str, value: str) -> str:
    text = value or "none"
    return text[:_DIGEST] if name.endswith("_digest") else clean(text, at_most=60)
