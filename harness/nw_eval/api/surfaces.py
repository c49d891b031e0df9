"""Where a judged run is shown besides its report: JUnit, GitHub's runner, a comment, trackers.

Reporting never changes the verdict: whatever keeps one from being written is a warning, and
changes no exit code.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

from nw_base.clean import clean
from nw_base.errors import NwEvalError, UsageError, nearest
from nw_base.plugins import REPORTERS as GROUP
from nw_base.plugins import installed, load, warn_if_built_in
from nw_base.words import Tracker

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.api.reports import RunReport


@dataclass(frozen=True, kw_only=True)
class Reporter:
    """What shows a judged run somewhere: `--reporter NAME[=PATH]`.

    Those that are built in are `REPORTERS`; packages bring along others (entry-point group
    `nw_eval.reporters`).

    Attributes:
        name: by which it is asked for.
        writes: what it writes, for messages: `JUnit file`.
        report: gets the run, and what stands behind `NAME=`: where `target` is `file`, the path of
            a temporary file beside the one that is asked for, which replaces it when all is
            written; else the words, or None. Whatever it raises is a warning, and costs the run
            neither its verdict nor its exit code.
        target: whether a file must be named, words may be, or nothing.
        check: called before anything runs; raises `NwEvalError` where something that it needs is
            not there.
        failed: gets the error that kept a run from a verdict, the suite as it was typed, and what
            `report` would get. Where it is None, a file that an earlier run wrote is removed.

    Raises:
        ValueError: the name has other characters than letters, digits, `_`, `-` and `.`.
    """

    name: str
    writes: str
    report: Callable[[RunReport, Any], object]
    target: Literal["file", "words", "nothing"] = "nothing"
    check: Callable[[], None] | None = None
    failed: Callable[[NwEvalError, str, Any], object] | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", self.name):
            raise ValueError(
                f"reporter {self.name!r}: a name has letters, digits, '_', '-' and '.'"
            )


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Where to show a run; nowhere by default."""

    junit: str | PathLike[str] | None = None
    """A file of JUnit XML."""
    github: bool = False
    """GitHub's runner, as the environment describes it: summary, outputs, annotations."""
    comment: str | PathLike[str] | None = None
    """A file of Markdown, short enough for a comment on a pull request."""
    track: tuple[Tracker, ...] = ()
    """Trackers of experiments."""
    reporters: tuple[str, ...] = ()
    """Any reporters: `NAME` or `NAME=PATH`."""

    @property
    def wanted(self) -> list[tuple[Reporter, str | None]]:
        """The reporters that are asked for, each with what stands behind its name.

        Raises:
            UsageError: there is no such reporter, a file is missing, or is one too much.
            PluginError: the package that has it is broken.
        """
        words: list[tuple[str, str | None]] = []
        words += [] if self.junit is None else [("junit", str(self.junit))]
        words += [] if self.comment is None else [("comment", str(self.comment))]
        words += [(name, None) for name in self.track]
        for each in self.reporters:
            name, equals, target = each.partition("=")
            words.append((name, target if equals else None))
        return [(_reporter(name, target), target) for name, target in words]


def _reporter(name: str, target: str | None) -> Reporter:
    if name in REPORTERS:
        warn_if_built_in(GROUP, name)
        reporter = REPORTERS[name]
    elif name in installed(GROUP):
        reporter = load(GROUP, name, Reporter)
    else:
        raise UsageError(
            f"--reporter {name} is unknown",
            fix=nearest(name, {*REPORTERS, *installed(GROUP)}),
        )
    if reporter.target == "file" and not target:
        raise UsageError(f"--reporter {name}: it writes a file", fix=f"--reporter {name}=PATH")
    if reporter.target == "nothing" and target is not None:
        raise UsageError(f"--reporter {name}={target}: it takes nothing", fix=f"--reporter {name}")
    return reporter


