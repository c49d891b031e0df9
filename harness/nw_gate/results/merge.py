"""Parts of a run, put together in one folder that is what the run would be without parts.

Folders are parts of one run if suite, policy, scenes, engine and plan agree, field by field. Of
each trial the one row that stands is taken; there may be no gap, and no two results. The folder is
there whole, or not at all.

Logs are linked where that goes, copied where not, and never taken from elsewhere. A folder may be
untrusted: a row's log is taken only from below its folder, links followed, and put only where a
trial's log has its place. Links are hard ones, so that the parts may be removed; a log is never
written over (`nw_sim.rollout.mcap.file` renames), hence nothing is that both have.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_base.files.cache import sync_folder
from nw_base.files.inside import OutsideError, bounded_bytes, checked, inside
from nw_base.plural import plural
from nw_gate.results.baseline import LoadedBaseline
from nw_gate.results.ended import PlannedTrial, write_trials
from nw_gate.results.journal import JournalHeader, write_journal
from nw_gate.results.log_links import link_logs
from nw_gate.results.provenance import (
    CacheInfo,
    PartInfo,
    RunInfo,
    read_run_info,
    write_run_info,
)
from nw_gate.results.row import Row, rows_digest, to_dict
from nw_gate.results.run_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class MergeSource:
    """A folder that is merged, as it was read."""

    folder: RunFolder
    info: RunInfo
    rows: Sequence[Row] = ()
    """Of its plan, the latest of each trial."""

    def __str__(self) -> str:
        what = "merged before" if self.info.shard is None else str(self.info.shard)
        return f"{self.folder.path} ({what})"

    @property
    def parts(self) -> tuple[PartInfo, ...]:
        """The parts that it consists of: itself, or those of which it was merged."""
        info = self.info
        if info.shard is None:
            return info.parts
        return (
            PartInfo(
                shard=info.shard,
                id=info.id,
                started=info.started,
                finished=info.finished,
                wall_s=info.wall_s,
                workers=info.workers,
                host=info.machine.host,
                rows_digest=info.rows_digest,
                cache=info.cache,
            ),
        )


_NAMED = 3  # fields, or parts, that a sentence names before it says "and more"
_LONGEST = 60  # characters of a value
_ONE_KIND = "run all parts with one suite, policy and nw-eval on one kind of machine"


def check_parts(sources: Sequence[MergeSource]) -> None:
    """Refuse folders that are no parts of one run.

    Raises:
        UsageError: there is none, or one is of a run that was run whole.
        IncomparableError: two differ; naming both, each field, and its values.
    """
    if not sources:
        raise UsageError("nothing to merge", fix="name the folders of all parts of a run")
    for source in sources:
        if not source.parts:
            raise UsageError(
                f"{source.folder.path} is not a part of a run: all of its trials ran together",
                fix="leave it out; `nw-eval gate` judges it as it is",
            )
    first, *others = sources
    wanted = _fields(first)
    for other in others:
        fields = _fields(other)
        both = {name: (wanted.get(name), fields.get(name)) for name in (*wanted, *fields)}
        differing = [
            f"{name} is {_short(one)} in {first}, {_short(two)} in {other}"
            for name, (one, two) in both.items()
            if one != two
        ]
        if len(differing) == 1 and differing[0].startswith("baseline.checked"):
            _check_bits(first, other)
        if differing:
            more = f"; and {len(differing) - _NAMED} more" if len(differing) > _NAMED else ""
            raise IncomparableError(
                f"not of one run: {'; '.join(differing[:_NAMED])}{more}",
                fix=_ONE_KIND,
            )


def check_beside(arms: Sequence[tuple[MergeSource, Sequence[Row]]]) -> None:
    """Refuse parts whose machines gave the baseline's policy different bits in one trial.

    All parts ran its first trials, so that such machines show, whatever they are called.

    Args:
        arms: parts, with the rows of the baseline's policy that ran beside them.

    Raises:
        IncomparableError: two differ; naming both, and the trial.
    """
    seen: dict[str, tuple[MergeSource, Row]] = {}
    for source, rows in arms:
        for row in rows:
            earlier, known = seen.setdefault(row.trial_id, (source, row))
            if known.digest != row.digest:
                raise IncomparableError(
                    f"not of one run: trial {row.trial_id} of the baseline's policy "
                    f"{row.policy} has other results in {earlier} than in {source}",
                    fix=_ONE_KIND,
                )


def _check_bits(one: MergeSource, two: MergeSource) -> None:
    """Refuse two parts that differ in what the baseline's policy showed on their machines.

    Raises:
        IncomparableError: naming both.
    """
    by_check = {
        source.info.baseline.checked: source
        for source in (one, two)
        if source.info.baseline is not None
    }
    if None in by_check:
        raise IncomparableError(
            f"{by_check[None]} ended before the baseline's policy had run on its machine",
            fix=f"--resume {by_check[None].folder.path} continues it",
        )
    if {"bits", "control"} <= set(by_check):
        raise IncomparableError(
            f"not of one run: the baseline's policy reproduces its results in {by_check['bits']}, "
            f"not in {by_check['control']}; all shards must agree",
            fix=_ONE_KIND,
        )


def _fields(source: MergeSource) -> Mapping[str, Any]:
    """Return whatever the parts of a run have in common, by what messages call it."""
    info = source.info
    baseline = info.baseline
    known = {} if baseline is None else baseline.model_dump(exclude={"path"})
    return {
        **{f"suite.{key}": value for key, value in info.suite.items()},
        "suite_digest": info.suite_digest,
        "policy": info.policy.name,
        "checkpoint": info.policy.checkpoint_digest,
        "card": info.policy.card_digest,
        **{f"scene {name}": scene.digest for name, scene in info.scenes.items()},
        **info.engine,
        "panel": info.panel,
        "drawn_from": info.drawn_from,
        "drawn_for": info.drawn_for,
        **{f"baseline.{key}": value for key, value in known.items()},
        "stop": info.stop,
        "number of parts": source.parts[0].shard.count,
        "plan": source.parts[0].shard.plan,
    }


def _short(value: Any) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


@dataclass(frozen=True, kw_only=True, slots=True)
class SourcedRow:
    """A trial's row, and the folders that have it: one of them has its log."""

    row: Row
    sources: tuple[MergeSource, ...]


