"""A leaderboard over runs, as a folder that any host of static pages can show."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.errors import IncomparableError, NwEvalError, StoreError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import regular

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_eval.gate.side_by_side import Entrant, PolicyComparison
    from nw_eval.reporting.html.runs import BoardSection

PAGE, MARK, REPORTS = "index.html", "site.json", "runs"
_WIDTH = 320
"""Of a view of a scene, pixels."""
_QUALITY = 72


@dataclass(frozen=True, kw_only=True)
class WrittenSite:
    """A leaderboard.

    Attributes:
        page: to open, or to publish with the folder that it lies in.
        runs: that it shows.
        left_out: a sentence for each run that it does not.
    """

    page: Path
    runs: int
    left_out: tuple[str, ...]

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

    Every page is written anew from rows that are checked. A run that is not as it was when it
    ended, or holds links, is named and left out. The same runs give the same bytes. A site that is
    there already is replaced; nothing else is.

    Args:
        runs: their folders, in any order.
        out: a folder: new, empty, or a site of ours.
        title: of the page.
        confidence: of each interval alone; of all ranks of a suite together.
        pictures: whether built-in scenes are drawn, by their splats.

    Raises:
        UsageError: one is no run's folder, there is none, or the folder holds something else.
        StoreError: the site cannot be written.
    """
    from nw_eval.api.comparisons import check_share
    from nw_eval.api.reports import as_published, fault_of
    from nw_eval.reporting.html.runs import render_board
    from nw_eval.reporting.markdown import write_report
    from nw_eval.results.run_folder import open_run_folder

    check_share(confidence)
    if not runs:
        raise UsageError("no run to show", fix="name the folders of some")
    folders = list(dict.fromkeys(open_run_folder(Path(run)).path.resolve() for run in runs))
    folder = _emptied(Path(out))
    judged: list[RunReport] = []
    left_out: list[str] = []
    for each in folders:
        try:
            run = as_published(each)
        except Exception as error:  # noqa: BLE001 - One run costs no other run its page.
            left_out.append(f"{clean(each.name)}: {fault_of(error)}")
            continue
        if run.info.shard is not None:
            left_out.append(f"{each.name}: a part of a run; join the parts with `nw-eval merge`")
        elif run.info.finished is None:
            left_out.append(f"{each.name}: the run has not ended; --resume it")
        else:
            judged.append(run)
    judged.sort(
        key=lambda run: (str(run.info.suite.get("name", "")), run.info.policy.name, run.info.id)
    )
    hrefs = _rendered(judged, folder, left_out)
    shown = [run for run in judged if run.folder in hrefs]
    sections = _sections(shown, hrefs, left_out, confidence)
    if pictures:
        drawn: dict[tuple[str, str], bytes | None] = {}
        sections = [replace(each, pictures=_pictures(each, drawn)) for each in sections]
    write_report(folder / PAGE, render_board(title, sections, left_out))
    runs_shown = sum(len(each.runs) for each in sections)
    return WrittenSite(page=folder / PAGE, runs=runs_shown, left_out=tuple(left_out))


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
            if not ours:
                raise UsageError(
                    f"{out} holds something that is no site of nw-eval", fix="give a new folder"
                )
            shutil.rmtree(out / REPORTS, ignore_errors=True)
            (out / PAGE).unlink(missing_ok=True)
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


def _rendered(judged: Sequence[RunReport], site: Path, left_out: list[str]) -> dict[Path, str]:
    """Write a report of each run, and return its address from the page, by the run's folder."""
    from nw_eval.api.reports import fault_of, write_anew

    hrefs: dict[Path, str] = {}
    for number, run in enumerate(judged, 1):
        words = f"{_suite_of(run)}-{run.info.policy.name}"
        slug = f"{number:03d}-{re.sub(r'[^A-Za-z0-9_-]+', '-', words)[:60]}"
        href = f"{REPORTS}/{slug}/report.html"
        try:
            write_anew(run, site / href, logs=True)
        except Exception as error:  # noqa: BLE001 - As for reading it.
            left_out.append(f"{clean(run.folder.name)}: {fault_of(error)}")
        else:
            hrefs[run.folder] = href
    return hrefs


