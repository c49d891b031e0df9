"""What a report's numbers can tell and what they cannot, in a few sentences."""

from __future__ import annotations

from nw_eval.gate.verdict import Verdict
from nw_eval.plural import plural
from nw_eval.protocol import PROTOCOLS, STRICT
from nw_eval.reporting.baseline import against_baseline
from nw_eval.reporting.headline import confidence
from nw_eval.results.provenance import RunInfo

_PINNED = (
    "The panel of starts is pinned, the suite's own. On it success is known, not estimated: the "
    "same trial gives the same bits. Whoever picks the best of many checkpoints on one panel of "
    "starts picks luck too: --panel fresh draws the checkpoint's own, to confirm the choice on."
)
_FRESH = (
    "The panel of starts is fresh: it follows from what the checkpoint computes: nobody chose "
    "the checkpoint by these starts, nor the starts for it."
)
_CHANCES = (
    "The chances that more trials decide come from simulated trials, in which every waypoint of a "
    "scene is reached with one chance; what that is, beyond what was seen, is left open."
)
_SAME_OFFSETS = (
    "The protocol {protocol} gives trial number i the same start offset in every scene, so "
    "scenes are not independent of each other, as the bounds suppose."
)


def how_sure(verdict: Verdict, run: RunInfo) -> tuple[str, ...]:
    """Return the sentences that apply to this run; none for one without results, or a part."""
    if verdict.success is None or run.shard is not None:
        return ()
    sentences = [_bounds(verdict), _FRESH if run.panel == "fresh" else _PINNED]
    if verdict.against is not None:
        sentences += against_baseline(verdict.against)
    if verdict.verdict == "INCONCLUSIVE":
        sentences.append(_CHANCES)
    critical = sum(item.tier == "critical" for item in verdict.per_scene)
    if critical and verdict.bar is not None:
        sentences.append(_alone(verdict, critical))
    protocol = PROTOCOLS.get(str(run.suite.get("protocol")), STRICT)
    if protocol.one_start_for_all_scenes:
        sentences.append(_SAME_OFFSETS.format(protocol=protocol.name))
    return tuple(sentences)


def _bounds(verdict: Verdict) -> str:
    return (
        f"The bounds hold for fresh starts in these scenes, {confidence(verdict)} each, whatever "
        "the distribution of success, and however often trials are added and judged again. They "
        "say nothing of other scenes."
    )


def _alone(verdict: Verdict, critical: int) -> str:
    return (
        f"{plural(critical, 'critical scene')} can convict alone, by an upper bound below the bar; "
        "few trials show that only of a scene far below it. So a REGRESSED is wrong with a "
        f"probability of at most {200 * (1 - verdict.confidence):.3g} %: half of it for the mean, "
        "half for the critical scenes together."
    )
