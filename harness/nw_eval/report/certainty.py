"""What a report's numbers can tell and what they cannot, in a few sentences."""

from __future__ import annotations

from nw_eval.gate.verdict import Verdict
from nw_eval.report.headline import confidence, count
from nw_eval.results.provenance import RunInfo


def how_sure(verdict: Verdict, run: RunInfo) -> tuple[str, ...]:
    """Return the sentences that apply to this run."""
    if verdict.effect is None:
        return ()
    told = [
        f"The bounds hold for fresh starts in these scenes, {confidence(verdict)} each, whatever "
        "the distribution of success and however often whole rounds (one more trial in every "
        "scene) are added and judged again. They say nothing of other scenes.",
        "On the starts that the suite's seed names, success is known, not estimated: the same "
        "trial gives the same bits. Whoever picks the best of many checkpoints on one panel of "
        "starts picks luck too; --seed draws another panel to confirm the choice on.",
    ]
    if verdict.drop_passes is not None:
        told.append(
            f"{verdict.drop:.2f} worse means: in every scene the odds of reaching the next "
            "waypoint are lower by one factor, so that mean success is "
            f"{verdict.effect - verdict.drop:.3f}. Runs of such a policy were simulated and "
            "judged as this one."
        )
    critical = sum(item.tier == "critical" for item in verdict.per_scene)
    if critical and verdict.bar is not None:
        told.append(
            f"{count(critical, 'critical scene')} can convict alone, by an upper bound below the "
            "bar. So a REGRESSED is wrong with a probability of at most "
            f"{200 * (1 - verdict.confidence):.3g} %: half of it for the mean, half for the "
            "critical scenes together. Few trials convict only a scene far below the bar."
        )
    if run.suite.get("protocol") == "neverwhere-2026":
        told.append(
            "The protocol neverwhere-2026 gives trial number i the same start offset in every "
            "scene, so scenes are not independent of each other as the bounds suppose."
        )
    return tuple(told)