@dataclass(frozen=True, kw_only=True)
class Published:
    """What became of the surfaces of a run."""

    surfaces: tuple[str, ...]
    """Those that show it now."""
    warnings: tuple[str, ...]
    """A line for each that does not, with the reason."""
    commands: tuple[str, ...] = ()
    """Lines that GitHub's runner reads from standard output: annotations."""


def check_surfaces(where: Surfaces) -> Surfaces:
    """Return surfaces, once it is known that what they need is there: before anything runs.

    Raises:
        UsageError: there is no such reporter, or a folder is where a file is to be written.
        PrerequisiteError: its extra is not installed.
        PluginError: the package that has it is broken.
    """
    from nw_base.files.cache import followed
    from nw_eval.reporting.trackers.tracked import check_trackers

    check_trackers(where.track)
    for reporter, target in where.wanted:
        if reporter.target == "file" and target is not None:
            followed(Path(target))
        if reporter.check is not None:
            reporter.check()
    return where


def publish(judged: RunReport, where: Surfaces, *, exit_code: int | None = None) -> Published:
    """Show a judged run; what cannot be written is among the warnings, and never raised.

    Args:
        judged: the run.
        where: the surfaces.
        exit_code: of the process that judged it, where it is not the verdict's.
    """
    code = judged.exit_code if exit_code is None else exit_code
    wanted = where.wanted
    writers = [
        _writer(each, target, partial(each.report, judged), run=judged.folder)
        for each, target in wanted
    ]
    if where.github:
        writers += [
            ("step summary", partial(_write_summary, judged)),
            ("step outputs", partial(_write_outputs, _outputs(judged, code))),
            ("annotations", partial(_annotations, judged)),
        ]
    return _write_all(writers)


def publish_error(error: NwEvalError, suite: str, where: Surfaces) -> Published:
    """Show that a run came to no verdict, so that no reader takes an earlier one for its own.

    Args:
        error: what kept it from one.
        suite: what was to be run, as it was typed.
        where: the surfaces.
    """
    try:
        wanted = where.wanted
    except NwEvalError:  # It is what is told, or no reporter could tell of it.
        wanted = Surfaces(junit=where.junit, comment=where.comment).wanted
    writers = [
        _writer(each, target, partial(each.failed, error, suite))
        if each.failed is not None
        else (each.writes, partial(_remove, each, target))
        for each, target in wanted
    ]
    if where.github:
        outputs = {"verdict": "", "exit-code": str(error.exit_code)}
        writers += [
            ("step outputs", partial(_write_outputs, outputs)),
            ("annotations", partial(_annotations_of_error, error)),
        ]
    return _write_all(writers)


_Writer = tuple[str, Callable[[], Sequence[str] | None]]
"""A surface's name and its writer; the runner reads what the writer returns."""


def _writer(
    reporter: Reporter,
    target: str | None,
    write: Callable[[Any], object],
    run: Path | None = None,
) -> _Writer:
    """Return what lets a reporter write; its file appears whole or not at all."""

    def call() -> None:
        from nw_base.files.cache import atomic_path, followed
        from nw_gate.results.run_folder import RunFolder

        if reporter.target != "file" or target is None:
            write(target)
            return
        path = followed(Path(target))
        if run is not None and path.resolve() in RunFolder(path=run).files:
            raise UsageError(f"{target} is a file of the run itself", fix="name another file")
        with atomic_path(path) as temporary:
            write(temporary)

    return reporter.writes, call


def _remove(reporter: Reporter, target: str | None) -> None:
    """Remove what an earlier run wrote, so that no reader takes it for this run's."""
    if target is None or reporter.target != "file" or not Path(target).is_file():
        return
    with Path(target).open("rb") as stream:
        is_ours = stream.read(len(_COMMENT)) == _COMMENT
    if is_ours or reporter.name != "comment":
        Path(target).unlink()


_COMMENT = b"<!-- nw-eval"
"""What a comment begins with; a file of the user's stays."""


