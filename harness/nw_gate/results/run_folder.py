"""The folder of one run: which file is what."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import NoReturn

from nw_base.errors import StoreError, UsageError
from nw_base.files.inside import OutsideError, inside, what_is
from nw_gate.results.log_links import is_own_link


@dataclass(frozen=True, kw_only=True)
class RunFolder:
    """Paths within `reports/<suite>-<policy>-<utc time>-<digest8>/`."""

    path: Path

    @property
    def id(self) -> str:
        """The run's name."""
        return self.path.name

    @property
    def run_json(self) -> Path:
        """Provenance of the run; see `provenance.RunInfo`."""
        return self.path / "run.json"

    @property
    def journal(self) -> Path:
        """One line per finished trial; see `journal`."""
        return self.path / "journal.jsonl"

    @property
    def trials(self) -> Path:
        """All rows, written at the end; see `parquet`."""
        return self.path / "trials.parquet"

    @property
    def digests(self) -> Path:
        """What the Merkle root of run.json is made of; see `evidence.Digests`."""
        return self.path / "digests.json"

    @property
    def report_md(self) -> Path:
        """The report for people."""
        return self.path / "report.md"

    @property
    def report_html(self) -> Path:
        """The report for a browser, in one file."""
        return self.path / "report.html"

    @property
    def cause(self) -> Path:
        """What its drop is due to, where that was asked; see `gate.cause`."""
        return self.path / "cause.json"

    @property
    def baseline(self) -> RunFolder:
        """The run of the baseline's own policy, on a new class of machine."""
        return RunFolder(path=self.path / "baseline")

    @property
    def limits(self) -> Path:
        """The runs on ladders: `<ladder>/candidate`, and `<ladder>/baseline` if that ran, too."""
        return self.path / "limits"

    @property
    def limit_runs(self) -> tuple[RunFolder, ...]:
        """The folders of its runs on ladders."""
        found = sorted(self.limits.glob("*/*/run.json"))
        return tuple(RunFolder(path=path.parent) for path in found)

    @property
    def workers_log(self) -> Path:
        """What worker processes printed, if they did."""
        return self.path / "workers.log"

    @property
    def files(self) -> frozenset[Path]:
        """All files of the run itself, but for the logs of trials."""
        own = (self.run_json, self.journal, self.trials, self.digests, self.report_md)
        own += (self.report_html, self.cause, self.workers_log, self.layout)
        return frozenset(path.resolve() for path in own)

    @property
    def layout(self) -> Path:
        """A layout of Foxglove and Lichtblick for the logs of this run."""
        return self.path / "foxglove.json"

    @property
    def logs(self) -> Path:
        """The logs of trials: all that worker processes write."""
        return self.path / "mcap"

    @property
    def cached(self) -> Path:
        """The logs of trials that were reused from earlier runs, as `logs` has the others.

        They are the cache's own files, which no worker process may write.
        """
        return self.path / "cached"

    def mcap(self, scene: str, trial_id: str) -> Path:
        """Path of a trial's log; `relative` gives what its row says.

        Raises:
            StoreError: the names lead out of the folder.
        """
        return self._log(self.logs, scene, trial_id)

    def cached_mcap(self, scene: str, trial_id: str) -> Path:
        """Path of the log of a trial that was taken over, as above.

        Raises:
            StoreError: the names lead out of the folder.
        """
        return self._log(self.cached, scene, trial_id)

    def _log(self, logs: Path, scene: str, trial_id: str) -> Path:
        try:
            inside(logs, f"{scene}/{trial_id}.mcap")
        except OutsideError as error:
            raise StoreError(
                f"trial {trial_id!r} of scene {scene!r} is not allowed in {self.path}: {error}",
                fix="rename the scene",
            ) from None
        return logs / PurePosixPath(scene) / f"{trial_id}.mcap"

    def baseline_file(self, name: str) -> Path:
        """Path of the copy of the baseline that the run is compared with.

        Raises:
            StoreError: the name leads out of the folder.
        """
        try:
            return inside(self.path, f"bank/{name}.parquet")
        except OutsideError as error:
            raise StoreError(
                f"baseline {name!r} is not allowed in {self.path}: {error}",
                fix="rename the baseline",
            ) from None

    def relative(self, path: Path) -> str:
        """Return a path of this folder as rows hold it: relative, with slashes."""
        return path.relative_to(self.path).as_posix()


