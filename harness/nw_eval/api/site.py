"""Pages over many runs: an index of them, and a leaderboard that any host of static pages can show.

Both judge the runs again from rows that are checked, and have badges beside them.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from nw_base.clean import clean
from nw_base.errors import IncomparableError, NwEvalError, StoreError, UsageError
from nw_base.files.cache import (
    DamagedError,
    atomic_path,
    followed,
    is_stream,
    made_place,
    private_dir,
    read_sealed,
    sealed_path,
)
from nw_base.files.inside import regular
from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.api.reports import RunReport
    from nw_eval.reporting.html.board import BoardSection
    from nw_eval.reporting.html.runs import ListedLimit, ListedRun
    from nw_gate.results.provenance import RunInfo
    from nw_gate.side_by_side import Entrant, PolicyComparison
    from nw_scenes.scene import Scene

PAGE, RUNS_PAGE, MARK, REPORTS, BADGE = "index.html", "runs.html", "site.json", "runs", "badge"
_WIDTH = 320
"""Of a view of a scene, pixels."""
_QUALITY = 72


@dataclass(frozen=True, kw_only=True)
class RunIndex:
    """Runs, judged again, and the page that lists them."""

    runs: tuple[RunReport, ...]
    unread: tuple[str, ...]
    """A sentence on each run whose rows or run.json are damaged: the page has it, too."""
    page: Path
    badges: tuple[Path, ...] = ()
    """Of all suites together first, then of each."""
    skipped: tuple[Path, ...] = ()
    """What was named and is no run: pages and badges lie beside the runs that a glob means."""

    @property
    def typed_page(self) -> Path:
        """The page as one would type it here."""
        from nw_eval.api.reports import typed

        return typed(self.page)

    @property
    def exit_code(self) -> int:
        """4 if a run could not be read, else 0: the verdicts are those of the runs."""
        return StoreError.exit_code if self.unread else 0


def index_runs(
    runs: Sequence[str | Path],
    *,
    out: str | PathLike[str] | None = None,
    title: str | None = None,
    pictures: bool = True,
) -> RunIndex:
    """Judge runs again as they were begun, and write a page over all and one of each.

    Nothing of the runs' own pages is shown or linked, as somebody else may have written them; they
    stay as they are. A run that is not as it was when it ended is named, and not shown. Badges are
    written beside the page: of `index.html`, `badge.json` and `badge-SUITE.json`.

    Args:
        runs: their folders, and those of `nw-eval limits`.
        out: where to write the page (default: `index.html` in the folder that contains all runs).
        title: of the page (default: the number of runs).
        pictures: whether built-in scenes are drawn, by their splats.

    Raises:
        UsageError: one does not exist, or none is a run's folder; others are skipped.
        StoreError: the page cannot be written.
    """
    from nw_eval.api.reports import as_published, fault_of
    from nw_eval.reporting.html.runs import render_index
    from nw_eval.reporting.markdown import write_report

    out = as_path(out)
    folders, climbed, skipped = _folders(runs, "list")
    page = Path(os.path.commonpath([folder.parent for folder in (*folders, *climbed)])) / PAGE
    page = out or page
    judged: list[RunReport] = []
    listed: list[ListedRun] = []
    unread: list[str] = []
    for folder in folders:
        try:
            run = as_published(folder)
            listed.append(_listed(run, page))
        except Exception as error:  # noqa: BLE001 - One run costs no other run its line.
            unread.append(f"{clean(folder.name)}: {fault_of(error)}")
        else:
            judged.append(run)
    drawn = _Pictures(draws=pictures).of_runs(judged)
    limits = _listed_limits(climbed, page, f"{page.stem}-runs", unread)
    text = render_index(listed, unread, title=title or "", pictures=drawn, limits=limits)
    write_report(page if out is None else followed(page), text)
    stem = BADGE if page.stem == "index" else f"{page.stem}-{BADGE}"
    badges = () if is_stream(page) else _badges(listed, page.parent, stem)
    return RunIndex(
        runs=tuple(judged), unread=tuple(unread), page=page, badges=badges, skipped=skipped
    )


def _folders(
    runs: Sequence[str | Path], what: str
) -> tuple[list[Path], list[Path], tuple[Path, ...]]:
    """Return the folders of runs, those of limits, each once, and what is there and is neither.

    Raises:
        UsageError: one does not exist, or none is a run's or of limits.
    """
    from nw_eval.api.saved_limits import limits_file
    from nw_gate.results.run_folder import find_run_folder

    folders: dict[Path, None] = {}
    limits: dict[Path, None] = {}
    skipped: list[Path] = []
    fault = UsageError(f"no run to {what}", fix="name the folders of some")
    for path in map(Path, runs):
        if limits_file(path):
            limits[path.resolve()] = None
            continue
        try:
            folders[find_run_folder(path).path.resolve()] = None
        except UsageError as error:
            if not os.path.lexists(path):
                raise
            fault = error
            skipped.append(path)
    if not folders and not limits:
        raise fault
    return list(folders), list(limits), tuple(skipped)


def _listed(judged: RunReport, page: Path) -> ListedRun:
    """Return a run as the page lists it, once its own page is written beside it."""
    from nw_eval.api.reports import write_anew
    from nw_eval.reporting.html.runs import ListedRun

    # Two runs of one name lie in two folders.
    digest = sha256(os.fsencode(judged.folder)).hexdigest()[:8]
    name = f"{re.sub(r'[^A-Za-z0-9_-]+', '-', judged.folder.name)[:80]}-{digest}.html"
    beside = f"{page.stem}-runs"
    write_anew(judged, page.with_name(beside) / name, logs=False, draws=False)
    return ListedRun(
        folder=str(judged.typed_folder),
        href=quote(f"{beside}/{name}"),
        info=judged.info,
        verdict=judged.verdict,
    )


def _listed_limits(
    folders: Sequence[Path], page: Path, beside: str, unread: list[str]
) -> list[ListedLimit]:
    """Return the limits of folders, once a page of each is written beside the page of all.

    Args:
        folders: that `nw-eval limits` wrote.
        page: of all.
        beside: the name of the folder beside it that has the pages.
        unread: gets a sentence on each folder that cannot be read.
    """
    from nw_eval.api.reports import fault_of
    from nw_eval.api.saved_limits import verified_limits
    from nw_eval.reporting.html.limits import write_limits
    from nw_eval.reporting.html.runs import ListedLimit, ListedRun

    found: list[ListedLimit] = []
    for folder in folders:
        digest = sha256(os.fsencode(folder)).hexdigest()[:8]
        name = f"{re.sub(r'[^A-Za-z0-9_-]+', '-', folder.name)[:80]}-{digest}"
        try:
            limits = verified_limits(folder)
            made_place(page.with_name(beside) / name)
            write_limits([each for each, _ in limits], page.with_name(beside) / name)
        except Exception as error:  # noqa: BLE001 - As for a run.
            unread.append(f"{clean(folder.name)}: {fault_of(error)}")
            continue
        href = quote(f"{beside}/{name}/limits.html")
        found += [
            ListedLimit(
                run=ListedRun(
                    folder=folder.name, href=href, info=judged.info, verdict=judged.verdict
                ),
                ladder=each.ladder,
                title=each.title,
                limit=each.limit,
            )
            for each, judged in limits
        ]
    return found


def _badges(runs: Sequence[ListedRun], folder: Path, stem: str) -> tuple[Path, ...]:
    """Write the badges of runs, and return where they lie.

    Raises:
        StoreError: one cannot be written.
    """
    from nw_eval.reporting.html.board import badges

    written = badges(runs, stem=stem)
    for name, text in written.items():
        with atomic_path(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return tuple(folder / name for name in written)


@dataclass(frozen=True, kw_only=True)
class WrittenSite:
    """A leaderboard.

    Attributes:
        page: to open, or to publish with the folder that it lies in.
        runs: that it shows.
        left_out: a sentence for each run that it does not.
        badges: of all suites together first, then of each.
        skipped: what was named and is no run.
    """

    page: Path
    runs: int
    left_out: tuple[str, ...]
    badges: tuple[Path, ...] = ()
    skipped: tuple[Path, ...] = ()

    @property
    def exit_code(self) -> int:
        """4 if a run was left out, else 0: the verdicts are those of the runs."""
        return StoreError.exit_code if self.left_out else 0


def write_site(
    runs: Sequence[str | Path],
    out: str | Path,
    *,
    title: str = "Leaderboard",
    confidence: float = 0.95,
    pictures: bool = True,
) -> WrittenSite:
    """Write a leaderboard: policies by suites and tasks, scenes with pictures, and all reports.

    Beside it are an index of the runs, as `index_runs` writes it, and badges. Every page is written
    anew from rows that are checked. A run that is not as it was when it ended, or holds links, is
    named and left out. One that was stopped before it met all scenes stands there without a rank.
    The same runs give the same bytes. A site that is there already is replaced; nothing else is.

    Args:
        runs: their folders, and those of `nw-eval limits`, in any order.
        out: a folder: new, empty, or a site of ours.
        title: of the page.
        confidence: of each interval alone; of all ranks of a suite together.
        pictures: whether built-in scenes are drawn, by their splats, and failed trials from
            outside.

    Raises:
        UsageError: one does not exist, none is a run's folder, or the folder holds something else.
        StoreError: the site cannot be written.
    """
    from nw_eval.api.comparisons import check_share
    from nw_eval.api.reports import as_published, fault_of
    from nw_eval.reporting.html.board import render_board
    from nw_eval.reporting.html.runs import ListedRun, render_index
    from nw_eval.reporting.markdown import write_report

    check_share(confidence)
    folders, climbed, skipped = _folders(runs, "show")
    folder = _emptied(Path(out))
    judged: list[RunReport] = []
    left_out: list[str] = []
    for each in folders:
        try:
            run = as_published(each)
        except Exception as error:  # noqa: BLE001 - One run costs no other run its page.
            left_out.append(f"{clean(each.name)}: {fault_of(error)}")
            continue
        if run.info.is_part:
            left_out.append(f"{each.name}: a part of a run; join the parts with `nw-eval merge`")
        elif run.info.finished is None:
            left_out.append(f"{each.name}: the run has not ended; --resume it")
        else:
            judged.append(run)
    judged.sort(
        key=lambda run: (str(run.info.suite.get("name", "")), run.info.policy.name, run.info.id)
    )
    hrefs = _rendered(judged, folder, left_out, draws=pictures)
    shown = [run for run in judged if run.folder in hrefs]
    drawn = _Pictures(draws=pictures)
    sections = [
        replace(each, pictures=drawn.of_scenes(each.runs[0].info))
        for each in _sections(shown, hrefs, left_out, confidence)
    ]
    listed = [
        ListedRun(
            folder=run.folder.name, href=hrefs[run.folder], info=run.info, verdict=run.verdict
        )
        for run in shown
    ]
    limits = _listed_limits(climbed, folder / PAGE, REPORTS, left_out)
    board = render_board(title, sections, left_out, runs_page=RUNS_PAGE, limits=limits)
    write_report(folder / PAGE, board)
    history = render_index(
        listed,
        (),
        title=f"{title}: runs",
        pictures=drawn.of_runs(shown),
        board=PAGE,
        limits=limits,
    )
    write_report(folder / RUNS_PAGE, history)
    return WrittenSite(
        page=folder / PAGE,
        runs=sum(len(each.runs) + len(each.stopped) for each in sections),
        left_out=tuple(left_out),
        badges=_badges(listed, folder, BADGE),
        skipped=skipped,
    )


def _emptied(out: Path) -> Path:
    """Return the folder without what an earlier site wrote there; it is marked as ours.

    Raises:
        UsageError: it holds something else.
        StoreError: it cannot be written.
    """
    mark = out / MARK
    try:
        if out.is_dir() and any(out.iterdir()):
            ours = False
            with suppress(ValueError, UnicodeDecodeError, FileNotFoundError):
                ours = json.loads(regular(mark).read_text(encoding="utf-8")) == {"nw-site": 1}
            if not ours or (out / REPORTS).is_symlink():
                raise UsageError(
                    f"{out} holds something that is not an nw-eval site", fix="give a new folder"
                )
            shutil.rmtree(out / REPORTS, ignore_errors=True)
            for old in (out / PAGE, out / RUNS_PAGE, *out.glob(f"{BADGE}*.json")):
                old.unlink(missing_ok=True)
        out.mkdir(parents=True, exist_ok=True)
        with atomic_path(mark) as temporary:
            temporary.write_text('{"nw-site": 1}\n', encoding="utf-8")
        (out / REPORTS).mkdir()
    except OSError as error:
        raise StoreError(
            f"cannot write {error.filename}: {error.strerror}", fix="choose another folder"
        ) from error
    return out


def _suite_of(run: RunReport) -> str:
    return str(run.info.suite.get("name", "suite"))


def _rendered(
    judged: Sequence[RunReport], site: Path, left_out: list[str], *, draws: bool
) -> dict[Path, str]:
    """Write a report of each run, and return its address from the page, by the run's folder."""
    from nw_eval.api.reports import fault_of, write_anew

    hrefs: dict[Path, str] = {}
    for number, run in enumerate(judged, 1):
        text = f"{_suite_of(run)}-{run.info.policy.name}"
        slug = f"{number:03d}-{re.sub(r'[^A-Za-z0-9_-]+', '-', text)[:60]}"
        href = f"{REPORTS}/{slug}/report.html"
        try:
            write_anew(run, site / href, logs=True, draws=draws)
        except Exception as error:  # noqa: BLE001 - As for reading it.
            left_out.append(f"{clean(run.folder.name)}: {fault_of(error)}")
        else:
            hrefs[run.folder] = href
    return hrefs