def joined(
    sources: Sequence[MergeSource], trials: Sequence[PlannedTrial], count: int
) -> tuple[SourcedRow, ...]:
    """Return the rows of a whole plan, in its order.

    Of a trial that several folders have a result stands, and an error gives way to it, or to that
    of a later attempt. What wall clocks and machines say of equal results may differ: which of them
    is kept does not depend on the order of the folders.

    Args:
        sources: all folders.
        trials: of the whole plan, in the order of the run; every `count`-th is of one part.
        count: of parts.

    Raises:
        StoreError: a trial has no row, naming the part that it is in; or two different results,
            naming both folders.
    """
    held: dict[str, SourcedRow] = {}
    for source in sources:
        alone = (source,)
        for row in source.rows:
            one = SourcedRow(row=row, sources=alone)
            earlier = held.get(row.trial_id)
            held[row.trial_id] = one if earlier is None else _which(earlier, one)
    if gaps := [index for index, trial in enumerate(trials) if trial.id not in held]:
        raise _gap(sources, trials, gaps, count)
    return tuple(held[trial.id] for trial in trials)


def _which(one: SourcedRow, two: SourcedRow) -> SourcedRow:
    """Return which of two rows of a trial stands.

    Raises:
        StoreError: they are different results.
    """
    if one.row == two.row:
        return SourcedRow(row=one.row, sources=(*one.sources, *two.sources))
    first, second = (one, two) if _rank(one.row) <= _rank(two.row) else (two, one)
    if second.row.status == "error":
        return first
    ours, theirs = one.row.digest, two.row.digest
    if ours != theirs:
        raise StoreError(
            f"trial {one.row.trial_id} has two different results: {ours[:8]} in {one.sources[0]}, "
            f"{theirs[:8]} in {two.sources[0]}",
            fix="one of them was changed, or the simulation is not deterministic there: "
            "`nw-eval replay` of both logs tells which",
        )
    return SourcedRow(row=first.row, sources=(*first.sources, *second.sources))


def _rank(row: Row) -> tuple[bool, int, str]:
    """Return what decides between rows of a trial, whoever names them first; the least stands."""
    return row.status == "error", -row.attempt, json.dumps(to_dict(row), sort_keys=True)


