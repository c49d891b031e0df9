"""A ledger: what it keeps of each verdict, a JSON line each that is on disk before its gate ends.

    {"ledger": 1, "sum": ...}
    {"verdict": {...}, "sum": ...}

Each line's sum covers the line and the sum before it, as in a run's journal: a verdict that was
changed, or left out because one would rather forget it, is an error. A chain does not show that its
end was cut off. So the sum of the last line is kept beside the ledger as well, in FILE.head, which
is written after each line:

    {"verdicts": 1, "head": ..., "sum": ...}

A ledger that does not have that line any more is an error too. It is no signature: whoever writes
both files anew can leave out what they like, and only a head that was kept elsewhere shows it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_base.clean import clean
from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import (
    atomic_path,
    check_place,
    followed,
    is_full,
    is_stream,
    open_own,
    sync_folder,
)
from nw_base.files.inside import bounded_bytes, what_is
from nw_base.plural import plural
from nw_base.words import PanelKind, Tier
from nw_gate.absolute import by_scene, courses
from nw_gate.results.baseline import trajectory
from nw_gate.results.provenance import BaselineInfo, RunInfo
from nw_gate.results.row import Row
from nw_gate.results.seal import seal, unseal
from nw_gate.stats.power import SceneCounts
from nw_gate.verdict import Basis, Verdict, Word

_MOST_TRAJECTORIES = 64
"""Trials of a verdict by which its candidate can be told from others."""


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class SeenScene(_Line):
    """One scene that counts: trials that ended with 0, 1, ..., k waypoints reached."""

    counts: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = Field(
        min_length=2, max_length=10_000
    )
    alone: bool = False

    @model_validator(mode="after")
    def _with_trials(self) -> Self:
        if not any(self.counts):
            raise ValueError("a scene without trials")
        return self


class BaselineEntry(_Line):
    """The comparison that a verdict rests on."""

    bank: str
    digest: str
    """Of the baseline's file."""
    basis: Basis | Literal["sample"]
    """"sample" is of an older nw-eval, which ran no control."""
    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    trials: int = Field(default=0, ge=0)
    """0: an older nw-eval, which counted rounds."""
    drop: float | None
    max_drop: float
    tolerate: float
    alpha_pass: float = Field(gt=0.0, lt=1.0)
    alpha_regr: float = Field(gt=0.0, lt=1.0)
    scene_drop: float | None = None
    """None: an older nw-eval, which did not write it."""
    scenes: int = Field(default=0, ge=0)
    """Scenes that count, each as often as it has cells of perturbations; 0: as above."""
    critical: int = Field(default=0, ge=0)
    """Of these, such as flag alone."""


class LedgerEntry(_Line):
    """One verdict: who was judged, on which starts, against what, and how."""

    time: AwareDatetime
    """When it was given."""
    run: str
    """The run's name."""
    suite: str
    suite_digest: str
    """With the seed in it: it names the seed set."""
    panel: PanelKind
    candidate: str
    """The policy's name."""
    candidate_digest: str
    """Of the files: checkpoint and card."""
    computes: str = ""
    """What the candidate computes (`PolicyInfo.computes`); empty where that is unknown."""
    word: Word
    trials: int = Field(ge=0)
    success: float | None
    """Mean success, scenes weighted equally."""
    bar: float | None
    confidence: float = Field(gt=0.0, lt=1.0)
    """Of each of the bar's bounds."""
    seen: tuple[SeenScene, ...] = ()
    tiers: dict[str, Tier] = Field(default_factory=dict[str, Tier])
    """Of all scenes that were judged, by name; empty: an older nw-eval, which did not write it."""
    trajectories: dict[str, str] = Field(default_factory=dict[str, str], max_length=10_000)
    """Some of the trials: `nw_gate.results.baseline.trajectory` by a digest of the start."""
    baseline: BaselineEntry | None = None
    scores: dict[str, tuple[float | None, float | None, float, float]] = Field(
        default_factory=dict[str, tuple[float | None, float | None, float, float]]
    )
    """Bar, max_drop and range of each score that was judged beside success."""
    limits: dict[str, tuple[float | None, float | None]] = Field(
        default_factory=dict[str, tuple[float | None, float | None]]
    )
    """`at_least` and `max_drop` of each limit that was judged, by ladder."""

    @property
    def is_test(self) -> bool:
        """Whether chance could have given another word: not without trials, nor by a hole."""
        is_same = self.baseline is not None and self.baseline.basis == "same"
        return self.word in {"PASS", "REGRESSED", "INCONCLUSIVE"} and not is_same

    @property
    def scenes(self) -> list[SceneCounts]:
        """What was seen, for `stats`."""
        return [
            SceneCounts(counts=np.array(scene.counts, dtype=np.int64), alone=scene.alone)
            for scene in self.seen
        ]

    @property
    def test(self) -> tuple[object, ...]:
        """What is equal for two verdicts on one candidate by one test: same trials, same rules.

        More trials of a run are no other test, since the bounds hold at any look. Other scenes,
        tiers or margins are: whoever picks them after a look has had one more chance. So are the
        starts of a baseline, or fresh ones, in another order.
        """
        rules = self.baseline and self.baseline.model_dump(
            include={"digest", "max_drop", "tolerate", "scene_drop", "alpha_pass", "alpha_regr"}
        )
        is_drawn = self.baseline is not None or self.panel == "fresh"
        drawn_by = (self.computes or self.candidate_digest) if is_drawn else ""
        scenes = tuple(sorted(self.tiers.items()))
        panel = (drawn_by, self.suite_digest, self.panel, scenes)
        scores = tuple(sorted(self.scores.items()))
        limits = tuple(sorted(self.limits.items()))
        judged = (*(rules.values() if rules else ()), *scores, *limits)
        return (*panel, self.bar, self.confidence, *judged)


