"""How each scene did, as one state and one sentence: for reports that list tests, not numbers.

No list of tests contradicts the verdict: a scene fails only where the run does not pass, and is
passed only in a run that passes. A scene of which nothing was shown is skipped, with the reason.
`suite_lines` says where a suite's file speaks of a scene: the line that a reader of a failure is
led to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np

from nw_base.plural import plural
from nw_eval.suite.load import folder_names
from nw_gate.results.provenance import RunInfo
from nw_gate.verdict import SceneDrop, SceneScore, Verdict

State = Literal[
    "failed", "error", "unjudged", "unseen", "weak", "undecided", "informational", "fine"
]
"""failed: the scene regressed significantly and the run does not pass, or the run is REGRESSED and
the scene lies below the bar. error: trials of it are missing or ended in errors, and the run is
INFRASTRUCTURE. unjudged: the run is INVALID. unseen: too many of its trials left the captured
volume to say anything of it. weak: it fell or lies below the bar, and the verdict does not rest on
it. undecided: the gate has shown nothing of it. informational: it counts for no verdict. fine: the
run passes, with this scene. Worst first."""

Result = Literal["failed", "error", "skipped", "passed"]
"""What becomes of a scene's test, in pytest and in JUnit alike."""

_RESULTS: Mapping[State, Result] = {
    "failed": "failed",
    "error": "error",
    "unjudged": "skipped",
    "unseen": "skipped",
    "weak": "skipped",
    "undecided": "skipped",
    "informational": "skipped",
    "fine": "passed",
}

_ORDER = tuple(_RESULTS)


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

    @property
    def result(self) -> Result:
        """What becomes of its test."""
        return _RESULTS[self.state]


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
    word, faults = verdict.verdict, _faults(score, own, verdict)
    named = score.flagged or any(item.named for item in own)
    state: State = "weak" if faults else "undecided"
    before, after = [*faults], _standing(verdict)
    holes = score.errors or score.missing or not (score.n or score.outside)
    if word == "INVALID":
        state, before, after = "unjudged", ["not judged: the verdict is INVALID"], []
    elif word == "INFRASTRUCTURE" and holes:
        state, before, after = "error", _holes(score), []
    elif score.tier == "informational":
        state = "weak" if faults else "informational"
        before, after = ["informational, not judged", *faults], []
    elif faults and (word == "REGRESSED" or (named and word == "INCONCLUSIVE")):
        state, after = "failed", []
    elif score.unseen:
        state, after = "unseen", []
    elif word == "PASS" and not faults and not _scored_nothing(score, own):
        state, after = "fine", []
    sentence = "; ".join([*before, *_outside(score), _success(score, own), *after])
    if state == "undecided" and _never_ran(score):
        sentence = f"not run: the verdict was decided without it{_baseline(own)}"
    elif state == "undecided":
        sentence = f"{'not judged' if word == 'RAN' else 'not decided'}: {sentence}"
    return SceneState(score=score, state=state, sentence=sentence, drops=own)


def _never_ran(score: SceneScore) -> bool:
    """Return whether no trial of a scene ran and none is missing: the run ended early."""
    return not (score.n or score.errors or score.outside or score.missing)


def _scored_nothing(score: SceneScore, drops: Sequence[SceneDrop]) -> bool:
    """Return whether a scene has no result, or nothing but failures where the baseline has more.

    A PASS of the mean of all scenes shows nothing of it then.
    """
    if score.mean is None:
        return True
    return score.mean == 0.0 and any((item.baseline or 0.0) > 0.0 for item in drops)


def _standing(verdict: Verdict) -> list[str]:
    """Return why the verdict says nothing of a scene, or what would."""
    if verdict.verdict == "INCONCLUSIVE":
        return ["run more trials"]
    if verdict.verdict == "INFRASTRUCTURE":
        return ["the verdict is INFRASTRUCTURE; nw-eval run --resume runs what is missing"]
    if verdict.verdict == "RAN":
        return ["the verdict is RAN, which means only that the trials ran"]
    return [f"the verdict is {verdict.verdict}, and does not rest on this scene alone"]


def _faults(score: SceneScore, drops: Sequence[SceneDrop], verdict: Verdict) -> list[str]:
    """Return what speaks against a scene alone: a significant drop, or its own interval."""
    faults = [_fell(item) for item in drops if item.named]
    if score.flagged:
        faults.append(f"critical, and below the bar {verdict.bar:g} by its upper bound")
    elif score.weak:
        faults.append(f"below the bar {verdict.bar:g} by itself")
    return faults


def _fell(item: SceneDrop) -> str:
    """Return how a scene fell against the baseline."""
    now = "none" if item.candidate is None else f"{item.candidate:.2f}"
    where = "" if item.waypoint is None else f", worse from waypoint {item.waypoint}"
    cell = item.name.removeprefix(item.scene).strip()
    return f"regressed from {item.baseline:.2f} to {now}{where}{f' at {cell}' if cell else ''}"


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


def _success(score: SceneScore, drops: Sequence[SceneDrop]) -> str:
    """Return what a scene scored, and the baseline in it."""
    if score.mean is None:
        none = "no trial has a result" if not score.outside else "no other trial has a result"
        return f"{none}{_baseline(drops)}"
    trials = f"{score.completed} of {plural(score.n, 'trial')}"
    return f"success {score.mean:.3f}, completed {trials}{_baseline(drops)}"


def _baseline(drops: Sequence[SceneDrop]) -> str:
    """Return what the baseline scored in a scene; empty where that is not known."""
    known = [item.baseline for item in drops if item.baseline is not None]
    return f", baseline {np.mean(known):.3f}" if known and len(known) == len(drops) else ""


@dataclass(frozen=True, kw_only=True)
class SuiteLines:
    """A suite's file, and the line, from 1, of each scene and of the gate.

    A scene's line is that of the entry that names it, or else of the first glob that means it.
    """

    file: str
    """As seen from the folder that was asked for, with slashes."""
    scenes: Mapping[str, int]
    gate: int


def suite_lines(run: RunInfo, root: Path) -> SuiteLines | None:
    """Return the lines of a run's suite; None where its file is gone or not below a folder.

    Args:
        run: the run.
        root: the folder that paths are shown from: a repository's.
    """
    from nw_base.files.yaml_file import YamlProblems, read_yaml

    name = Path(run.suite_file)
    path = (Path(run.suite_folder) / name.name if run.suite_folder else name).resolve()
    root = root.resolve()
    if not path.is_relative_to(root):
        return None
    try:
        file = read_yaml(path)
    except YamlProblems:
        return None
    entries = file.data.get("scenes")
    named = [str(entry) for entry in entries] if isinstance(entries, list) else []
    lines = [file.place(("scenes", index))[0] for index in range(len(named))]
    return SuiteLines(
        file=path.relative_to(root).as_posix(),
        scenes={
            scene: _line(scene, named, lines) or file.place(("scenes",))[0] for scene in run.scenes
        },
        gate=file.place(("gate",))[0],
    )


def _line(scene: str, named: list[str], lines: list[int]) -> int | None:
    """Return the line of the entry that means a scene: exact names win over globs and folders."""
    for means in (str.__eq__, fnmatchcase, _is_folder_of):
        for entry, line in zip(named, lines, strict=True):
            if means(scene, entry):
                return line
    return None


def _is_folder_of(scene: str, entry: str) -> bool:
    """Whether an entry is the path of a folder that a scene may be called after."""
    return scene in folder_names(entry)
