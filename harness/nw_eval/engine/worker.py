"""One worker process: jobs go in through one pipe, results come out of another as lines of JSON.

What a worker says is text and never an object of Python's: one that a hostile file has taken over
can say something wrong, but run nothing here. Parent and worker share no lock, so none is left
behind in shared memory by a group that is killed, and no process waits for one that a dead
process holds.

The end of this file runs inside it.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import monotonic, perf_counter, sleep
from typing import TYPE_CHECKING, NoReturn

from pydantic import TypeAdapter, ValidationError

from nw_base.clean import clean
from nw_base.confinement import Rules, confine, kill_group
from nw_base.plural import in_words
from nw_eval.engine.machine import Resident, kill, left_by
from nw_policies.line import use_line
from nw_sim.rollout.confined.progress import HANGS_AFTER, Progress, descendants
from nw_sim.rollout.confined.start import parts_of, start_pair
from nw_sim.rollout.job import StageClock, TrialJob, TrialResult

if TYPE_CHECKING:
    from nw_base.words import Kernels
    from nw_scenes import Scene
    from nw_sim.rollout.library import Library

# What a worker says as soon as it has a job: from here on its end is the job's.
_TAKEN = b"taken"
# What it says when a job goes on only once its scene's splat is there.
_AWAITS = b"awaits splat"
# What it says while its job gets on, and the seconds between.
_STEPS, _BETWEEN_STEPS = b"steps", 1.0
# The share of its time limit that a step's processor time may have, if that is more.
_STEP = 1 / 24
# Seconds between two looks of its for the splat.
_LOOK = 0.02
# Bytes of a result that anybody reads; honest ones have about two thousand.
_LONGEST = 1 << 20
# Seconds of processor time in which a new process must have taken its job: it imports next to
# nothing before.
_START_LIMIT = 120.0
# Seconds in which a process that has closed its pipe, or was killed, must be gone.
_LAST_MOMENTS = 5.0
# Exit code of a worker that cannot even say what went wrong.
_SPEECHLESS = 70
_library: Library | None = None
_results: Connection | None = None
"""Of a worker: where it says what its jobs come to."""
_awaits_splats = False


class UnstartedError(Exception):
    """A worker ended before it took its job, which is not to blame."""


class WorkerProcess:
    """A process that runs one job after the other.

    Args:
        start: called once in the process, with `output`; it confines it.
        run: called there with each job.
        rules: by which it will be confined.
        policy: by which the process is that opens its policies; None = it does.
        output: what it prints to; remains the caller's.
        memory_limit: bytes that it may hold with its children while it runs one.

    Raises:
        OSError: no process can be started.
    """

    def __init__(
        self,
        *,
        start: Callable[[Connection], None],
        run: Callable[[TrialJob], TrialResult],
        rules: Rules,
        policy: Rules | None,
        output: Connection,
        memory_limit: int | None = None,
    ) -> None:
        theirs, self._jobs = Pipe(duplex=False)
        self._results, back = Pipe(duplex=False)
        try:
            self._process = start_pair(
                _serve,
                (start, run),
                (theirs, back, output),
                rules=rules,
                policy=policy,
                is_one_of_many=True,
                output=output,
            )
        except BaseException:
            self._jobs.close()
            self._results.close()
            raise
        finally:
            theirs.close()
            back.close()
        pids = [part.pid for part in parts_of(self._process)]
        self._pids = tuple(pid for pid in pids if pid is not None)
        self._memory_limit = memory_limit
        self._memory = Resident(*self._pids)
        # A policy may wait for its server, for which its card has a limit.
        self._progress = Progress(*self._pids, waits=(policy or rules).network != "none")
        self._has_begun = False  # Whether its job has come to a step: scenes are loaded before.
        self.job: TrialJob | None = None
        self.jobs_done = 0
        self.scenes: set[str] = set()  # Those of its jobs, which it keeps loaded.
        self.awaits_splat = False  # Whether its job stands still until there is one.
        self._is_taken = False
        self._deadline = 0.0
        self._heard = b""

    @property
    def handles(self) -> tuple[Connection | int, ...]:
        """What to wait for: one of them is ready when there is something to look at."""
        return self._results, *(part.sentinel for part in parts_of(self._process))

    def give(self, job: TrialJob) -> None:
        """Hand over a job to a process that has none."""
        self.job = job
        self.scenes.add(job.trial.scene)
        self.awaits_splat = self._is_taken = self._has_begun = False
        self._progress.steps()
        with suppress(OSError):  # It has died; `look` says so.
            self._jobs.send(job)

    def look(self, missing: Collection[str] = ()) -> TrialResult | None:
        """Return the result of the job if it has one by now, whichever way it ended.

        Args:
            missing: scenes, by name, that have no splat yet: time for which a job waits for one of
                them does not count.

        Raises:
            UnstartedError: the process ended, or hangs, before it took the job.
        """
        assert self.job is not None, "give it a job first"
        # Asked before the pipe is read: whatever a dead process wrote is in there.
        code = self._process.exitcode
        is_open = self._read()
        if not self._is_taken and _TAKEN + b"\n" in self._heard:
            self._is_taken = True
            self._deadline = monotonic() + self.job.time_limit
            self._progress.steps()
            self._memory.restrain(self._memory_limit)
        if self._is_taken and _STEPS + b"\n" in self._heard:
            self._heard = self._heard.replace(_STEPS + b"\n", b"")
            self._has_begun = True
            self._progress.steps()
        if self._is_taken and _AWAITS + b"\n" in self._heard:
            self._heard = self._heard.replace(_AWAITS + b"\n", b"")
            self.awaits_splat = True
        if self.awaits_splat:
            self.awaits_splat = self.job.trial.scene in missing
            self._deadline = monotonic() + self.job.time_limit
            self._progress.steps()
        *lines, _ = self._heard.split(b"\n")
        if len(lines) > 1:
            self._heard = b""
            self.jobs_done += 1
            return _decoded(lines[1])
        if code is None and not is_open:
            self._process.join(_LAST_MOMENTS)
            code = self._process.exitcode
        lives = code is None and is_open
        why = self._hangs(self.job.time_limit) if lives else ""
        if lives and not why:
            return self._overgrown()
        if not self._is_taken:
            raise UnstartedError
        if lives:
            return TrialResult(status="error", error_type="hung", error_text=why)
        return _dead(code)

    def _hangs(self, time_limit: float) -> str:
        """Return why the process is taken for one that never ends; empty = it gets on."""
        progress = self._progress
        why = progress.look()
        if not self._is_taken:
            return why or ("no start" if progress.busy() >= _START_LIMIT else "")
        # To load a large scene may take long. A policy is only asked to open, or for an action.
        limit = max(HANGS_AFTER, _STEP * time_limit)
        if progress.busy(0 if self._has_begun else 1) >= limit:
            return (
                f"no control step in {limit:.0f} s of processor time; check the policy for a loop "
                "without an end, or raise --time-limit"
            )
        if monotonic() > self._deadline:
            return (
                f"no result within {time_limit:g} s; raise --time-limit if the machine "
                "is slow, or check the policy"
            )
        return why

    def _overgrown(self) -> TrialResult | None:
        """Return what the job comes to if the process, which runs it, holds too much memory."""
        if self._memory_limit is None or not self._is_taken:
            return None
        held = self._memory.beyond(self._memory_limit)
        return None if held is None else _too_large(held, self._memory_limit)

    def kill(self) -> None:
        """End the process and all that it started, without waiting; to be called once."""
        for part, pid in zip(parts_of(self._process), self._pids, strict=True):
            has_ended = part.exitcode is not None
            others = left_by(pid) if has_ended else descendants(pid)
            if not has_ended:  # Else its number may be another's by now.
                kill_group(pid)
                part.kill()
            kill(others)

    def close(self) -> None:
        """Wait for a killed process, and close its pipes."""
        self._process.join(_LAST_MOMENTS)
        if self._process.exitcode is not None:
            self._process.close()
        self._jobs.close()
        self._results.close()

    def _read(self) -> bool:
        """Take in what the worker has said; return whether it can say more."""
        with suppress(OSError):
            while self._results.poll():
                # Not `recv`, which would wait for the rest of what a stopped process began.
                piece = os.read(self._results.fileno(), 1 << 16)
                self._heard += piece
                if not piece or len(self._heard) > _LONGEST:
                    return False
            return True
        return False


@cache
def _form() -> TypeAdapter[TrialResult]:
    """Return the reader of results: making it takes longer than reading hundreds."""
    return TypeAdapter(TrialResult)


def _decoded(line: bytes) -> TrialResult:
    try:
        return _form().validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the line"
        return _crashed(f"the worker's answer cannot be read: {place}: {first['msg']}")


def _too_large(held: int, limit: int) -> TrialResult:
    return _crashed(
        f"the worker and its children held {in_words(held)}, --memory-limit is {in_words(limit)}"
    )


def _dead(code: int | None) -> TrialResult:
    if code is None:
        return _crashed("the worker process closed its pipe, or said more than a result holds")
    if code >= 0:
        return _crashed(f"the worker process ended with exit code {code}", end_reason="exit")
    try:
        name = signal.Signals(-code).name
    except ValueError:  # A real-time signal has a number only.
        name = f"signal {-code}"
    hint = "; the machine may be out of memory" if -code == signal.SIGKILL else ""
    return _crashed(f"the worker process was killed by {name}{hint}")


def _crashed(text: str, *, end_reason: str = "") -> TrialResult:
    return TrialResult(
        status="error", error_type="crashed", error_text=clean(text), end_reason=end_reason
    )


def _serve(
    start: Callable[[Connection], None],
    run: Callable[[TrialJob], TrialResult],
    jobs: Connection,
    results: Connection,
    output: Connection,
    *line: Connection,
) -> NoReturn:
    """Run jobs until the pipe ends: the main function of the process."""
    global _results
    own, _results = os.getpid(), results
    try:
        start(output)
        use_line(*line)
        while True:
            job: TrialJob = jobs.recv()
            _say(results, _TAKEN)
            answer = _answer(run, job)
            if os.getpid() != own:
                break  # A copy that a policy made with os.fork must not answer.
            _say(results, answer)
    except EOFError:
        os._exit(0)
    finally:
        # Nothing is left to tidy up, and no reader for a traceback.
        os._exit(_SPEECHLESS)


def _answer(run: Callable[[TrialJob], TrialResult], job: TrialJob) -> bytes:
    try:
        return json.dumps(asdict(run(job))).encode()
    except BaseException as error:  # noqa: BLE001 - whatever it is, it costs this trial only.
        reason = "exit" if isinstance(error, SystemExit) else ""
        result = _crashed(f"{type(error).__name__}: {error}", end_reason=reason)
        return json.dumps(asdict(result)).encode()


def _say(results: Connection, line: bytes) -> None:
    rest = memoryview(line + b"\n")
    while rest:
        rest = rest[os.write(results.fileno(), rest) :]


@dataclass(frozen=True, kw_only=True)
class WorkerStart:
    """What a worker starts with, before it has a job."""

    rules: Rules
    """What it may do."""
    renders: tuple[Kernels, ...]
    """With what it draws splats: it loads kernels before their cache is out of its reach."""
    policy: Rules | None = None
    """What the process may do that opens its policies; None = it opens them."""
    awaits_splats: bool = False
    """Whether splats are built when somebody asks for them."""


def start(settings: WorkerStart, output: Connection) -> None:
    """Prepare and confine a worker; what it prints goes to `output`.

    It must not outlive the process that started it, however that died. And SIGTERM must end it at
    once: a handler in Python waits for a policy that hangs in native code, and there is nothing to
    tidy up. Ctrl-C is the parent's business.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if kernels := (*settings.renders, *settings.rules.kernels):
        with suppress(Exception):  # The trial that wants them says what is wrong.
            from nw_sim.warmup import warmup

            warmup(kernels=kernels)
    global _awaits_splats  # noqa: PLW0603 - as a process is started, so it stays.
    _awaits_splats = settings.awaits_splats
    confine(settings.rules, output=output.fileno())
    output.close()


