"""What is to be looked at: a log or run, a scene, or a policy; and what a log or run has to show.

A log or a run has trials by name, their ghosts, and the splat of their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from nw_base.errors import NwEvalError, UsageError
from nw_base.files.inside import what_is
from nw_eval.view.trace import Trace, read_trace
from nw_eval.viewing.browser import SplatPoints
from nw_gate.results.log_links import taken_over_log
from nw_gate.results.run_folder import RunFolder, open_run_folder
from nw_scenes.folder import SCENE_FILE
from nw_sim.catalogue import is_built_in

Kind = Literal["log", "scene", "policy"]


def kind_of(source: str | None, *, policy: str | None, scene: str | None) -> Kind | None:
    """Return what a source is; None without one.

    Args:
        source: a path, or a name.
        policy: that is named beside it.
        scene: that is named beside it.

    Raises:
        UsageError: it is neither, or one thing too much is named.
    """
    if source is None:
        if policy is None and scene is None:
            raise UsageError(
                "there is nothing to view",
                fix="name a log, a run's folder, a scene or a policy, or --policy and --scene",
            )
        return None
    kind = _kind(source)
    if kind == "log" and (policy is not None or scene is not None):
        raise UsageError(
            f"{source} shows what was logged, with its own policy and scene",
            fix="drop --policy and --scene; `nw-eval replay` runs another policy in it",
        )
    if (kind == "scene" and scene is not None) or (kind == "policy" and policy is not None):
        raise UsageError(
            f"{source} and --{kind} name the same kind of thing", fix="name one of them"
        )
    return kind


def _kind(source: str) -> Kind:
    path = taken_over_log(Path(source))
    if is_built_in(source) or source.startswith("neverwhere:"):
        return "scene"
    if what_is(path / SCENE_FILE) == "file" or path.name == SCENE_FILE:
        return "scene"
    if what_is(path) == "file" and path.suffix == ".mcap":
        return "log"
    if any(what_is(path / name) == "file" for name in ("run.json", "journal.jsonl")):
        return "log"
    if source.startswith("hub:"):
        raise UsageError(
            f"{source} may be a scene or a policy", fix=f"name one: --scene or --policy {source}"
        )
    if _is_policy(source):
        return "policy"
    raise UsageError(
        f"there is no log, run, scene or policy at {source!r}",
        fix="name one: a file of mcap/, a folder in reports/, or as `nw-eval scenes list` and "
        "`nw-eval policies list` do",
    )


def _is_policy(source: str) -> bool:
    from nw_policies import load_bundle

    if what_is(Path(source)) != "nothing":
        return True  # Its loading says what is wrong with it.
    try:
        load_bundle(source)
    except NwEvalError:
        return False
    return True


@dataclass(frozen=True, kw_only=True)
class Shelf:
    """Trials that can be looked at.

    Attributes:
        logs: by the trials' names, in their order.
        rivals: logs of other runs by the trials' names: ghosts.
        run: the run's name; empty where it is not a run folder.
    """

    logs: Mapping[str, Path]
    rivals: tuple[Mapping[str, Path], ...] = ()
    run: str = ""
    _splats: dict[str, SplatPoints | None] = field(default_factory=dict[str, SplatPoints | None])

    def beside(self, name: str) -> list[str]:
        """Return the other trials of a trial's place, those that come after it first."""
        names = [other for other in self.logs if self._place(other) == self._place(name)]
        place = names.index(name)
        return names[place + 1 :] + names[:place]

    def _place(self, name: str) -> tuple[str, ...]:
        return self.logs[name].parts[-3:-1]  # Logs from the cache are in a folder of their own.

    def load(self, name: str, others: int = 0) -> tuple[list[Trace], SplatPoints | None]:
        """Return a trial with its ghosts, and its place's splat if there is one here.

        Args:
            name: of the trial.
            others: trials of the same scene that are ghosts too.

        Raises:
            StoreError: a log is damaged.
        """
        trace = read_trace(self.logs[name])
        paths = [rival[name] for rival in self.rivals if name in rival]
        paths += [self.logs[other] for other in self.beside(name)[:others]]
        ghosts = [read_trace(path) for path in paths]
        digest = trace.logged.job.trial.scene_digest
        same = [ghost for ghost in ghosts if ghost.logged.job.trial.scene_digest == digest]
        if digest not in self._splats:
            self._splats.clear()  # One scene at a time.
            self._splats[digest] = _splat_of(trace)
        return [trace, *same], self._splats[digest]


def open_shelf(source: Path, against: Path | None = None) -> Shelf:
    """Return what a log or a run has to show.

    Args:
        source: a trial's log, or a run's folder.
        against: as above; its trials of the same names are the ghosts.

    Raises:
        UsageError: there is no such file, or a run has no logs.
    """
    source = taken_over_log(source)
    against = None if against is None else taken_over_log(against)
    logs = _logs(source)
    run = "" if source.is_file() else source.resolve().name
    if against is None:
        return Shelf(logs=logs, run=run)
    rivals = _logs(against)
    if source.is_file() and against.is_file():  # Two logs are meant, whatever they are called.
        rivals = dict(zip(logs, rivals.values(), strict=True))
    elif not set(logs) & set(rivals):
        raise UsageError(
            f"{against} has no trial of the same name as {source}", fix="name a run of its suite"
        )
    return Shelf(logs=logs, rivals=(rivals,), run=run)


def _logs(source: Path) -> dict[str, Path]:
    if source.is_file():
        return {source.stem: source}
    if not source.exists():
        raise UsageError(f"there is nothing at {source}", fix="name a log or a run's folder")
    folder: RunFolder = open_run_folder(source)
    paths = (path for place in (folder.logs, folder.cached) for path in place.rglob("*.mcap"))
    files = [path for path in paths if what_is(path) == "file"]
    if not files:
        raise UsageError(f"{source} has no logs", fix="name a run that wrote some")
    return {path.stem: path for path in sorted(files, key=lambda path: path.stem)}


def _splat_of(trace: Trace) -> SplatPoints | None:
    import numpy as np

    from nw_eval.viewing.browser import splat_points
    from nw_eval.viewing.recording.content import place_splat

    gaussians, _ = place_splat(trace.logged)
    return None if gaussians is None else splat_points(gaussians, np.eye(4))
