"""Blame in confined processes, several at a time: logs and checkpoints may be strangers'."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from multiprocessing.connection import wait
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from nw_eval.errors import NwEvalError, PolicyError
from nw_eval.rollout.confined.isolated import IsolatedCall
from nw_eval.rollout.library import Library
from nw_eval.rollout.replaying.blame.blame import blame
from nw_eval.rollout.replaying.blame.report import BlameReport
from nw_eval.rollout.replaying.readied import TIME_LIMIT, readied
from nw_eval.rollout.replaying.takeover.takeover import second_job

Blamed = BlameReport | NwEvalError
"""What came of one log: an error costs no other one."""


class _Running(NamedTuple):
    place: int
    call: IsolatedCall
    deadline: float


def blame_apart(
    logs: Sequence[Path],
    *,
    policy: str | None,
    checkpoint: Path | None,
    allow_code: bool,
    workers: int,
) -> Iterator[tuple[int, Blamed]]:
    """Yield what `blame` says of logs, each in a process of its own, as they end.

    Args:
        logs: of trials.
        policy: as for `take_over`; likewise `checkpoint` and `allow_code`.
        checkpoint: see above.
        allow_code: see above.
        workers: how many processes at a time.

    Yields:
        The log's place in `logs`, and what came of it.
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
                    ready = readied(job, log, library, draws=False)
                except NwEvalError as error:
                    yield place, error
                    continue
                arguments = {
                    "log": str(log.resolve()),
                    "policy": policy,
                    "checkpoint": None if checkpoint is None else str(checkpoint),
                    "allow_code": allow_code,
                }
                call = IsolatedCall(
                    _blame,
                    subject=str(log),
                    rules=ready.rules,
                    renders=ready.renders,
                    policy=ready.policy,
                    arguments=arguments,
                    is_one_of_many=True,
                )
                running.append(_Running(place, call, monotonic() + TIME_LIMIT))
            if not running:
                continue
            nearest = min(each.deadline for each in running) - monotonic()
            answered = wait([each.call.receiver for each in running], max(0.0, nearest))
            for each in tuple(running):
                if each.call.receiver in answered or each.deadline <= monotonic():
                    running.remove(each)
                    with each.call:
                        yield each.place, _answer(each.call, logs[each.place])
    finally:
        for each in running:
            each.call.close()


def _answer(call: IsolatedCall, log: Path) -> Blamed:
    try:
        return TypeAdapter(BlameReport).validate_python(call.answer(0.0))
    except ValidationError:
        return PolicyError(f"{log}: blame gave no answer that can be read")
    except NwEvalError as error:
        return error


def _blame(
    *, log: str, policy: str | None, checkpoint: str | None, allow_code: bool
) -> dict[str, Any]:
    return asdict(
        blame(
            Path(log),
            policy=policy,
            checkpoint=None if checkpoint is None else Path(checkpoint),
            allow_code=allow_code,
        )
    )
