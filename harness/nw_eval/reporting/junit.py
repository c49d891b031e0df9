"""A judged run as JUnit XML: a test case for each scene and ladder, and one for the verdict.

There is no standard; what stands here is the core that the schemas of Ant and Jenkins share. Names
of test cases are those of scenes and tasks, so that a server's history of a case goes on from push
to push. Every text is cleaned, hence free of characters that XML forbids.

Properties say in numbers what test cases come from: success with its intervals, trials, digests.
`effect` and `baseline_effect` are what `success` and `baseline_success` were called until 0.1; they
go with the next release.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from junitparser import Attr, Error, Failure, IntAttr, JUnitXml, Skipped, TestCase, TestSuite
from junitparser.junitparser import FinalResult, Properties, Property

from nw_base.clean import clean
from nw_base.errors import NwEvalError
from nw_eval.reporting.headline import blind_spot, headline
from nw_eval.reporting.scene_states import SceneState, State, SuiteLines, scene_states
from nw_eval.reporting.tables.table import judged
from nw_eval.reporting.tables.trials import replay_command, worst_trials
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Comparison, LimitFinding, Verdict, Word

_MESSAGE = 1000  # characters of a message; a body has a line for each reason
_REPLAYED = 3  # trials of a scene whose replay a failure names


class _Case(TestCase):
    """A test case with the file and line that it comes from, which servers link to."""

    file = Attr()
    line = IntAttr()


def junit_xml(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    lines: SuiteLines | None,
) -> bytes:
    """Return the XML of a judged run; its failures and errors are those of the verdict.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it; replay commands start with it.
        lines: where the suite's file speaks of its scenes; None if no reader can look there.
    """
    by_scene: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.trial_id):
        by_scene.setdefault(row.scene, []).append(row)
    name = str(run.suite.get("name", "suite"))
    cases = [
        _scene_case(state, by_scene.get(state.scene, ()), verdict, name, folder, lines)
        for state in scene_states(verdict)
    ]
    cases += [_limit_case(item, name, lines) for item in verdict.limits]
    return _document(
        name, [*cases, _verdict_case(verdict, run, name, lines)], run_properties(run, verdict), run
    )


def junit_of_error(suite: str, error: NwEvalError) -> bytes:
    """Return the XML of a run that an error kept from a verdict: one case, with that error.

    Args:
        suite: what was to be run, as it was typed.
        error: what happened.
    """
    case = _Case("verdict", f"nw.{clean(suite)}")
    case.result = _result(Error, type(error).__name__, str(error).splitlines())
    problem = next(iter(error.problems), None)
    if problem is not None:
        case.file, case.line = clean(problem.file), problem.line
    return _document(suite, [case], {"exit_code": str(error.exit_code)})


def _document(
    name: str, cases: Iterable[_Case], properties: Mapping[str, str], run: RunInfo | None = None
) -> bytes:
    suite = TestSuite(clean(name))
    for key, value in properties.items():
        suite.add_property(key, clean(value))
    suite.add_testcases(list(cases))
    if run is not None:
        suite.timestamp, suite.hostname = clean(run.started), clean(run.machine.host)
    document = JUnitXml("nw-eval")
    document.append(suite)
    document.update_statistics()
    return b"<?xml version='1.0' encoding='utf-8'?>\n" + document.tostring() + b"\n"


def _scene_case(
    state: SceneState,
    rows: Sequence[Row],
    verdict: Verdict,
    suite: str,
    folder: Path,
    lines: SuiteLines | None,
) -> _Case:
    case = _Case(
        clean(state.scene),
        f"nw.{clean(suite)}",
        round(sum(row.wall_s for row in rows if not row.cached), 3),
    )
    if lines is not None:
        case.file, case.line = clean(lines.file), lines.scenes.get(state.scene, lines.gate)
    worst = worst_trials(judged(rows, verdict))[:_REPLAYED]
    commands = [command for row in worst if (command := replay_command(row, folder))]
    _add_properties(case, scene_properties(state, rows, worst))
    body = [state.sentence, *commands]
    if state.result == "failed":
        case.result = _result(Failure, "regressed", body)
    elif state.result == "error":
        failed = [f"{row.trial_id}: {row.error_text}" for row in rows if row.status == "error"]
        case.result = _result(Error, "infrastructure", [state.sentence, *failed[:_REPLAYED]])
    elif state.result == "skipped":
        kind = _SKIPPED.get(state.state, state.state)
        case.result = _result(Skipped, kind, [state.sentence])
    else:
        case.system_out = "\n".join(clean(line) for line in body)
    return case


def _limit_case(item: LimitFinding, suite: str, lines: SuiteLines | None) -> _Case:
    """Return the case of a ladder: one that is not judged is skipped."""
    case = _Case(clean(item.ladder), f"nw.{clean(suite)}")
    if lines is not None:
        case.file, case.line = clean(lines.file), lines.gate
    _add_properties(case, limit_properties(item))
    kind = _KINDS.get(item.word) if item.word is not None else Skipped
    if kind is None:
        case.system_out = clean(item.sentence)
    else:
        case.result = _result(kind, (item.word or "unjudged").lower(), [item.sentence])
    return case


def _verdict_case(verdict: Verdict, run: RunInfo, suite: str, lines: SuiteLines | None) -> _Case:
    case = _Case("verdict", f"nw.{clean(suite)}")
    if lines is not None:
        case.file, case.line = clean(lines.file), lines.gate
    body = [headline(verdict, run), blind_spot(verdict, run), *verdict.reasons]
    kind = _KINDS.get(verdict.verdict)
    if kind is None:
        case.system_out = "\n".join(clean(line) for line in body)
    else:
        case.result = _result(kind, verdict.verdict.lower(), body)
    return case


_KINDS: Mapping[Word, type[Failure | Error]] = {
    "REGRESSED": Failure,
    "INCONCLUSIVE": Failure,
    "INFRASTRUCTURE": Error,
    "INVALID": Error,
}
"""Verdicts that are no pass, as JUnit has them; `type` says the word, in small letters."""
_SKIPPED: Mapping[State, str] = {"unjudged": "invalid", "unseen": "left_capture"}
"""Types of skipped cases whose states have other names."""


def _result(kind: type[FinalResult], word: str, body: Sequence[str]) -> FinalResult:
    """Return a result whose message is the first line of its body."""
    result = kind(clean(body[0], at_most=_MESSAGE) if body else word, word)
    result.text = "\n".join(clean(line) for line in body)
    return result


def _add_properties(case: _Case, values: Mapping[str, str]) -> None:
    properties = Properties()
    for key, value in values.items():
        properties.add_property(Property(key, clean(value)))
    case.append(properties)


def run_properties(run: RunInfo, verdict: Verdict) -> dict[str, str]:
    """Return what is known of a whole run: where it comes from, its verdict, and its drop."""
    against = {} if verdict.against is None else _of_comparison(verdict.against)
    return {**_provenance(run), **_of_verdict(verdict), **against}


def scene_properties(
    state: SceneState, rows: Sequence[Row], worst: Sequence[Row]
) -> dict[str, str]:
    """Return what is known of one scene.

    Args:
        state: how it did.
        rows: its own.
        worst: those of them that did not complete, those first that got least far.
    """
    score = state.score
    mean = None if score.mean is None else f"{score.mean:.6f}"
    known = {} if mean is None else {"success": mean, "effect": mean}
    against = {
        f"drop{_cell(item.perturbation)}": f"{item.drop:z.6f}"
        for item in state.drops
        if item.drop is not None
    }
    log = {"mcap": worst[0].mcap_path} if worst and worst[0].mcap_path else {}
    return {
        "state": state.state,
        "tier": score.tier,
        "trials": str(score.n),
        "errors": str(score.errors),
        **({"left_capture": str(score.outside)} if score.outside else {}),
        "completed": str(score.completed),
        **known,
        "ci_low": f"{score.interval.low:.6f}",
        "ci_high": f"{score.interval.high:.6f}",
        **against,
        **({"scene_digest": rows[0].scene_digest} if rows else {}),
        **log,
    }


def limit_properties(item: LimitFinding) -> dict[str, str]:
    """Return what is known of the policy's limit on a ladder, in the ladder's unit."""
    values: dict[str, str] = {"state": item.word or "unjudged"}
    for prefix, limit in (("", item.candidate), ("baseline_", item.baseline)):
        if limit is not None:
            low, high = limit.lower, limit.upper
            values |= {} if low is None else {f"{prefix}cleared": f"{low.value:.6g}"}
            values |= {} if high is None else {f"{prefix}not_cleared": f"{high.value:.6g}"}
    if item.candidate is not None:
        values |= {"unit": item.candidate.ladder.unit, "trials": str(len(item.candidate.trials))}
    return values


def _cell(perturbation: Sequence[tuple[str, float]]) -> str:
    return "".join(f" {axis} {value:g}" for axis, value in perturbation)


def _of_verdict(verdict: Verdict) -> dict[str, str]:
    success = "" if verdict.success is None else f"{verdict.success:.6f}"
    return {
        "verdict": verdict.verdict,
        "exit_code": str(verdict.exit_code),
        "success": success,
        "effect": success,
        "ci_low": f"{verdict.interval.low:.6f}",
        "ci_high": f"{verdict.interval.high:.6f}",
        "confidence": f"{verdict.confidence:g}",
        "bar": "" if verdict.bar is None else f"{verdict.bar:g}",
        "trials": str(verdict.n),
        "planned": str(verdict.planned),
        "errors": str(verdict.errors),
        **({"left_capture": str(len(verdict.left))} if verdict.left else {}),
        **{
            f"score_{item.spec.name}": f"{item.mean:.6g}"
            for item in verdict.scores
            if item.mean is not None
        },
        **{f"score_{item.spec.name}_verdict": item.word for item in verdict.scores if item.word},
    }


def _of_comparison(found: Comparison) -> dict[str, str]:
    drops = found.interval
    return {
        "baseline": found.baseline_name,
        "baseline_success": f"{found.baseline:.6f}",
        "baseline_effect": f"{found.baseline:.6f}",
        "drop": "" if found.drop is None else f"{found.drop:z.6f}",
        "drop_low": "" if drops is None else f"{drops.low:z.6f}",
        "drop_high": "" if drops is None else f"{drops.high:z.6f}",
        "max_drop": f"{found.max_drop:g}",
        "tolerate": f"{found.tolerate:g}",
        "drop_trials": str(found.trials),
    }


def _provenance(run: RunInfo) -> dict[str, str]:
    return {
        "run": run.id,
        "nw_eval": run.code.version,
        "policy": run.policy.folder_name,
        "checkpoint": run.policy.checkpoint_digest,
        "panel_digest": run.suite_digest,
        "rows_digest": run.rows_digest,
    }
