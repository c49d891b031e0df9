"""Replays, takeovers and failure attributions in a confined process.

A log may be untrusted, and what it names too. This process reads the log's words and makes the
scene, whose cache is out of the other's reach.
"""

from __future__ import annotations

import shutil
import stat
from base64 import b64decode, b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from nw_base.errors import NwEvalError, PolicyError, StoreError, UsageError
from nw_base.files.cache import atomic_path, followed
from nw_sim.rendering import SHOWN
from nw_sim.rollout.confined.access import policy_rules, running_rules
from nw_sim.rollout.confined.isolated import IsolatedCall, call_isolated
from nw_sim.rollout.job import kernels_of
from nw_sim.rollout.library import Library
from nw_sim.rollout.replaying.film import Film, contact_sheet
from nw_sim.rollout.replaying.logged import agreed, check_inside, check_start, read_logged_trial
from nw_sim.rollout.replaying.reports import AttributionReport, ReplayReport, TakeoverReport
from nw_sim.rollout.replaying.takeover import OPTION, attribute, replay, second_job, take_over

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from nw_base.confinement import Rules
    from nw_base.words import Kernels, Record
    from nw_sim.rollout.job import TrialJob

_LOG, _VIDEO = "trial.mcap", "trial.mp4"
Attributed = AttributionReport | NwEvalError
"""What came of one log: an error costs no other one."""
TIME_LIMIT = 3600.0
"""Seconds; a trial of 12 s takes 5 to 30, its video some minutes."""


