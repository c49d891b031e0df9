"""What test cases say in numbers: success with its intervals, trials, digests.

`effect` and `baseline_effect` are what `success` and `baseline_success` were called until 0.1; they
go with the next release.
"""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.gate.verdict import Comparison, Verdict
from nw_eval.reporting.scene_states import SceneState
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row


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
    }


def _of_comparison(found: Comparison) -> dict[str, str]:
    drops = found.interval
    return {
        "baseline": found.bank,
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
        "policy": run.policy.name,
        "checkpoint": run.policy.checkpoint_digest,
        "panel_digest": run.suite_digest,
        "rows_digest": run.rows_digest,
    }
