"""What every tracker gets of a judged run: words, numbers, files and clips, by keys.

W&B, MLflow and TensorBoard forbid different characters and lengths; letters, digits, `_`, `-`, `.`
and slashes between them are fine in all. MLflow keeps a metric as a file of its key's path, so that
no key may be the folder of another.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from typing import get_args

from nw_base.clean import clean
from nw_base.errors import PrerequisiteError, UsageError, nearest
from nw_base.words import Tracker
from nw_eval.reporting.headline import blind_spot, headline
from nw_eval.reporting.html.evidence import Clip
from nw_gate.results.provenance import RunInfo
from nw_gate.verdict import Comparison, Verdict

TRACKERS: tuple[Tracker, ...] = get_args(Tracker)


def check_trackers(names: Iterable[str]) -> None:
    """Check, without importing them, that trackers are known and installed.

    Raises:
        UsageError: there is none of that name.
        PrerequisiteError: its library is not installed.
    """
    for name in names:
        if name not in TRACKERS:
            raise UsageError(f"--track {name}: no such tracker", fix=nearest(name, TRACKERS))
        if find_spec(name) is None:
            raise PrerequisiteError(
                f"--track {name} needs {name}, which is not installed",
                fix=f"pip install 'nw-eval[{name}]'",
            )


def track(name: Tracker, run: TrackedRun) -> None:
    """Show a run in a tracker; a second time, what is there is replaced.

    Raises:
        Exception: whatever the tracker's library raises.
    """
    import_module(f"nw_eval.reporting.trackers.{name}").track(run)


PROJECT = "nw-eval"
"""The project or experiment where nothing else is said, and what keys start with."""


@dataclass(frozen=True, kw_only=True)
class TrackedRun:
    """A judged run, in words and numbers that every tracker takes."""

    id: str
    """The same for the same run, another for every other; letters, digits, `_`, `-` and `.`."""
    title: str
    """Its name for people."""
    place: str
    """What the keys of its suite start with; one checkpoint may meet several suites."""
    begun: datetime
    ended: datetime
    verdict: str
    words: Mapping[str, str]
    """What was said of it and what it is, by key."""
    numbers: Mapping[str, float]
    """Scores by key, finite."""
    folder: Path
    files: tuple[Path, ...]
    """Its report, in all forms that there are."""
    clips: Mapping[str, Clip]
    """Of its worst trials, each by the name of a file."""
    step: int | None = None
    """Of the training that its checkpoint is of; None where it is no part of a curve."""

    def at_step(self, step: int, training: Path) -> TrackedRun:
        """Return the run as a point of the curves of a training.

        Args:
            step: of the training.
            training: the folder that all of its runs have in common. Its name is the run's title.
        """
        name = f"{training.resolve()}\n{self.place}"
        digest = sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:12]
        own = key_of(training.resolve().name)
        return replace(
            self,
            id=f"{own.replace('/', '.')[:40]}-{digest}",
            title=clean(training.resolve().name, at_most=100),
            folder=training,
            step=step,
        )


def tracked_run(
    run: RunInfo,
    verdict: Verdict,
    folder: Path,
    files: tuple[Path, ...],
    clips: Iterable[Clip] = (),
) -> TrackedRun:
    """Return what trackers get of a run.

    Args:
        run: the run's provenance.
        verdict: what the gate says of it.
        folder: the run's.
        files: its report.
        clips: of its worst trials.
    """
    begun = datetime.fromisoformat(run.started)
    location = f"{PROJECT}/{key_of(str(run.suite.get('name', 'suite')))}"
    numbers = _of_all(verdict) | _by_scene(verdict)
    if verdict.against is not None:
        numbers |= _against(verdict.against)
    return TrackedRun(
        id=_id(run),
        title=clean(run.id, at_most=100),
        place=location,
        begun=begun,
        ended=begun if run.finished is None else datetime.fromisoformat(run.finished),
        verdict=verdict.verdict,
        words={f"{location}/{key}": clean(text) for key, text in _words(run, verdict).items()},
        numbers={
            f"{location}/{key}": float(number)
            for key, number in numbers.items()
            if number is not None and math.isfinite(number)
        },
        folder=folder,
        files=files,
        clips={_file_name(clip): clip for clip in clips},
    )


def _id(run: RunInfo) -> str:
    """Return a run's folder with what makes it this run: a folder's name may be used again."""
    parts = (run.id, run.started, run.suite_digest, run.policy.checkpoint_digest)
    digest = sha256("\n".join(parts).encode("utf-8", "surrogatepass")).hexdigest()[:12]
    return f"{key_of(run.id).replace('/', '.')[:40]}-{digest}"


def _file_name(clip: Clip) -> str:
    return f"{key_of(clip.trial_id).replace('/', '.')}.{clip.mime.removeprefix('image/')}"


def _words(run: RunInfo, verdict: Verdict) -> dict[str, str]:
    return {
        "verdict": verdict.verdict,
        "headline": headline(verdict, run),
        "blind_spot": blind_spot(verdict, run),
        "run": run.id,
        "suite_digest": run.suite_digest,
        "policy": run.policy.folder_name,
        "policy_digest": run.policy.short_digest,
        "card_digest": run.policy.card_digest,
        "checkpoint_digest": run.policy.checkpoint_digest,
        "baseline": "none" if verdict.against is None else verdict.against.baseline_name,
        "panel": run.panel,
        "seed": str(run.suite.get("seed", "")),
        "protocol": str(run.suite.get("protocol", "")),
        "version": run.code.version,
        "commit": run.code.commit,
    }


def _of_all(verdict: Verdict) -> dict[str, float | None]:
    return {
        "all/success": verdict.success,
        "all/success_low": verdict.interval.low if verdict.success is not None else None,
        "all/success_high": verdict.interval.high if verdict.success is not None else None,
        "all/completed": verdict.completed,
        "all/trials": verdict.n,
        "all/planned": verdict.planned,
        "all/errors": verdict.errors,
        **({"all/left_capture": len(verdict.left)} if verdict.left else {}),
        "all/exit_code": verdict.exit_code,
        **_of_scores(verdict),
        **_of_limits(verdict),
    }


def _of_scores(verdict: Verdict) -> dict[str, float | None]:
    """Return the declared scores: the mean of all, its change for the worse, and that by scene."""
    scenes = keys_of(score.scene for score in verdict.per_scene)
    numbers: dict[str, float | None] = {}
    for item in verdict.scores:
        name = item.spec.name
        numbers[f"scores/{name}/all"] = item.mean
        if item.drop is not None:
            numbers[f"scores/{name}/drop"] = item.drop
        for scene, mean in item.per_scene.items():
            numbers[f"scores/{name}/scenes/{scenes[scene]}"] = mean
    return numbers


def _of_limits(verdict: Verdict) -> dict[str, float | None]:
    """Return both bounds of the policy's limit on each ladder, in the ladder's unit."""
    keys = keys_of(item.ladder for item in verdict.limits)
    bounds = {
        keys[item.ladder]: (item.candidate.lower, item.candidate.upper)
        for item in verdict.limits
        if item.candidate is not None
    }
    return {
        f"limits/{key}/{name}": bound.value
        for key, both in bounds.items()
        for name, bound in zip(("cleared", "not_cleared"), both, strict=True)
        if bound is not None
    }


def _by_scene(verdict: Verdict) -> dict[str, float | None]:
    keys = keys_of(score.scene for score in verdict.per_scene)
    numbers: dict[str, float | None] = {}
    for score in verdict.per_scene:
        key = keys[score.scene]
        numbers[f"success/{key}"] = score.mean
        numbers[f"completed/{key}"] = score.completed
        numbers[f"trials/{key}"] = score.n
    return numbers


def _against(found: Comparison) -> dict[str, float | None]:
    keys = keys_of(scene.name for scene in found.scenes)
    return {
        "all/baseline": found.baseline,
        "all/drop": found.drop,
        "all/drop_low": None if found.interval is None else found.interval.low,
        "all/drop_high": None if found.interval is None else found.interval.high,
        "all/drop_trials": found.trials,
        **{f"drop/{keys[scene.name]}": scene.drop for scene in found.scenes},
    }


_LONGEST = 100
"""Characters of a key, before its mark: MLflow takes 250 in all, of which others stand before."""
_MARK = re.compile(r"-[0-9a-f]{12}$")


def key_of(name: str) -> str:
    """Return a name as a key of one part or more, between slashes.

    A name that cannot stay as it is gets a mark of its own behind what is left of it; a name that
    ends as if it had one gets one too. So no two names share a key.
    """
    parts = (re.sub(r"[^A-Za-z0-9_.-]+", "_", part).strip(".") for part in name.split("/"))
    key = "/".join(part for part in parts if part)[:_LONGEST].rstrip("/.")
    is_plain = key and key == name and not _MARK.search(key)
    return key if is_plain else _marked(key, name)


def keys_of(names: Iterable[str]) -> dict[str, str]:
    """Return the key of each name; none is the folder of another."""
    keys = {name: key_of(name) for name in names}
    folders = {str(folder) for key in keys.values() for folder in PurePosixPath(key).parents}
    return {
        name: _marked(key, name) if key in folders else key for name, key in sorted(keys.items())
    }


def _marked(key: str, name: str) -> str:
    digest = sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:12]
    return f"{key or 'unnamed'}-{digest}"
