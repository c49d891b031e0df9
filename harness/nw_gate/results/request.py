"""What is asked of a run: one value, from the door that takes it to the run.json that keeps it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from nw_base.errors import UsageError
from nw_base.plural import bytes_of
from nw_base.words import Backend, Collision, PanelKind, Record

_T = TypeVar("_T")
_SHARD = re.compile(r"([0-9]{1,6})/([0-9]{1,6})")


@dataclass(frozen=True, kw_only=True)
class Shard:
    """One of several equal parts of a run, each of which is run by a command of its own."""

    index: int
    """Which, from 1."""
    count: int
    """How many there are."""

    @classmethod
    def of(cls, text: str) -> Shard:
        """Return the shard that `1/3` names.

        Raises:
            UsageError: the words name none.
        """
        match = _SHARD.fullmatch(text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise UsageError(
                f"--shard {text!r} is not a part", fix="give I/N, such as 1/3, with I from 1 to N"
            )
        return cls(index=int(match[1]), count=int(match[2]))

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    def share(self, ordered: Sequence[_T]) -> tuple[_T, ...]:
        """Return every N-th thing, from the I-th: of any stretch of them all parts have as many.

        Or one more or less; each thing is in one part, whatever comes behind it.
        """
        return tuple(ordered[self.index - 1 :: self.count])


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is asked of a run. None is not asked for: the suite, or a default, decides."""

    # These docstrings are the help of the command line, too.
    suite: str | Path | None = None
    """A suite file or a shipped suite's name (`nw-eval suites` lists them). Optional with
    --resume."""
    robot: str | None = None
    """A robot's name, such as go1, its folder, hub:org/name[@revision] or menagerie:NAME (default:
    the suite's robot)."""
    policy: str | None = None
    """A shipped policy's name, a policy folder, a card, or hub:org/name[@revision] (default: the
    suite's policy)."""
    checkpoint: Path | None = None
    """Use these weights instead of the card's."""
    trials: int | None = None
    """Trials per scene, a maximum when comparing with a baseline (default: the suite's number)."""
    scenes: tuple[str, ...] | None = None
    """Only scenes that match one of these globs; `split:train` and `split:eval` work, too."""
    seed: int | None = None
    """Use a different seed: new initial states in the same scenes (default: the suite's)."""
    baseline: str | None = None
    """The baseline to compare with: a name, a file, or none (default: the suite's baseline if the
    policy is the suite's, else none)."""
    baseline_policy: str | None = None
    """The baseline's policy, needed on a machine type that the baseline has no results for
    (default: the path in the baseline)."""
    recheck: int | None = None
    """Initial states to re-run per scene when the policy is the baseline's own; the baseline
    supplies the other results (default: 1)."""
    panel: PanelKind | None = None
    """pinned uses the suite's seed. fresh derives a seed from the checkpoint's digest, to confirm a
    release (default: pinned)."""
    record: Record | None = None
    """Trials whose MCAP logs contain camera images (default: the suite's choice)."""
    time_limit: float | None = None
    """Wall time, in seconds, after which a trial counts as hung (default: 90, and 20 per
    simulated second)."""
    memory_limit: str | None = None
    """Memory of a worker and its child processes, such as 2GB or 1.5GiB. A trial that uses more
    ends as crashed (default: no limit)."""
    render: Backend | None = None
    """The splat renderer; it never falls back to another one (default: cpu)."""
    collision: Collision | None = None
    """How scan meshes collide: terrain compiles them and is fast; triangles is exact and slow
    (default: the suite's choice, else terrain)."""
    allow_code: bool = False
    """Allow Python code of the policy's card (confined), of sensors and of the suite's scores."""
    shard: str | None = None
    """I/N runs only shard I of N. `nw-eval merge` merges the shards and judges them."""

    @classmethod
    def of(cls, request: Request | str | Path | None, **changes: Any) -> Request:
        """Return a request, or one for a suite, with some fields changed.

        Args:
            request: the request, or its suite.
            changes: values of fields by name; a list does for a tuple, a text for a path.

        Raises:
            UsageError: a value is invalid for its field.
            TypeError: there is no such field.
        """
        from pydantic import TypeAdapter, ValidationError

        request = request if isinstance(request, Request) else cls(suite=request)
        values = vars(replace(request, **changes))
        try:
            checked = TypeAdapter(Request).validate_python(values)
        except ValidationError as error:
            first = error.errors()[0]
            raise _unusable(str(first["loc"][0]), values, first["msg"].lower()) from None
        if checked.panel == "fresh" and checked.seed is not None:
            raise UsageError(
                f"--seed {checked.seed} with --seed-set fresh, which derives the seed from the "
                "checkpoint",
                fix="drop one of them",
            )
        if checked.time_limit is not None and not checked.time_limit > 0.0:
            raise _unusable("time_limit", values, "give seconds, more than 0")
        if checked.recheck is not None and checked.recheck < 1:
            raise _unusable("recheck", values, "give at least 1")
        _ = checked.part  # It raises.
        _ = checked.memory_bytes  # As above.
        return checked

    @property
    def part(self) -> Shard | None:
        """The part that `shard` names; None: all of it.

        Raises:
            UsageError: it names none.
        """
        return None if self.shard is None else Shard.of(self.shard)

    @property
    def memory_bytes(self) -> int | None:
        """The memory limit in bytes.

        Raises:
            UsageError: it is no amount.
        """
        try:
            return None if self.memory_limit is None else bytes_of(self.memory_limit)
        except ValueError as error:
            raise _unusable("memory_limit", vars(self), str(error)) from None

    def over(self, earlier: Request) -> Request:
        """Return an earlier request with all that this one asks for in its place.

        Whether code is allowed is always this one's word: no file can give it.
        """
        return replace(
            earlier, **{k: value for k, value in vars(self).items() if value is not None}
        )

    def from_anywhere(self) -> Request:
        """Return the request with a checkpoint's path that means the same in every folder."""
        absolute = None if self.checkpoint is None else self.checkpoint.resolve()
        return replace(self, checkpoint=absolute)


def _unusable(name: str, values: Mapping[str, Any], why: str) -> UsageError:
    return UsageError(f"--{name.replace('_', '-')} {values[name]!r}: {why}")
