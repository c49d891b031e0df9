"""What `verify` prints: a line for each thing, as many as somebody reads, in harmless words."""

from pathlib import Path

from nw_base.errors import IncomparableError
from nw_eval.api.verifying import VerifiedRun
from nw_eval.cli.verbs.verify import verification_lines
from nw_gate.results.evidence_check import CheckedFiles, Discrepancy
from nw_sim.rollout.replaying.reports import Difference, RepeatedTrial, Repeats

WHOLE = {"remarks": (), "rows": 100, "logs": 100, "log_bytes": 5_000_000, "root": "ab" * 32}


def trial(**changes):
    facts = {"trial": "t", "steps": 7, "differences": (), "partings": {}, "log": "same"}
    return RepeatedTrial(**{**facts, **changes})


def lines(findings=(), **repeats):
    files = CheckedFiles(findings=tuple(findings), **WHOLE)
    again = Repeats(seed=3, of=100, **repeats) if repeats else None
    return verification_lines(VerifiedRun(folder=Path(), files=files, repeats=again)).splitlines()


def test_a_run_of_which_everything_was_changed_is_told_in_some_lines():
    found = lines(
        Discrepancy(what="changed", file="journal.jsonl", trial=f"t{n}") for n in range(99)
    )
    assert found[0] == "changed: journal.jsonl: the row of t0"
    assert found[20:22] == [
        "and 79 more",
        "NOT as the run ended: 99 findings in 100 rows and 100 logs of 5.0 MB",
    ]
    assert len(found) == 23


def test_words_of_strangers_are_harmless():
    name = "mcap/\x1b[2Jx\n::error::y.mcap"
    (first, *_) = lines([Discrepancy(what="extra", file=name)])
    assert first == "extra: mcap/\\x1b[2Jx ::error::y.mcap"


def test_what_differs_is_named_with_the_step_at_which_logs_part():
    difference = Difference(name="state_digest", recorded="ab" * 32, now="cd" * 32)
    other = trial(differences=(difference,), partings={"image": 60, "state": 57}, log="compared")
    found = lines(trials=(other, trial(log="gone"), trial(fault="crashed: killed")))
    parts = "state in its log from step 57 on; image in its log from step 60 on"
    assert found[2:] == [
        f"t: OTHER BITS: state_digest was abababababab, now cdcdcdcdcdcd; {parts}",
        "t: the same in 7 steps: states and actions; there is no log to compare images with",
        "t: no result now: crashed: killed",
        "re-run: 1 of 3 trials identical, drawn from 100 by --seed 3",
    ]


def test_why_nothing_was_run_again_is_said():
    found = lines(unable=IncomparableError("another machine", fix="go there"))
    assert found[-1] == "nothing was re-run: another machine; go there"