def _entry_of(
    verdict: Verdict,
    run: RunInfo,
    rows: Sequence[Row],
    *,
    time: datetime,
    baseline: BaselineInfo | None = None,
) -> LedgerEntry:
    """Return what a ledger keeps of a verdict.

    Args:
        verdict: that was given.
        run: what it is on.
        rows: that it rests on.
        time: when it was given, with its time zone.
        baseline: that the run was compared with; the one that it was begun against if None.
    """
    who = f"{run.policy.checkpoint_digest}/{run.policy.card_digest}"
    seen = courses(by_scene(rows, run.planned), verdict.per_scene, verdict.left)
    return LedgerEntry(
        time=time,
        run=run.id,
        suite=str(run.suite.get("name", "")),
        suite_digest=run.suite_digest,
        panel=run.panel,
        candidate=run.policy.name,
        candidate_digest=sha256(who.encode()).hexdigest(),
        computes=run.policy.computes,
        word=verdict.verdict,
        trials=verdict.n,
        success=verdict.success,
        bar=verdict.bar,
        confidence=verdict.confidence,
        seen=tuple(
            SeenScene(counts=tuple(scene.counts.tolist()), alone=scene.alone) for scene in seen
        ),
        tiers={item.scene: item.tier for item in verdict.per_scene},
        trajectories=_trajectories(rows, run.suite_digest),
        baseline=_baseline(verdict, baseline or run.baseline),
        scores={
            item.spec.name: (item.bar, item.max_drop, item.spec.low, item.spec.high)
            for item in verdict.scores
            if item.bar is not None or item.max_drop is not None
        },
        limits={
            item.ladder: (item.at_least, item.max_drop)
            for item in verdict.limits
            if item.word is not None
        },
    )


def _trajectories(rows: Sequence[Row], suite_digest: str) -> dict[str, str]:
    """Return trajectories by digests of starts, of the trials whose starts have the smallest ones.

    Two candidates that met the same starts keep the same ones of them. A trial that a policy failed
    in tells nothing: many do so at once, in the same way.
    """
    by_start: dict[str, str] = {}
    for row in rows:
        if row.status == "ok" and row.outcome != "policy_failed" and row.state_digest:
            facts = [suite_digest, row.scene, row.scene_digest, row.perturbation, row.seed_index]
            start = sha256(json.dumps([*facts, row.seed]).encode()).hexdigest()[:16]
            by_start[start] = trajectory(row)
    return dict(sorted(by_start.items())[:_MOST_TRAJECTORIES])


def _baseline(verdict: Verdict, baseline: BaselineInfo | None) -> BaselineEntry | None:
    comparison = verdict.against
    if comparison is None:
        return None
    return BaselineEntry(
        bank=comparison.baseline_name,
        digest="" if baseline is None else baseline.sha256,
        basis=comparison.basis,
        word=comparison.word,
        trials=comparison.trials,
        drop=comparison.drop,
        max_drop=comparison.max_drop,
        tolerate=comparison.tolerate,
        alpha_pass=comparison.alpha_pass,
        alpha_regr=comparison.alpha_regr,
        scene_drop=comparison.scene_drop,
        scenes=sum(scene.counts for scene in comparison.scenes),
        critical=sum(scene.tier == "critical" for scene in comparison.scenes),
    )


_VERSION = 1
_MOST = 256 * 2**20  # bytes of a ledger: some 100,000 verdicts
_LONGEST_LINE = 2**20  # bytes
_TRIES = 5
_MEND = "restore it from a copy, or begin another one"
_MEND_END = "restore it from a copy, or remove {head} to continue without the missing lines"


