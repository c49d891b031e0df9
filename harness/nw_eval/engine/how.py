"""How a run is carried out: none of it decides a result."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self, get_args

from nw_base.errors import UsageError, nearest
from nw_base.words import Engine
from nw_eval.engine.listener import Listener, NullListener

if TYPE_CHECKING:
    from nw_gate.results.request import Request


@dataclass(frozen=True, kw_only=True)
class How:
    """How trials are run. No row depends on it.

    Raises:
        UsageError: a value is invalid, or two exclude each other.
    """

    workers: int | None = None
    """Worker processes; the number of cores when None."""
    cache: bool = True
    """Whether results that earlier runs have of the same trials are taken over, all but a few,
    which run again and are compared. Trials in the calling process always run."""
    listener: Listener | None = None
    """Hears of progress."""
    in_process: bool = False
    """Whether trials run in the calling process, one after another, for a debugger or a notebook:
    nothing confines the policy, and nothing ends it if it hangs."""
    all_rounds: bool = False
    """Whether the run goes on when its verdict is settled, also where the policy is the baseline
    itself and the other results would be taken from the baseline."""
    engine: Engine = "local"
    """Where trials run; a run that is resumed may use another than it began with."""
    address: str | None = None
    """Of the Ray cluster; one of this machine is started when None."""
    labels: Mapping[str, str] | None = None
    """What its user calls the run, such as `{"training_run": "may-3", "step": "1500"}`, beside what
    CI's variables say of the job (docs/reference/run-folder.md)."""

    def __post_init__(self) -> None:
        check_workers(self.workers)
        if self.engine not in get_args(Engine):
            raise UsageError(
                f"--engine {self.engine!r} is unknown",
                fix=nearest(str(self.engine), get_args(Engine)),
            )
        if self.address is not None and self.engine != "ray":
            raise UsageError(f"--address {self.address} has no effect here", fix="add --engine ray")

    @classmethod
    def taken_from(cls, changes: dict[str, Any], *names: str) -> Self:
        """Take what says how out of a function's keywords.

        Args:
            changes: the keywords; these fields are removed from them.
            names: fields that the function has; all if none is named.
        """
        known = names or tuple(field.name for field in fields(cls))
        return cls(**{name: changes.pop(name) for name in known if name in changes})

    @classmethod
    def of(cls, changes: Mapping[str, Any], *names: str) -> Self:
        """Return what a function's keywords say, of fields that it has.

        Raises:
            TypeError: one is no such field.
        """
        if unknown := sorted(changes.keys() - set(names)):
            raise TypeError(f"unexpected keyword argument {unknown[0]!r}: {', '.join(names)}")
        return cls(**changes)

    @property
    def cluster(self) -> str | None:
        """The address of the Ray cluster that trials run on; None = none."""
        return (self.address or "local") if self.engine == "ray" else None

    @property
    def told(self) -> Listener:
        """Receives progress events, if only to ignore them."""
        return self.listener or NullListener()

    @property
    def command(self) -> tuple[str, ...]:
        """What was typed."""
        return tuple(sys.argv)

    @property
    def uncached(self) -> str:
        """Why the cache of trials is not used; empty if it is."""
        if self.in_process:
            return "in the calling process"  # For a debugger, which wants to see it run.
        return "" if self.cache else "--no-cache"

    def check_in_process(self, request: Request) -> None:
        """Refuse what the calling process cannot do, if trials are to run there.

        Raises:
            UsageError: more workers than one, a cluster, or a limit that cannot be enforced.
        """
        if not self.in_process:
            return
        if self.cluster is not None:
            raise UsageError(
                "--in-process with --engine ray: trials run here or there", fix="drop one of them"
            )
        if self.workers not in {None, 1}:
            raise UsageError(
                f"--workers {self.workers} with --in-process: it runs one trial after another",
                fix="drop one of them",
            )
        check_limits(request, "--in-process")


def check_workers(workers: int | None) -> None:
    """Refuse an invalid number of workers.

    Raises:
        UsageError: it is less than 1.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers} is too low", fix="give at least 1")


def check_limits(request: Request, door: str) -> None:
    """Refuse limits to trials that run in the calling process.

    Args:
        request: the options given.
        door: why they do, in words.

    Raises:
        UsageError: there is a limit that cannot be enforced.
    """
    time, memory = request.time_limit, request.memory_limit
    limits = [] if time is None else [f"--time-limit {time:g}"]
    limits += [] if memory is None else [f"--memory-limit {memory}"]
    if limits:
        raise UsageError(
            f"{' and '.join(limits)} cannot be enforced with {door}", fix="drop one of them"
        )