def replay_apart(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    picture: Path | None = None,
    video: Path | None = None,
) -> ReplayReport:
    """As `replay`, in a process of its own; draws contact sheet and video if asked for.

    This process reads the log's words and makes the scene, whose cache is out of the other's reach.

    Raises:
        NwEvalError: as `replay`; the policy took more time or memory than it may.
        PrerequisiteError: a video is asked for, and PyAV is not installed.
        StoreError: picture or video cannot be written.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start)
    library = Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    check_inside(start, logged)
    draws = picture is not None or video is not None
    with scratch_folder() as folder:
        ready = _readied(logged.job, path, library, draws=draws, folder=folder)
        answer = _called(
            _replay,
            path,
            ready,
            **_asked(path, policy, checkpoint, allow_code=allow_code),
            start=start,
            draws=picture is not None,
            video=None if video is None else str(folder / _VIDEO),
        )
        try:
            report = TypeAdapter(ReplayReport).validate_python(answer["report"])
            drawn = None if picture is None else b64decode(answer["picture"], validate=True)
        except (KeyError, TypeError, ValueError):
            raise _unread(path, "replay") from None
        if video is not None:
            fetch(folder / _VIDEO, video)
    if picture is not None and drawn is not None:
        with atomic_path(followed(picture)) as temporary:
            temporary.write_bytes(drawn)
    return replace(report, picture=picture, video=video)


def _replay(
    *, log: str, checkpoint: str | None, draws: bool, video: str | None, **asked: Any
) -> dict[str, Any]:
    film = None if video is None else Film(Path(video))
    replayed = replay(Path(log), checkpoint=_path(checkpoint), film=film, **asked)
    drawn = None
    if draws:
        drawn = b64encode(contact_sheet(replayed.logged)).decode()
    return {"report": asdict(replayed.report), "picture": drawn}


def take_over_apart(
    path: Path,
    *,
    start: float,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    out: Path | None = None,
    video: Path | None = None,
    record: Record = "all",
    time_limit: float = TIME_LIMIT,
) -> TakeoverReport:
    """As `take_over`, in a process of its own.

    Raises:
        NwEvalError: as `take_over`; the policy took more time or memory than it may.
        PrerequisiteError: a video is asked for, and PyAV is not installed.
        StoreError: log or video cannot be written.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start, option=OPTION)
    library = Library()
    check_inside(start, read_logged_trial(path), option=OPTION)
    job = second_job(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    # A log's own camera draws, too.
    draws = (out is not None and record != "none") or video is not None
    with scratch_folder() as folder:
        ready = _readied(job, path, library, draws=draws, folder=folder)
        answer = _called(
            _take_over,
            path,
            ready,
            **_asked(path, policy, checkpoint, allow_code=allow_code),
            start=start,
            limit=time_limit,
            record=record,
            out=None if out is None else str(folder / _LOG),
            video=None if video is None else str(folder / _VIDEO),
        )
        try:
            report = TypeAdapter(TakeoverReport).validate_python(answer)
        except ValueError:
            raise _unread(path, "policy switch") from None
        if out is not None:
            fetch(folder / _LOG, out)
        if video is not None:
            fetch(folder / _VIDEO, video)
    return replace(report, log=out, video=video)


def _take_over(
    *, log: str, checkpoint: str | None, out: str | None, video: str | None, **asked: Any
) -> dict[str, Any]:
    film = None if video is None else Film(Path(video))
    taken = take_over(Path(log), checkpoint=_path(checkpoint), out=_path(out), film=film, **asked)
    return asdict(taken.report)


def _asked(
    path: Path, policy: str | None, checkpoint: Path | None, *, allow_code: bool
) -> dict[str, Any]:
    """Return what a confined process is told of a log and the policy that it runs."""
    return {
        "log": str(path.resolve()),
        "policy": policy,
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "allow_code": allow_code,
    }


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


def _called(
    function: Callable[..., Any],
    path: Path,
    ready: _Readied,
    *,
    limit: float = TIME_LIMIT,
    **arguments: Any,
) -> Any:
    return call_isolated(
        function,
        subject=str(path),
        rules=ready.rules,
        time_limit=limit,
        renders=ready.renders,
        policy_process=ready.policy,
        **arguments,
    )


def _unread(path: Path, what: str) -> PolicyError:
    return PolicyError(
        f"{path}: the {what} gave no answer that can be read", fix="do not use this checkpoint"
    )


class _Running(NamedTuple):
    place: int
    call: IsolatedCall
    deadline: float


def attribute_apart(
    logs: Sequence[Path],
    *,
    policy: str | None,
    checkpoint: Path | None,
    allow_code: bool,
    workers: int,
) -> Iterator[tuple[int, Attributed]]:
    """Yield what `attribute` says of logs, each in a process of its own, as they end.

    Args:
        logs: of trials.
        policy: as for `take_over`; also `checkpoint` and `allow_code`.
        checkpoint: see above.
        allow_code: see above.
        workers: how many processes at a time.

    Yields:
        The log's place in `logs`, and its result.
    """
    library = Library()
    todo = list(enumerate(logs))[::-1]
    running: list[_Running] = []
    try:
        while todo or running:
            while todo and len(running) < workers:
                place, log = todo.pop()
                try:
                    job = second_job(
                        log,
                        policy=policy,
                        checkpoint=checkpoint,
                        allow_code=allow_code,
                        library=library,
                    )
                    ready = _readied(job, log, library, draws=False)
                except NwEvalError as error:
                    yield place, error
                    continue
                call = IsolatedCall(
                    _attribute,
                    subject=str(log),
                    rules=ready.rules,
                    renders=ready.renders,
                    policy=ready.policy,
                    arguments=_asked(log, policy, checkpoint, allow_code=allow_code),
                    is_one_of_many=True,
                )
                running.append(_Running(place, call, monotonic() + TIME_LIMIT))
            if not running:
                continue
            nearest = min(each.deadline for each in running) - monotonic()
            receivers = [each.call.receiver for each in running]
            answered = wait(receivers, min(1.0, max(0.0, nearest)))
            for each in tuple(running):
                is_late = each.deadline <= monotonic() or each.call.progress.look()
                if each.call.receiver in answered or is_late:
                    running.remove(each)
                    with each.call:
                        yield each.place, _answer(each.call, logs[each.place])
    finally:
        for each in running:
            each.call.close()


def _answer(call: IsolatedCall, log: Path) -> Attributed:
    try:
        return TypeAdapter(AttributionReport).validate_python(call.answer(0.0))
    except ValidationError:
        return PolicyError(f"{log}: the search gave no answer that can be read")
    except NwEvalError as error:
        return error


def _attribute(*, log: str, checkpoint: str | None, **asked: Any) -> dict[str, Any]:
    return asdict(attribute(Path(log), checkpoint=_path(checkpoint), **asked))


@dataclass(frozen=True, kw_only=True)
class _Readied:
    """How the processes of a recorded trial are confined."""

    rules: Rules
    policy: Rules
    renders: tuple[Kernels, ...]


def _readied(
    job: TrialJob,
    log: Path,
    library: Library,
    *,
    draws: bool,
    folder: Path | None = None,
) -> _Readied:
    """Make the scene of a trial, whose cache is out of the other process's reach.

    Args:
        job: the trial, with the policy that is run, and its caller's leave to run code.
        log: the recorded trial's, which is read.
        library: scenes and bundles that are loaded already.
        draws: whether pictures are made that no policy sees.
        folder: in which the process may write; None = nowhere.

    Raises:
        NwEvalError: scene or policy are not there.
        UsageError: CUDA must draw what is seen, and the caller does not allow code.
    """
    bundle = library.bundle_of(job)
    scene = library.scene(job.scene, job.collision)
    renders = (bool(bundle.card.splat_images) or draws) and scene.splat is not None
    if renders and job.render == "cuda" and not job.allow_code:
        # A log's word may not take the fence away, and the driver needs more than it lets through.
        raise UsageError(
            f"{log}: its pictures were drawn with CUDA, which cannot be confined",
            fix="add --allow-code if you trust the log and the policy",
        )
    if renders:
        scene.splat_store()
    rules = running_rules(
        bundle, scenes=[job.scene], logs=folder, allow_code=job.allow_code, also=[log, *job.also]
    )
    projections = job.rendering.projection, SHOWN.projection
    kernels = kernels_of(job.robot, bundle.card, *projections) if renders else ()
    return _Readied(rules=rules, policy=policy_rules(bundle), renders=kernels)


@contextmanager
def scratch_folder() -> Generator[Path]:
    """Give a folder of our own that a confined process may write into, and remove it."""
    with TemporaryDirectory(prefix="nw-eval-") as folder:
        yield Path(folder)


def fetch(written: Path, destination: Path) -> Path:
    """Copy a file that a confined process has written to where it belongs; return that.

    Raises:
        StoreError: there is no such file, or it cannot be copied.
    """
    try:
        if not stat.S_ISREG(written.lstat().st_mode):  # A link may lead anywhere.
            raise FileNotFoundError
    except OSError:
        raise StoreError(
            f"{destination} was not written by the process that was to", fix="try again"
        ) from None
    with atomic_path(followed(destination)) as temporary:
        shutil.copyfile(written, temporary, follow_symlinks=False)
    return destination