def _sections(
    judged: Sequence[RunReport],
    hrefs: Mapping[Path, str],
    left_out: list[str],
    confidence: float,
) -> list[BoardSection]:
    """Return runs that compare with one another, each in a section; some may be left out."""
    from nw_eval.api.reports import fault_of
    from nw_eval.gate.side_by_side import check_alike, entrant_of_run
    from nw_eval.reporting.html.runs import BoardRun, BoardSection

    groups: list[list[tuple[RunReport, Entrant]]] = []
    notes: list[str] = []
    for run in judged:
        try:
            entrant = entrant_of_run(run.folder.name, run.info, run.rows)
        except Exception as error:  # noqa: BLE001 - As for reading it.
            left_out.append(f"{clean(run.folder.name)}: {fault_of(error)}")
            continue
        met = {name[0] for name in entrant.results}
        if lacking := sorted(set(entrant.key.scenes) - met):
            left_out.append(f"{run.folder.name}: it has no result from scene {lacking[0]}")
            continue
        note = ""
        for group in groups:
            if group[0][1].suite != entrant.suite:
                continue
            try:
                check_alike([group[0][1], entrant])
            except IncomparableError as error:
                note = error.message
                continue
            group.append((run, entrant))
            break
        else:
            groups.append([(run, entrant)])
            notes.append(note)
    found = [
        (each, comparison, note)
        for group, note in zip(groups, notes, strict=True)
        for each, comparison in _compared(group, confidence, left_out)
    ]
    suites = [group[0][1].suite for group, _, _ in found]
    return [
        BoardSection(
            title=f"{suites[place]} ({suites[: place + 1].count(suites[place])})"
            if suites.count(suites[place]) > 1
            else suites[place],
            note=note,
            comparison=comparison,
            runs=tuple(
                BoardRun(info=run.info, verdict=run.verdict, href=hrefs[run.folder])
                for run, _ in group
            ),
            pictures={},
        )
        for place, (group, comparison, note) in enumerate(found)
    ]


def _compared(
    group: list[tuple[RunReport, Entrant]], confidence: float, left_out: list[str]
) -> list[tuple[list[tuple[RunReport, Entrant]], PolicyComparison]]:
    """Return runs with their comparison: each alone where they have none together."""
    from nw_eval.api.reports import fault_of
    from nw_eval.gate.side_by_side import compared

    try:
        return [(group, compared([entrant for _, entrant in group], confidence))]
    except Exception as error:  # noqa: BLE001 - As for reading them.
        if len(group) == 1:
            left_out.append(f"{clean(group[0][0].folder.name)}: {fault_of(error)}")
            return []
    return [each for one in group for each in _compared([one], confidence, left_out)]


def _pictures(
    section: BoardSection, drawn: dict[tuple[str, str], bytes | None]
) -> dict[str, bytes]:
    """Return a JPEG of each scene that is the one of these runs and can be drawn here."""
    digests = {name: scene.digest for name, scene in section.runs[0].info.scenes.items()}
    found: dict[str, bytes] = {}
    for scene in section.comparison.scenes:
        key = (scene.scene, digests.get(scene.scene, ""))
        if key not in drawn:
            drawn[key] = _picture(*key)
        picture = drawn[key]
        if picture is not None:
            found[scene.scene] = picture
    return found


def _picture(name: str, digest: str) -> bytes | None:
    from io import BytesIO

    import numpy as np
    from PIL import Image

    from nw_eval.catalogue import get_scene, is_built_in
    from nw_eval.rollout.replaying.contact_sheet import scene_views

    if not is_built_in(name):  # Nothing that an untrusted run names is opened or fetched.
        return None
    try:
        scene = get_scene(name)
        if scene.digest != digest:
            return None
        views = scene_views(scene, width=_WIDTH)
    except NwEvalError:  # Not of this machine; the page does without.
        return None
    content = BytesIO()
    Image.fromarray(np.hstack(views)).save(content, format="JPEG", quality=_QUALITY)
    return content.getvalue()