@dataclass(frozen=True, kw_only=True)
class LedgerContents:
    """What a ledger holds."""

    entries: tuple[LedgerEntry, ...]
    dropped: str | None = None
    """A sentence about a torn last line."""
    good_bytes: int = 0
    """Length of the file up to the last whole line."""
    sums: tuple[str, ...] = ()
    """Of all lines, the first one's included: each covers the one before it."""

    @property
    def last_sum(self) -> str:
        """Of the last whole line; empty for an empty ledger."""
        return self.sums[-1] if self.sums else ""


def append_verdict(
    path: Path,
    verdict: Verdict,
    run: RunInfo,
    rows: Sequence[Row],
    *,
    baseline: BaselineInfo | None = None,
) -> LedgerEntry:
    """Add a verdict that was just given to a ledger.

    Args:
        path: of the ledger, which is begun if there is none.
        verdict: that was given.
        run: what it is on.
        rows: that it rests on.
        baseline: that the run was compared with; the one that it was begun against if None.

    Raises:
        StoreError: the ledger is damaged, or cannot be written.
    """
    entry = _entry_of(verdict, run, rows, time=datetime.now(tz=UTC), baseline=baseline)
    append_entry(path, entry)
    return entry


def check_ledger(path: Path) -> None:
    """Check before a run that its verdict can be added to a ledger; nothing is written.

    Raises:
        UsageError: it cannot be written, or is damaged.
    """
    try:
        target = followed(path)
        if is_stream(path):
            if target.is_file():  # An open file, as of `/dev/fd/3`.
                return
            raise UsageError(f"cannot write {path}: it is not a regular file", fix=_OTHER)
        check_place(target)
        if what_is(target) == "file":
            os.close(open_own(target, os.O_RDWR))
            read_ledger(target)
            return
        places = target.absolute().parents
        with TemporaryFile(dir=next(place for place in places if what_is(place) == "folder")):
            pass  # One can be made there.
    except (OSError, StoreError) as error:
        why = error.message if isinstance(error, StoreError) else error.strerror or error
        raise UsageError(f"cannot write {path}: {why}", fix=_OTHER) from None


_OTHER = "name another file with --ledger"


