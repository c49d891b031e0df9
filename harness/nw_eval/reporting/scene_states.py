"""How each scene did, as one state and one sentence: for reports that list tests, not numbers.

The states follow the verdict, so that no list of tests contradicts it: a scene fails only where the
run is REGRESSED, and a scene that is weak in a run that passes is told, and passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from nw_eval.gate.baseline.comparison import SceneDrop
from nw_eval.gate.verdict import SceneScore, Verdict
from nw_eval.plural import plural

State = Literal["failed", "error", "unjudged", "unseen", "weak", "fine"]
"""failed: the run is REGRESSED, and this scene fell or lies below the bar. error: trials of it are
missing or ended in errors, and the run is INFRASTRUCTURE. unjudged: the run is INVALID. unseen: too
many of its trials left the captured volume to say anything of it. weak: it fell or lies below the
bar, and the verdict is another. Worst first."""

_ORDER: tuple[State, ...] = ("failed", "error", "unjudged", "unseen", "weak", "fine")


@dataclass(frozen=True, kw_only=True)
class SceneState:
    """How one scene did."""

    score: SceneScore
    state: State
    sentence: str
    drops: tuple[SceneDrop, ...] = ()
    """What it shows against the baseline, for each cell of perturbations."""

    @property
    def scene(self) -> str:
        """The scene's name."""
        return self.score.scene


def scene_states(verdict: Verdict) -> tuple[SceneState, ...]:
    """Return the state of every scene, in the verdict's order, which is the alphabet's."""
    drops: dict[str, list[SceneDrop]] = {}
    for item in () if verdict.against is None else verdict.against.scenes:
        drops.setdefault(item.scene, []).append(item)
    return tuple(_state(score, drops, verdict) for score in verdict.per_scene)


def worst_first(states: Sequence[SceneState]) -> tuple[SceneState, ...]:
    """Return scenes by their state; within one critical ones first, then the lowest success."""

    def rank(item: SceneState) -> tuple[int, bool, float, str]:
        known = -1.0 if item.score.mean is None else item.score.mean
        return _ORDER.index(item.state), item.score.tier != "critical", known, item.scene

    return tuple(sorted(states, key=rank))


def _state(
    score: SceneScore, drops: Mapping[str, Sequence[SceneDrop]], verdict: Verdict
) -> SceneState:
    own = tuple(drops.get(score.scene, ()))
    faults = _faults(score, own, verdict)
    state: State = "weak" if faults else "fine"
    if verdict.verdict == "INVALID":
        state = "unjudged"
    elif verdict.verdict == "INFRASTRUCTURE" and (
        score.errors or score.missing or not (score.n or score.outside)
    ):
        state, faults = "error", _holes(score)
    elif verdict.verdict == "REGRESSED" and faults and score.tier != "informational":
        state = "failed"
    elif score.unseen:
        state = "unseen"
    sentence = "; ".join([*faults, *_outside(score), _success(score, verdict)])
    return SceneState(score=score, state=state, sentence=sentence, drops=own)


def _faults(score: SceneScore, drops: Sequence[SceneDrop], verdict: Verdict) -> list[str]:
    """Return what speaks against a scene by itself: beyond doubt, or its own interval."""
    faults = [_fell(item) for item in drops if item.named]
    if score.condemned:
        faults.append(f"critical, and certainly below the bar {verdict.bar:g} by itself")
    elif score.weak:
        faults.append(f"below the bar {verdict.bar:g} by itself")
    return faults


def _fell(item: SceneDrop) -> str:
    """Return how a scene fell against the baseline."""
    now = "none" if item.candidate is None else f"{item.candidate:.2f}"
    where = "" if item.waypoint is None else f", from waypoint {item.waypoint} on"
    cell = item.name.removeprefix(item.scene).strip()
    return f"fell from {item.baseline:.2f} to {now}{where}{f' at {cell}' if cell else ''}"


def _holes(score: SceneScore) -> list[str]:
    """Return what is missing of a scene."""
    holes = [f"{plural(score.errors, 'trial')} ended in errors"] if score.errors else []
    if score.missing:
        holes.append(f"{plural(score.missing, 'trial')} missing")
    return holes or ["no result"]


def _outside(score: SceneScore) -> list[str]:
    """Return how many trials of a scene left the captured volume."""
    if not score.outside:
        return []
    trials = plural(score.outside + score.n, "trial")
    return [f"{score.outside} of {trials} left the captured volume and are counted apart"]


def _success(score: SceneScore, verdict: Verdict) -> str:
    """Return what a scene scored."""
    if score.mean is None:
        return "no trial has a result" if not score.outside else "no other trial has a result"
    percent = f"{100 * verdict.confidence:.4g} %"
    return (
        f"success {score.mean:.3f} ({percent} {score.interval.low:.2f} to "
        f"{score.interval.high:.2f}), completed {score.completed} of {score.n}"
    )