def _write_all(writers: Sequence[_Writer]) -> Published:
    surfaces: list[str] = []
    warnings: list[str] = []
    commands: list[str] = []
    for name, write in writers:
        try:
            commands += write() or ()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - none is worth a verdict.
            kind = "" if isinstance(error, NwEvalError) else f"{type(error).__name__}: "
            warnings.append(f"no {name}: {kind}{clean(error)}")
        else:
            surfaces.append(name)
    return Published(surfaces=tuple(surfaces), warnings=tuple(warnings), commands=tuple(commands))


def _write_junit(judged: RunReport, path: Path) -> None:
    from nw_eval.reporting.junit import junit_xml
    from nw_eval.reporting.scene_states import suite_lines

    lines = suite_lines(judged.info, Path.cwd())
    rows, verdict = judged.rows, judged.verdict
    path.write_bytes(junit_xml(judged.info, rows, verdict, judged.typed_folder, lines))


def _write_junit_error(error: NwEvalError, suite: str, path: Path) -> None:
    from nw_eval.reporting.junit import junit_of_error

    path.write_bytes(junit_of_error(suite, error))


def _write_comment(judged: RunReport, path: Path) -> None:
    from nw_eval.reporting.github import comment_page

    page = comment_page(judged.info, judged.rows, judged.verdict, judged.typed_folder)
    path.write_bytes(page.encode())


def _write_summary(judged: RunReport) -> None:
    from nw_eval.reporting.github import SUMMARY, append, room_in, runner_of, summary_page

    summary = runner_of(os.environ).summary
    page = summary_page(
        judged.info,
        judged.rows,
        judged.verdict,
        judged.typed_folder,
        budget=min(SUMMARY, room_in(summary)),
    )
    append(summary, page, "GITHUB_STEP_SUMMARY")


def _outputs(judged: RunReport, exit_code: int) -> dict[str, str]:
    mean = judged.verdict.success
    success = "" if mean is None else f"{mean:.6f}"
    return {
        "verdict": judged.verdict.verdict,
        "exit-code": str(exit_code),
        "success": success,
        "effect": success,  # Its name until 0.1; goes with the next release.
        "trials": str(judged.verdict.n),
        "report-path": str(judged.typed_folder),
    }


def _write_outputs(outputs: dict[str, str]) -> None:
    from nw_eval.reporting.github import append, outputs_text, runner_of

    append(runner_of(os.environ).output, outputs_text(outputs), "GITHUB_OUTPUT")


def _annotations(judged: RunReport) -> Sequence[str]:
    from nw_eval.reporting.github import run_annotations, runner_of
    from nw_eval.reporting.scene_states import suite_lines

    lines = suite_lines(judged.info, runner_of(os.environ).workspace)
    return run_annotations(judged.info, judged.verdict, lines)


def _annotations_of_error(error: NwEvalError) -> Sequence[str]:
    from nw_eval.reporting.github import error_annotations, runner_of

    return error_annotations(error, runner_of(os.environ).workspace)


def _track_run(judged: RunReport, tracker: Tracker) -> None:
    """Show a run in a tracker, with pages and clips that were written of this verdict.

    Raises:
        Exception: whatever the tracker's library raises.
    """
    from nw_eval.reporting.trackers.tracked import track, tracked_run

    pages = tuple(page for page in (judged.page, judged.html) if page is not None)
    clips = () if judged.evidence is None else judged.evidence.clips
    run = tracked_run(judged.info, judged.verdict, judged.folder, pages, clips)
    training = judged.training
    track(tracker, run if training is None else run.at_step(training.step, training.folder))


def _tracker(name: Tracker) -> Reporter:
    return Reporter(
        name=name, writes=f"{name} run", report=lambda judged, _: _track_run(judged, name)
    )


REPORTERS = MappingProxyType(
    {
        each.name: each
        for each in (
            Reporter(
                name="junit",
                writes="JUnit file",
                report=_write_junit,
                target="file",
                failed=_write_junit_error,
            ),
            Reporter(name="comment", writes="comment", report=_write_comment, target="file"),
            *(_tracker(name) for name in get_args(Tracker)),
        )
    }
)
"""The reporters that are built in, by name; GitHub's runner has an option of its own."""
