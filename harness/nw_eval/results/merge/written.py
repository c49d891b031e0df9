"""The folder of a merged run: there whole, or not at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from nw_eval.errors import StoreError, UsageError
from nw_eval.files.cache import sync_folder
from nw_eval.files.inside import inside
from nw_eval.results.bank.against import Against
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.ended import write_gathered
from nw_eval.results.evidence.gathered import Gathered
from nw_eval.results.journal import JournalHeader, write_journal
from nw_eval.results.merge.logs import take_logs
from nw_eval.results.merge.rows import SourcedRow
from nw_eval.results.merge.source import MergeSource
from nw_eval.results.planned import PlannedTrial
from nw_eval.results.provenance import (
    CacheInfo,
    PartInfo,
    RunInfo,
    read_run_info,
    write_run_info,
)
from nw_eval.results.row import rows_digest, texts_of
from nw_eval.results.run_folder import RunFolder

_LAYOUT_BYTES = 4 * 2**20


@dataclass(frozen=True, kw_only=True)
class MergedArm:
    """What is written of one policy."""

    info: RunInfo
    held: Sequence[SourcedRow]
    """Its rows, in the order of the run."""
    sources: Sequence[MergeSource]
    """Of which it is merged."""


def merged_info(
    sources: Sequence[MergeSource],
    trials: Iterable[PlannedTrial],
    *,
    name: str,
    command: tuple[str, ...],
) -> RunInfo:
    """Return run.json of a merged run: what its parts have in common, and of each what it was.

    Its time is that of all parts together, on as many workers as one of them had.

    Args:
        sources: which are parts of one run.
        trials: of the whole plan.
        name: the run's.
        command: what was typed.
    """
    parts: list[PartInfo] = []
    for part in (part for source in sources for part in source.parts):
        if part not in parts:
            parts.append(part)
    parts.sort(key=lambda part: (part.shard.index, part.started, part.id, part.rows_digest))
    first = min(sources, key=lambda source: _place(source.info)).info
    planned = Counter(trial.scene for trial in trials)
    ends = [part.finished or part.started for part in parts]
    request = first.request
    return first.model_copy(
        update={
            "id": name,
            "started": min(part.started for part in parts),
            "finished": max(ends),
            "wall_s": sum(part.wall_s for part in parts),
            "interrupted": False,
            "request": None if request is None else replace(request, shard=None),
            "scenes": {
                scene: info.model_copy(update={"trials": planned[scene]})
                for scene, info in first.scenes.items()
            },
            "shard": None,
            "parts": tuple(parts),
            "cache": _taken_over(parts),
            "workers": max(part.workers for part in parts),
            "command": command,
        }
    )


def _taken_over(parts: Iterable[PartInfo]) -> CacheInfo | None:
    """Return how parts used the cache of trials, together."""
    known: CacheInfo | None = None
    for part in parts:
        known = known if part.cache is None else part.cache.after(known)
    return known


def _place(info: RunInfo) -> tuple[int, str, str]:
    return (0 if info.shard is None else info.shard.index, info.started, info.id)


def write_merged(
    out: Path, arm: MergedArm, against: Against | None, beside: MergedArm | None = None
) -> tuple[RunInfo, tuple[str, ...]]:
    """Write the folder of a merged run; return its run.json, and sentences about what is lost.

    A folder that has these rows already, merged before, stays as it is.

    Args:
        out: the folder, which holds nothing yet.
        arm: the run.
        against: the bank that its parts were begun against.
        beside: the run of the bank's own policy beside them, if there is one.

    Raises:
        UsageError: it holds something else.
        StoreError: it cannot be written.
    """
    if (there := _there(out, arm.info, arm.held)) is not None:
        return there, ()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as near:
            folder = RunFolder(path=Path(near) / "run")
            folder.path.mkdir()
            if beside is not None:
                folder.baseline.path.mkdir()
                _fill(folder.baseline, beside, against)
            ended, lost = _fill(folder, arm, against)
            folder.path.rename(out.resolve())  # A link to an empty folder stays a link.
    except OSError as error:
        raise StoreError(
            f"cannot write {out}: {error.strerror or error}",
            fix="choose another folder with --out, or free disk space",
        ) from error
    sync_folder(out.parent)
    return ended, lost


def _fill(
    folder: RunFolder, arm: MergedArm, against: Against | None
) -> tuple[RunInfo, tuple[str, ...]]:
    info = arm.info
    lost = take_logs(arm.held, folder)
    if against is not None:
        path = folder.bank(against.info.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(against.content)
    for source in arm.sources:
        with suppress(OSError, ValueError):  # Whoever lacks it draws the logs as they like.
            layout = inside(source.folder.path, source.folder.layout.name)
            folder.layout.write_bytes(bounded_bytes(layout, _LAYOUT_BYTES))
            break
    rows = [one.row for one in arm.held]
    header = JournalHeader(
        suite_digest=info.suite_digest,
        policy_digest=info.policy.card_digest,
        scene_digests={name: scene.digest for name, scene in info.scenes.items()},
        engine=info.engine,
    )
    gathered = Gathered()
    write_journal(folder.journal, header, gathered.passing(texts_of(rows)))
    ended = write_gathered(folder, info, gathered)
    write_run_info(folder.run_json, ended)
    return ended, lost


def _there(out: Path, info: RunInfo, held: Sequence[SourcedRow]) -> RunInfo | None:
    """Return run.json of a folder that has this very merged run; None of an empty one.

    Raises:
        UsageError: it has something else.
        StoreError: it cannot be looked into.
    """
    try:
        if not out.exists() or not any(out.iterdir()):
            return None
    except OSError as error:
        raise StoreError(
            f"cannot read {out}: {error.strerror}", fix="choose another folder with --out"
        ) from error
    fix = "choose another folder with --out, or remove it"
    try:
        there = read_run_info(RunFolder(path=out).run_json)
    except StoreError as error:
        raise UsageError(
            f"{out} is not empty, and no merged run: {error.message}", fix=fix
        ) from None
    plans = {part.shard.plan for part in there.parts}
    same = plans == {info.parts[0].shard.plan}
    if not same or there.rows_digest != rows_digest(one.row for one in held):
        raise UsageError(f"{out} already holds another run", fix=fix)
    return there