def _gap(
    sources: Sequence[MergeSource], trials: Sequence[PlannedTrial], gaps: Sequence[int], count: int
) -> StoreError:
    """Return the error that says which parts lack which trials."""
    lacking: dict[int, list[str]] = defaultdict(list)
    for place in gaps:
        lacking[place % count + 1].append(trials[place].id)
    there: dict[int, list[MergeSource]] = defaultdict(list)
    for source in sources:
        if source.info.shard is not None:
            there[source.info.shard.index].append(source)
    sentences: list[str] = []
    for index, names in sorted(lacking.items()):
        of = f"{plural(len(names), 'trial')}, first {names[0]}"
        if row := there[index]:
            sentences.append(f"{row[0]} lacks {of}; `--resume {row[0].folder.path}` runs them")
        else:
            sentences.append(f"there is no part {index} of {count} ({of})")
    more = f"; and {len(sentences) - _NAMED} more parts" if len(sentences) > _NAMED else ""
    return StoreError(
        f"{plural(len(gaps), 'trial')} of {len(trials)} missing: "
        f"{'; '.join(sentences[:_NAMED])}{more}",
        fix="merge once every part has run to its end",
    )


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
            "labels": dict(
                label
                for label in first.labels.items()
                if all(label in source.info.labels.items() for source in sources)
            ),
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
    out: Path, arm: MergedArm, against: LoadedBaseline | None, control: MergedArm | None = None
) -> tuple[RunInfo, tuple[str, ...]]:
    """Write the folder of a merged run; return its run.json, and sentences about what is lost.

    A folder that has these rows already, merged before, stays as it is.

    Args:
        out: the folder, which holds nothing yet.
        arm: the run.
        against: the baseline that its parts were begun against.
        control: the run of the baseline's own policy beside them, if there is one.

    Raises:
        UsageError: it holds something else.
        StoreError: it cannot be written.
    """
    if (there := _there(out, arm.info, arm.held)) is not None:
        _take_ladders(arm, RunFolder(path=out))
        return there, ()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as near:
            folder = RunFolder(path=Path(near) / "run")
            folder.path.mkdir()
            if control is not None:
                folder.baseline.path.mkdir()
                _fill(folder.baseline, control, against)
            ended, lost = _fill(folder, arm, against)
            _take_ladders(arm, folder)
            folder.path.rename(out.resolve())  # A link to an empty folder stays a link.
    except OSError as error:
        raise StoreError(
            f"cannot write {out}: {error.strerror or error}",
            fix="choose another folder with --out, or free disk space",
        ) from error
    sync_folder(out.parent)
    return ended, lost


def _take_ladders(arm: MergedArm, folder: RunFolder) -> None:
    """Copy the runs on ladders of the part that has climbed them for all of them."""
    for source in arm.sources:
        if source.folder.limit_runs and not folder.limits.exists():
            shutil.copytree(source.folder.limits, folder.limits, ignore=_links)


def _links(folder: str, names: list[str]) -> list[str]:
    """Return the names in a folder that are links: what they lead to is not the part's own."""
    return [name for name in names if Path(folder, name).is_symlink()]


def _fill(
    folder: RunFolder, arm: MergedArm, against: LoadedBaseline | None
) -> tuple[RunInfo, tuple[str, ...]]:
    info = arm.info
    lost = _take_logs(arm.held, folder)
    if against is not None:
        path = folder.baseline_file(against.info.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(against.content)
    for source in arm.sources:
        with suppress(OSError, ValueError):  # Whoever lacks it draws the logs as they like.
            layout = inside(source.folder.path, source.folder.layout.name)
            folder.layout.write_bytes(bounded_bytes(layout, _LAYOUT_BYTES))
            break
    rows = [one.row for one in arm.held]
    write_journal(folder.journal, JournalHeader.of_run(info), rows)
    ended = write_trials(folder, info, rows)
    write_run_info(folder.run_json, ended)
    link_logs(folder.path, rows)
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


def _take_logs(held: Iterable[SourcedRow], folder: RunFolder) -> tuple[str, ...]:
    """Put the logs that rows name into a folder; return sentences about those that are not there.

    Raises:
        StoreError: a row names another place than its log's, or the folder cannot be written.
    """
    lost: list[str] = []
    for one in held:
        if not one.row.mcap_path:
            continue
        place = folder.path / _name(one)
        if not any(_take(source.folder, one.row, place) for source in one.sources):
            lost.append(one.row.trial_id)
    if not lost:
        return ()
    return (
        f"{plural(len(lost), 'log')} missing, or not of the size in its row: {lost[0]}"
        + (f" and {len(lost) - 1} more" if len(lost) > 1 else ""),
    )


def _name(one: SourcedRow) -> PurePosixPath:
    """Return where a row's log lies in its folder, and goes in another: `<folder>/<scene>/<trial>`.

    Nothing else of a run is called so.

    Raises:
        StoreError: the row names another place.
    """
    row = one.row
    with suppress(OutsideError):
        name = checked(row.mcap_path)
        if name.parts[1:] == PurePosixPath(row.scene, f"{row.trial_id}.mcap").parts:
            return name
    raise StoreError(
        f"{one.sources[0]}: the row of trial {row.trial_id} has its log at {row.mcap_path!r}, "
        "where no trial of a run belongs",
        fix="merge folders that nw-eval wrote",
    )


def _take(source: RunFolder, row: Row, place: Path) -> bool:
    """Link or copy a row's log; False if it is not there."""
    try:
        path = inside(source.path, row.mcap_path)
        facts = path.lstat()
    except (OutsideError, OSError, ValueError):
        return False
    if not stat.S_ISREG(facts.st_mode) or facts.st_size != row.mcap_bytes:
        return False
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError):  # Another file system, another user's file, or none that has links.
            os.link(path, place, follow_symlinks=False)
            return True
        shutil.copyfile(path, place, follow_symlinks=False)
    except OSError as error:
        raise StoreError(
            f"cannot write {place}: {error.strerror}", fix="free disk space, or check its rights"
        ) from error
    return True
