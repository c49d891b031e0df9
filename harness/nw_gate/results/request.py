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
    def of(cls, words: str) -> Shard:
        """Return the shard that `1/3` names.

        Raises:
            UsageError: the words name none.
        """
        found = _SHARD.fullmatch(words)
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise UsageError(
                f"--shard {words!r} is not a part", fix="give I/N, such as 1/3, with I from 1 to N"
            )
        return cls(index=int(found[1]), count=int(found[2]))

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
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them).
    Only --resume can do without."""
    robot: str | None = None
    """go1, go2, the name of another robot, the path of its folder, hub:org/name[@revision] or
    menagerie:NAME; the suite's own when absent."""
    policy: str | None = None
    """A shipped bundle's name, a bundle's folder, a card, or hub:org/name[@revision]; the suite's
    own when absent."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    trials: int | None = None
    """Trials per scene, against a baseline at most; the suite's own number when absent."""
    scenes: tuple[str, ...] | None = None
    """Only scenes that match one of these globs, or are of `split:train` or `split:eval`."""
    seed: int | None = None
    """Another seed set than the suite's own: other trials in the same scenes."""
    baseline: str | None = None
    """The baseline to compare with: its name, its file, or none. When absent the suite's own
    where the policy is the suite's own, else none: the bar alone judges."""
    baseline_policy: str | None = None
    """The baseline's own policy, for a machine that it has not seen; where the baseline says when
    absent."""
    recheck: int | None = None
    """Starts of each scene that run again, drawn when the run begins, where the policy is the
    baseline's own and the rest is reused from the baseline; 1 when absent."""
    panel: PanelKind | None = None
    """The seed set of the suite's seed (pinned), or one of the checkpoint's own (fresh), by its
    digest, for a release. pinned when absent."""
    record: Record | None = None
    """Camera images in MCAP for which trials; the suite's own choice when absent."""
    time_limit: float | None = None
    """Seconds of wall time after which a trial counts as hung; a generous default when absent."""
    memory_limit: str | None = None
    """Memory that a worker may hold with the processes that it started, such as 2GB or 1.5GiB: a
    trial that takes more ends as crashed. No limit of its own when absent."""
    render: Backend | None = None
    """The splat renderer; cpu when absent. There is no silent fallback."""
    collision: Collision | None = None
    """How scan meshes collide: compiled to terrain, or slow and exact by their own triangles.
    The suite's own choice when absent, which is terrain where it makes none."""
    allow_code: bool = False
    """Let Python code run: that of the policy's card behind the fence, a sensor's and a suite's
    scores beside the world."""
    shard: str | None = None
    """I/N: only part I of N of the trials, which `nw-eval merge` puts together and judges."""

    @classmethod
    def of(cls, request: Request | str | Path | None, **changes: Any) -> Request:
        """Return a request, or one for a suite, with some fields changed.

        Args:
            request: the request, or its suite.
            changes: values of fields by name; a list does for a tuple, a text for a path.

        Raises:
            UsageError: a value is of no use for its field.
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