def append_entry(path: Path, entry: LedgerEntry) -> None:
    """Add a verdict to a ledger, which is begun if there is none, and wait until it is on disk.

    Two gates that end at once both get their line. A line that was torn by a kill is cut off. On a
    network share whose locks are of one machine alone another one may write over the line at the
    same moment: it is read again, and added once more where it is gone.

    Raises:
        StoreError: the ledger is damaged, cannot be written, or keeps being written over.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        target = _followed(path)
        for _ in range(_TRIES):
            if _append(target, entry):
                break
        else:
            raise StoreError(
                f"{path} was written over {_TRIES} times while a verdict was added",
                fix="keep it where file locks hold between machines, or one ledger a machine",
            )
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error.strerror or error}",
            fix=f"free disk space, or {_OTHER}" if is_full(error) else _OTHER,
        ) from error
    sync_folder(path.parent)


def _followed(path: Path) -> Path:
    """Return the file that a ledger's path leads to.

    Raises:
        StoreError: it leads to no file: the verdict is there already, and this is no usage error.
    """
    try:
        return followed(path)
    except UsageError as error:
        raise StoreError(error.message, fix=_OTHER) from error


def _append(path: Path, entry: LedgerEntry) -> bool:
    """Write the line of an entry behind all others, then the head; return whether it is there."""
    with os.fdopen(open_own(path, os.O_RDWR | os.O_CREAT), "r+b", buffering=0) as handle:
        _lock(handle)
        head = _read_head(path)
        contents = _read(path, handle)
        _check_head(path, head, contents)
        handle.truncate(contents.good_bytes)
        handle.seek(contents.good_bytes)
        line, last_sum = _lines(entry, contents.last_sum)
        _write(handle, line)
        with path.open("rb") as written:
            written.seek(contents.good_bytes)
            if written.read(len(line)) != line:
                return False
        _write_head(path, len(contents.entries) + 1, last_sum)
    return True


def _head_of(path: Path) -> Path | None:
    """Return where the head of a ledger lies; None for one that has no folder."""
    return None if is_stream(path) else path.with_name(f"{path.name}.head")


def _write_head(path: Path, verdicts: int, last_sum: str) -> None:
    place = _head_of(path)
    if place is not None:
        with atomic_path(place) as temporary:
            text = json.dumps({"verdicts": verdicts, "head": last_sum})
            temporary.write_text(seal(text)[0], encoding="utf-8")


def _read_head(path: Path) -> tuple[int, str] | None:
    """Return how many verdicts a ledger had at least, and the sum of the last; None if unknown.

    It is read before the ledger, to which others may add in between.

    Raises:
        StoreError: it is damaged.
    """
    place = _head_of(path)
    if place is None:
        return None
    try:
        record = json.loads(unseal(bounded_bytes(place, _LONGEST_LINE))[0])
        return int(record["verdicts"]), str(record["head"])
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        fix = "remove it if the ledger is complete: the next verdict writes it again"
        raise StoreError(f"{place}: damaged ({clean(error)})", fix=fix) from None


def _check_head(path: Path, head: tuple[int, str] | None, contents: LedgerContents) -> None:
    """Refuse a ledger whose end was cut off, or that is another one than its head is of.

    Raises:
        StoreError: so it is.
    """
    if head is None:
        return
    verdicts, last_sum = head
    fix = _MEND_END.format(head=f"{path}.head")
    if verdicts > len(contents.entries):
        missing = plural(verdicts - len(contents.entries), "verdict")
        raise StoreError(
            f"{path} ends after {plural(len(contents.entries), 'verdict')}, and had {verdicts}: "
            f"{missing} cut off",
            fix=fix,
        )
    if verdicts < 0 or contents.sums[verdicts : verdicts + 1] != (last_sum,):
        raise StoreError(
            f"{path}:{verdicts + 1}: not the line that was written: the ledger was rewritten",
            fix=fix,
        )


def read_ledger(path: Path, *, head: str | None = None) -> LedgerContents:
    """Read a ledger.

    Args:
        path: of the ledger.
        head: the sum of a line that it must still have, as it was kept elsewhere.

    Raises:
        StoreError: it is missing, too large, damaged before its last line, or ends before the line
            of its head.
    """
    try:
        if not path.is_file():
            raise StoreError(f"no ledger at {path}", fix="`nw-eval gate --ledger` begins one")
        target = _followed(path)
        kept = _read_head(target)
        with target.open("rb") as handle:
            contents = _read(path, handle)
        _check_head(target, kept, contents)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error
    if head is not None and head not in contents.sums:
        raise StoreError(
            f"no line of {path} has the sum {clean(head, at_most=80)}: its end was cut off, or it "
            "was rewritten",
            fix="restore it from a copy, or give the head of this ledger",
        )
    return contents


def _lines(entry: LedgerEntry, last_sum: str) -> tuple[bytes, str]:
    """Return the line of an entry and its sum; in an empty file, with the first line before it."""
    records: Sequence[dict[str, Any]] = [{"verdict": entry.model_dump(mode="json")}]
    if not last_sum:
        records = [{"ledger": _VERSION}, *records]
    text = ""
    for record in records:
        line, last_sum = seal(json.dumps(record, separators=(",", ":"), allow_nan=False), last_sum)
        text += line
    return text.encode(), last_sum


def _write(handle: IO[bytes], data: bytes) -> None:
    before = handle.tell()
    try:
        written = 0
        while written < len(data):
            written += handle.write(data[written:])
        os.fsync(handle.fileno())
    except OSError:
        handle.truncate(before)  # A partial line is useless.
        raise


def _read(path: Path, stream: IO[bytes]) -> LedgerContents:
    if os.fstat(stream.fileno()).st_size > _MOST:
        raise StoreError(f"{path} has over {_MOST // 2**20} MiB", fix="check what it is")
    entries: list[LedgerEntry] = []
    good, last_sum = 0, ""
    sums: list[str] = []
    for number, line in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), b""), start=1):
        location = f"{path}:{number}"
        if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
            dropped = f"{location}: dropped a line that was cut off after {len(line)} bytes"
            return LedgerContents(
                entries=tuple(entries), dropped=dropped, good_bytes=good, sums=tuple(sums)
            )
        try:
            body, last_sum = unseal(line, last_sum)
            record = json.loads(body)
            if number == 1:
                _check_version(record, path)
            else:
                entries.append(LedgerEntry.model_validate(record["verdict"]))
        except ValidationError as error:
            first = error.errors()[0]
            fault = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
            raise StoreError(f"{location}: {clean(fault, at_most=200)}", fix=_MEND) from None
        except (ValueError, TypeError, LookupError, RecursionError) as error:
            raise StoreError(f"{location}: damaged ({clean(error)})", fix=_MEND) from None
        good += len(line)
        sums.append(last_sum)
    return LedgerContents(entries=tuple(entries), good_bytes=good, sums=tuple(sums))


def _check_version(record: dict[str, Any], path: Path) -> None:
    if "ledger" not in record:
        raise StoreError(
            f"{path} is not a ledger", fix="name one that `nw-eval gate --ledger` wrote"
        )
    if record["ledger"] != _VERSION:
        raise StoreError(
            f"{path} is a ledger of version {clean(record['ledger'], at_most=40)}, this nw-eval "
            f"reads {_VERSION}",
            fix="use the version of nw-eval that wrote it",
        )


def _lock(handle: IO[bytes]) -> None:
    """Wait for whoever is appending: they take milliseconds."""
    import fcntl  # Not on Windows, where reading still works.

    fcntl.flock(handle.fileno(), fcntl.LOCK_EX)