@dataclass
class _Group:
    """Runs that compare: with the first of them, whose scenes may be more than it has met."""

    first: Entrant
    note: str
    """Why its runs do not compare with those of an earlier group of their suite."""
    runs: list[tuple[RunReport, Entrant]]
    stopped: list[RunReport] = field(default_factory=list["RunReport"])
    """Before they had results of all scenes."""


def _sections(
    judged: Sequence[RunReport],
    hrefs: Mapping[Path, str],
    left_out: list[str],
    confidence: float,
) -> list[BoardSection]:
    """Return runs that compare with one another, each in a section; some may be left out."""
    from nw_eval.api.reports import fault_of
    from nw_eval.reporting.html.board import BoardRun, BoardSection
    from nw_gate.side_by_side import entrant_of_run

    groups: list[_Group] = []
    stopped: list[tuple[RunReport, Entrant]] = []
    for run in judged:
        try:
            entrant = replace(
                entrant_of_run(run.info.policy.short_digest, run.info, run.rows),
                policy=run.info.policy.folder_name,
            )
        except Exception as error:  # noqa: BLE001 - As for reading it.
            left_out.append(f"{clean(run.folder.name)}: {fault_of(error)}")
            continue
        met = {name[0] for name in entrant.results}
        lacking = sorted(set(entrant.key.scenes) - met)
        if not lacking:
            _join(groups, run, entrant)
        elif met and run.info.stop is not None and run.verdict.success is not None:
            stopped.append((run, entrant))
        else:
            left_out.append(f"{run.folder.name}: it has no result from scene {lacking[0]}")
    for run, entrant in stopped:
        _join(groups, run, entrant, is_stopped=True)

    def shown(run: RunReport) -> BoardRun:
        return BoardRun(info=run.info, verdict=run.verdict, href=hrefs[run.folder])

    sections = [
        (each, comparison, group.note, () if index else group.stopped)
        for group in groups
        for index, (each, comparison) in enumerate(_compared(group.runs, confidence, left_out))
    ]
    suites = [runs[0][1].suite for runs, *_ in sections]
    return [
        BoardSection(
            title=f"{suites[index]} ({suites[: index + 1].count(suites[index])})"
            if suites.count(suites[index]) > 1
            else suites[index],
            note=note,
            comparison=comparison,
            runs=tuple(shown(run) for run, _ in runs),
            stopped=tuple(map(shown, stopped)),
            pictures={},
        )
        for index, (runs, comparison, note, stopped) in enumerate(sections)
    ]


