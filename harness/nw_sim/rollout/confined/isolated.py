"""Calls a function in a confined process: for whatever opens an untrusted checkpoint.

What comes back is JSON, never an object of Python's, so a process that a hostile file has taken
over can say something wrong, but run nothing here.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Collection, Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any, Self

from nw_base.confinement import Rules, confine, kill_group
from nw_base.errors import (
    CrashError,
    IncomparableError,
    NwEvalError,
    PolicyError,
    PrerequisiteError,
    RobotError,
    SceneError,
    StoreError,
    TrialError,
    UsageError,
    not_installed,
)
from nw_base.words import Kernels
from nw_policies.line import use_line
from nw_sim.rollout.confined.progress import Progress
from nw_sim.rollout.confined.start import (
    Started,
    WorldAndPolicy,
    parts_of,
    prepare_call,
    start_pair,
)

TIME_LIMIT = 120.0
"""Seconds; imports take a few of them, a slow disk a few more."""

_LAST_MOMENTS = 5.0
"""Seconds in which a process that has closed its pipe, or was killed, must be gone."""
_LOOK = 1.0
"""Seconds between two looks at whether it gets on."""
_ANSWER = 2**26
"""Bytes of an answer: a report, or a picture."""
_LINES = 100
_LIBRARIES_ONLY = Rules()

_KINDS: dict[str, type[NwEvalError]] = {
    kind.__name__: kind
    for kind in (
        NwEvalError,
        UsageError,
        RobotError,
        SceneError,
        PolicyError,
        PrerequisiteError,
        TrialError,
        StoreError,
        IncomparableError,
    )
}


def call_isolated(
    function: Callable[..., Any],
    /,
    *,
    subject: str,
    rules: Rules = _LIBRARIES_ONLY,
    time_limit: float = TIME_LIMIT,
    renders: Collection[Kernels] = (),
    policy_process: Rules | None = None,
    **arguments: Any,
) -> Any:
    """Call a function in a fresh, confined process and return what it returns.

    Args:
        function: a module's own function, which returns what JSON can hold.
        subject: what is being looked at, for errors.
        rules: what the process may do.
        time_limit: wall seconds.
        renders: the kernels with which it draws splats, which it loads before it is confined.
        policy_process: what the process may do that opens policies; None = there is none, and
            the function's own opens them.
        **arguments: plain values.

    Raises:
        NwEvalError: what the function raised, of the same class.
        CrashError: the process died.
        PolicyError: it took more than it may, or did not come back in time.
    """
    with IsolatedCall(
        function,
        subject=subject,
        rules=rules,
        renders=renders,
        policy=policy_process,
        arguments=arguments,
    ) as call:
        return call.answer(time_limit)


class IsolatedCall:
    """A call that a fresh, confined process is at; a context manager that ends it.

    Args:
        function: as for `call_isolated`, and so are `subject`, `rules` and `renders`.
        subject: see there.
        rules: see there.
        renders: see there.
        policy: `policy_process` there.
        arguments: of the function, plain values.
        is_one_of_many: whether more such calls will follow.

    Attributes:
        receiver: what to wait for: it is ready when there is an answer, or never will be one.
        progress: how its processes get on.

    Raises:
        OSError: no process can be started.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        /,
        *,
        subject: str,
        rules: Rules,
        renders: Collection[Kernels],
        arguments: Mapping[str, Any],
        policy: Rules | None = None,
        is_one_of_many: bool = False,
    ) -> None:
        self.receiver, sender = Pipe(duplex=False)
        self._subject = subject
        prepare_call(function)
        try:
            with sender:
                self._process = start_pair(
                    _answer,
                    (rules, renders, function, dict(arguments)),
                    (sender,),
                    rules=rules,
                    policy=policy,
                    is_one_of_many=is_one_of_many,
                )
        except BaseException:
            self.receiver.close()
            raise
        pids = [part.pid for part in parts_of(self._process)]
        self.progress = Progress(
            *(pid for pid in pids if pid is not None), waits=(policy or rules).network != "none"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def answer(self, time_limit: float) -> Any:
        """Wait for what the function returns, at most `time_limit` s; to be called once.

        Raises:
            NwEvalError, PolicyError: as `call_isolated`.
        """
        deadline = monotonic() + time_limit
        while not self.receiver.poll(min(_LOOK, max(0.0, deadline - monotonic()))):
            why = self.progress.look()
            if not why and monotonic() >= deadline:
                why = f"no answer from the checkpoint within {time_limit:g} s"
            if why:
                raise PolicyError(
                    f"{self._subject}: {why}",
                    fix="run it on its own: it may wait for something, or be too large",
                )
        answer = _received(self.receiver, self._process, self._subject)
        if "error" in answer:
            kind = _KINDS.get(str(answer.get("kind")))
            lines = str(answer["error"]).splitlines()[:_LINES] or [""]
            # What was not raised on purpose does not say what it is about.
            raise PolicyError(f"{self._subject}: {lines[0]}") if kind is None else kind(lines)
        return answer["value"]

    def close(self) -> None:
        """End the process and all that it started; to be called once."""
        self.receiver.close()
        _end(self._process)
        self._process.join(_LAST_MOMENTS)
        if self._process.exitcode is not None:
            self._process.close()


def _received(
    receiver: Connection, process: Started | WorldAndPolicy, subject: str
) -> dict[str, Any]:
    """Return what a process says.

    Raises:
        PolicyError: it ends without a word, or says nothing that can be read.
    """
    try:
        answer = json.loads(receiver.recv_bytes(_ANSWER))
    except EOFError:
        process.join(_LAST_MOMENTS)
        code = process.exitcode
        _end(process)  # It may be stopped.
        if code is not None or not isinstance(process, WorldAndPolicy):
            raise _died(subject, process.exitcode) from None
        answer = None  # The policy's process has closed its line, or said what is no message.
    except (OSError, ValueError, RecursionError):
        answer = None
    if not isinstance(answer, dict) or not ({"value", "error"} & answer.keys()):
        raise PolicyError(
            f"{subject}: the process that opened the checkpoint gave no answer that can be read",
            fix="do not use this checkpoint",
        )
    return answer


def _end(process: Started | WorldAndPolicy) -> None:
    """Kill a process and what it started, if it has not ended; also that of its policy."""
    for each in parts_of(process):
        if each.exitcode is None:
            kill_group(each.pid)
            each.kill()


def _died(subject: str, code: int | None) -> PolicyError:
    if code == -signal.SIGXCPU:
        return PolicyError(
            f"{subject}: opening the checkpoint takes too long: more processor time than it may",
            fix="run it on its own: it may never end, or be too large",
        )
    return CrashError(
        f"{subject}: the process that opened the checkpoint died ({_ending(code)})",
        fix="load the checkpoint on its own with an observation of the card's shapes",
    )


def _ending(code: int | None) -> str:
    """Return an exit code in words."""
    try:
        return f"{signal.Signals(-(code or 0)).name}, exit code {code}"
    except ValueError:
        return f"exit code {code}"


def _answer(
    rules: Rules,
    renders: Collection[Kernels],
    function: Callable[..., Any],
    arguments: Mapping[str, Any],
    sender: Connection,
    *line: Connection,
) -> None:
    try:
        if kernels := (*renders, *rules.kernels):
            from nw_sim.warmup import warmup

            warmup(kernels=kernels)
        confine(rules)
        use_line(*line)
        answer = {"value": function(**arguments)}
    except NwEvalError as error:
        answer = {"error": str(error), "kind": type(error).__name__}
    except MemoryError:
        held = "" if rules.memory is None else f" than {rules.memory / 2**30:.1f} GiB"
        answer = {
            "error": f"opening the checkpoint takes more memory{held}; export the actor alone"
        }
    except Exception as error:  # noqa: BLE001 - it is told, and the process ends.
        if absent := not_installed(error):
            answer = {"error": str(absent), "kind": type(absent).__name__}
        else:
            answer = {"error": f"{type(error).__name__}: {error}"}
    sender.send_bytes(json.dumps(answer).encode())
    sender.close()