def create_run_folder(
    root: Path,
    *,
    suite: str,
    policy: str,
    digest: str,
    part: str = "",
    now: datetime | None = None,
) -> RunFolder:
    """Make the folder of a new run.

    Args:
        root: usually `reports/`; made if it is missing.
        suite: the suite's name.
        policy: the policy's name; what a file name cannot hold is replaced.
        digest: hex; its first eight digits end the name.
        part: which part of a run it is, such as `1/3`, and then ends the name; empty for a whole.
        now: an aware time, by default the present.

    Raises:
        StoreError: the folder cannot be made.
    """
    time = (now or datetime.now(tz=UTC)).astimezone(UTC)
    name = f"{_slug(suite)}-{_slug(policy)}-{time:%Y%m%dT%H%M%SZ}-{digest[:8]}"
    if part:
        name = f"{name}-{part.replace('/', 'of')}"
    for attempt in range(1, 100):
        path = root / (name if attempt == 1 else f"{name}-{attempt}")
        try:
            root.mkdir(parents=True, exist_ok=True)
            path.mkdir()
        except FileExistsError:
            if not root.is_dir():
                raise StoreError(f"{root} is a file", fix="choose a folder with --out") from None
            continue
        except OSError as error:
            raise StoreError(
                f"cannot make {path}: {error.strerror}", fix="choose another folder with --out"
            ) from error
        return RunFolder(path=path)
    raise StoreError(f"a hundred runs named {name} exist", fix="choose another folder with --out")


def open_run_folder(path: Path) -> RunFolder:
    """Return the folder of an existing run; any file directly in it will do for its name.

    Raises:
        UsageError: it is no run folder, or `check_folders` refuses it.
    """
    folder = find_run_folder(path)
    check_folders(folder.path)
    return folder


def find_run_folder(path: Path) -> RunFolder:
    """Return the folder of a run as `open_run_folder` does, with whatever lies in it.

    Raises:
        UsageError: it is no run folder.
    """
    folder = RunFolder(path=path.parent if what_is(path) == "file" else path)
    if what_is(folder.run_json) != "file" and what_is(folder.journal) != "file":
        raise UsageError(
            f"{path} is not the folder of a run (no run.json in it)",
            fix="name one of the folders in reports/",
        )
    return folder


def check_folders(run: Path) -> None:
    """Refuse a run's folder that has a link where a folder is followed, whoever put it there.

    Each folder is opened by its descriptor, so that none is exchanged meanwhile.

    Raises:
        UsageError: so it is, or one cannot be read.
    """

    def unreadable(error: OSError) -> NoReturn:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}", fix="check its rights")

    for top in ("mcap", "cached", "bank", "baseline", "limits"):
        if not os.path.lexists(run / top):
            continue
        if (run / top).is_symlink():
            _no_folder(run / top)
        if not (run / top).is_dir():
            continue  # Nothing is followed: what was to be written there is lost, and said to be.
        for at, folders, _, handle in os.fwalk(run / top, onerror=unreadable):
            for name in folders:
                if stat.S_ISLNK(os.lstat(name, dir_fd=handle).st_mode):
                    _no_folder(Path(at, name))


def _no_folder(path: Path) -> NoReturn:
    raise UsageError(
        f"{path} is a link: what is written there would be elsewhere",
        fix="replace it by the folder that it leads to",
    )


_MOST_FILES, _MOST_BYTES = 500_000, 16 * 2**30
"""Of what is read of a run's folder; a run of 200,000 trials has as many logs."""


def check_plain(folder: RunFolder) -> None:
    """Refuse a folder in which a file that is read is none of its own, or larger than any run's.

    Those files are published. Others of the folder are not looked at. Logs may have a second name
    in the cache: what they hold is compared with the rows.

    Raises:
        StoreError: one of them is a link, a device or a pipe, they are too many or too large, or
            the folder cannot be read.
    """
    count = size = 0
    try:
        for path, facts in _read_files(folder):
            fault, name = "", folder.relative(path)
            is_link = stat.S_ISLNK(facts.st_mode)
            # The logs of a run on a ladder are linked within its own folder.
            of_ladder = path.relative_to(folder.path).parts[0] == folder.limits.name
            own = name.split("/", 3)[-1] if of_ladder else name
            # What a link of ours leads to is among the files; whose row has it, digests say.
            if not stat.S_ISREG(facts.st_mode) and not (is_link and is_own_link(path, own)):
                kind = "a symbolic link" if is_link else "not a plain file"
                fault = f"{name} is {kind}"
            elif facts.st_nlink > 1 and path.suffix != ".mcap":
                fault = f"{name} is a hard link: the file has another name, too"
            count, size = count + 1, size + facts.st_size
            if count > _MOST_FILES or size > _MOST_BYTES:
                fault = f"it has over {_MOST_FILES:,} files or {_MOST_BYTES // 2**30} GiB"
            if fault:
                raise StoreError(
                    f"{folder.path} is not published: {fault}", fix="publish the run's own folder"
                )
    except OSError as error:
        raise StoreError(
            f"cannot read {error.filename}: {error.strerror}", fix="check its rights"
        ) from error


def _read_files(folder: RunFolder) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the files of a run that are read, and all that is no folder among them."""
    single = (folder.run_json, folder.journal, folder.trials, folder.digests, folder.cause)
    waiting = [*single, folder.logs, folder.cached, folder.path / "bank", folder.limits]
    while waiting:
        path = waiting.pop()
        try:
            facts = path.lstat()
        except FileNotFoundError:
            continue
        if stat.S_ISDIR(facts.st_mode) and path not in single:
            with os.scandir(path) as entries:
                waiting += [Path(entry.path) for entry in entries]
        else:
            yield path, facts


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.]+", "-", text).strip("-.") or "unnamed"