def _join(
    groups: list[_Group], run: RunReport, entrant: Entrant, *, is_stopped: bool = False
) -> None:
    """Put a run to those that it compares with, or into a group of its own."""
    from nw_gate.side_by_side import check_alike

    note = ""
    for group in groups:
        if group.first.suite != entrant.suite:
            continue
        try:
            check_alike([group.first, entrant])
        except IncomparableError as error:
            note = error.message
            continue
        if is_stopped:
            group.stopped.append(run)
        else:
            group.runs.append((run, entrant))
        return
    alone = entrant
    if is_stopped:  # Over what it has met.
        met = {name[0] for name in entrant.results}
        scenes = {name: each for name, each in entrant.key.scenes.items() if name in met}
        alone = replace(entrant, key=entrant.key.model_copy(update={"scenes": scenes}))
    groups.append(_Group(entrant, note, [(run, alone)]))


def _compared(
    group: list[tuple[RunReport, Entrant]], confidence: float, left_out: list[str]
) -> list[tuple[list[tuple[RunReport, Entrant]], PolicyComparison]]:
    """Return runs with their comparison: each alone where they have none together."""
    from nw_eval.api.reports import fault_of
    from nw_gate.side_by_side import compared

    try:
        return [(group, compared([entrant for _, entrant in group], confidence))]
    except Exception as error:  # noqa: BLE001 - As for reading them.
        if len(group) == 1:
            left_out.append(f"{clean(group[0][0].folder.name)}: {fault_of(error)}")
            return []
    return [each for one in group for each in _compared([one], confidence, left_out)]