def run_job(job: TrialJob) -> TrialResult:
    """Run one trial with this process's cache of scenes and policies."""
    # Here and not above: a worker that is only being started needs none of it.
    from nw_sim.rollout.library import Library
    from nw_sim.rollout.trial import run_trial

    global _library  # noqa: PLW0603 - one cache a process is the point.
    if _library is None:
        _library = Library(before_drawing=_await_splat if _awaits_splats else None)
    return run_trial(job, library=_library, clock=clock())


def clock() -> StageClock:
    """Return a trial's clock by which a worker says that the trial gets on."""
    if (results := _results) is None:
        return StageClock()
    due = 0.0

    def now() -> float:
        nonlocal due
        moment = perf_counter()
        if moment >= due:
            if due > 0.0:  # It is asked when the setup begins, next when that has ended.
                _say(results, _STEPS)
            due = moment + _BETWEEN_STEPS if due > 0.0 else moment
        return moment

    return StageClock(now)


def _await_splat(scene: Scene) -> None:
    """Return once a scene's splat is in the cache, which this process may only read."""
    from nw_places.entry import BuiltInSplat

    splat = scene.splat
    if not isinstance(splat, BuiltInSplat) or splat.path.is_file():
        return
    assert _results is not None, "a worker has a pipe for results"
    _say(_results, _AWAITS)
    while not splat.path.is_file():
        sleep(_LOOK)