@dataclass(frozen=True, kw_only=True)
class _Pictures:
    """JPEGs of scenes by name and digest, each drawn once; None of those that cannot be."""

    draws: bool
    drawn: dict[tuple[str, str], bytes | None] = field(
        default_factory=dict[tuple[str, str], bytes | None]
    )

    def of_scenes(self, info: RunInfo) -> dict[str, bytes]:
        """Return those of a run's scenes, by name."""
        return {name: picture for (name, _), picture in self._of(info).items()}

    def of_runs(self, runs: Sequence[RunReport]) -> dict[tuple[str, str], bytes]:
        """Return those of all scenes of several runs."""
        return {key: picture for run in runs for key, picture in self._of(run.info).items()}

    def _of(self, info: RunInfo) -> dict[tuple[str, str], bytes]:
        contents: dict[tuple[str, str], bytes] = {}
        for name, scene in info.scenes.items() if self.draws else ():
            key = (name, scene.digest)
            if key not in self.drawn:
                self.drawn[key] = _picture(*key)
            if (picture := self.drawn[key]) is not None:
                contents[key] = picture
        return contents


def _picture(name: str, digest: str) -> bytes | None:
    from nw_sim.catalogue import get_scene, is_built_in

    if not is_built_in(name):  # Nothing that an untrusted run names is opened or fetched.
        return None
    kept = _kept(name, digest)
    with suppress(OSError, DamagedError):
        if kept is not None:
            return bytes(read_sealed(kept))
    try:
        scene = get_scene(name)
        if scene.digest != digest:
            return None
        picture = _drawn(scene)
    except NwEvalError:  # Not of this machine; the page does without.
        return None
    if kept is not None:
        with suppress(StoreError), sealed_path(kept) as path:
            path.write_bytes(picture)
    return picture


def _drawn(scene: Scene) -> bytes:
    from io import BytesIO

    import numpy as np
    from PIL import Image

    from nw_sim.rollout.replaying.film import scene_views

    content = BytesIO()
    views = scene_views(scene, width=_WIDTH)
    Image.fromarray(np.hstack(views)).save(content, format="JPEG", quality=_QUALITY)
    return content.getvalue()


def _kept(name: str, digest: str) -> Path | None:
    """Return where the picture of a scene is kept for the next page; None without a cache."""
    from nw_gate.results.provenance import code_info

    drawn_by = f"{code_info().digest} {_WIDTH} {_QUALITY} {name} {digest}"
    try:
        return private_dir("pictures") / sha256(drawn_by.encode()).hexdigest()
    except StoreError:
        return None
