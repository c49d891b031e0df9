"""The exceptions of nw-eval: one class for each decision that a caller makes.

    NwEvalError
    ├─ UsageError          exit 2   an option or argument that cannot be used
    │  └─ RobotError       exit 2   a robot's folder or package that cannot be used
    ├─ SuiteError          exit 2   problems in a suite file, all of them, each with its place
    ├─ SceneError          exit 2   a scene that cannot be loaded or built
    ├─ PolicyError         exit 2   a card or checkpoint that cannot be used, found before physics
    │  ├─ CodeError        exit 2   Python code that a card names failed
    │  └─ CrashError       exit 4   the process that opened a checkpoint died
    ├─ PluginError         exit 2   a package's plug-in that cannot be imported, or is invalid
    ├─ PrerequisiteError   exit 2   an extra, a driver or a backend that is not installed
    ├─ TrialError          exit 4   a trial that could not be run to a result
    │  ├─ ActionError      exit 4   an invalid action: the policy's own failure
    │  │  └─ NotFiniteError  exit 4   with a NaN or inf in it
    │  ├─ DivergedError    exit 4   physics that left all bounds
    │  └─ ServerError      exit 4   a policy's server that cannot be asked: no failure of it
    ├─ StoreError          exit 4   results that cannot be written, or that are damaged
    ├─ FetchError          exit 4   a hub that cannot be reached, or fails
    └─ IncomparableError   exit 5   runs that do not pair

A message says what happened, the value, the location and the fix, in that order, on one line. Names
and texts of untrusted files are made harmless here, once, whoever prints the error.
"""

from __future__ import annotations

import signal
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

from nw_base.clean import clean

_LONGEST = 2000  # characters of what happened; the fix comes on top, whole
_LISTED = 12  # names in a hint; a longer list hides the message


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One fault of one file: where it is, what it is, and how to mend it."""

    file: str
    line: int
    column: int
    message: str
    fix: str | None = None

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}:{self.column}"
        return _with_fix(clean(f"{where}: {self.message}", at_most=_LONGEST), self.fix)


def _with_fix(message: str, fix: str | None) -> str:
    return message if fix is None else f"{message}; {clean(fix)}"


class NwEvalError(Exception):
    """Root of every error that nw-eval raises on purpose.

    Args:
        message: what happened; or all faults of something, each of which gets its own line.
        fix: what to do about it.
    """

    exit_code = 4

    def __init__(self, message: str | Iterable[Problem | str], *, fix: str | None = None) -> None:
        lines = (message,) if isinstance(message, str) else tuple(message)
        # A pickled error is made again of these, on its way between processes.
        super().__init__(lines)
        self.fix = fix
        self.problems = tuple(line for line in lines if isinstance(line, Problem))

    @property
    def message(self) -> str:
        """The message without the fix."""
        return "\n".join(
            str(line) if isinstance(line, Problem) else clean(line, at_most=_LONGEST)
            for line in self.args[0]
        )

    def rename(self, path: str, other: str) -> None:
        """Call a file or folder otherwise, in all that is said."""
        self.args = (tuple(_renamed(line, path, other) for line in self.args[0]),)
        self.problems = tuple(line for line in self.args[0] if isinstance(line, Problem))
        self.fix = None if self.fix is None else self.fix.replace(path, other)

    def __str__(self) -> str:
        return _with_fix(self.message, self.fix)


def _renamed(line: Problem | str, path: str, other: str) -> Problem | str:
    if isinstance(line, str):
        return line.replace(path, other)
    return replace(
        line, file=line.file.replace(path, other), message=line.message.replace(path, other)
    )


class UsageError(NwEvalError):
    """An option or argument cannot be used as given."""

    exit_code = 2


class SuiteError(NwEvalError):
    """A suite file has problems. `problems` holds all of them, in file order.

    `others` are what is wrong besides, with files that are not the suite's own: its policy's card.
    The message has a line for each fault.
    """

    exit_code = 2

    def __init__(self, problems: Iterable[Problem], others: Sequence[NwEvalError] = ()) -> None:
        lines = (line for other in others for line in str(other).splitlines())
        super().__init__((*problems, *lines))
        self.others = tuple(others)


class RobotError(UsageError):
    """A robot's folder cannot be used. The message has a line for each fault."""


class SceneError(NwEvalError):
    """A scene cannot be loaded or built."""

    exit_code = 2


class PolicyError(NwEvalError):
    """A policy card or checkpoint cannot be used."""

    exit_code = 2


class CodeError(PolicyError):
    """Python code that a card names (policy, sensor, wrapper) raised, or is not what it says."""


class CrashError(PolicyError):
    """The process that opened a checkpoint died: of the checkpoint, or of the machine."""

    exit_code = 4


class PluginError(NwEvalError):
    """What an installed package brings along cannot be imported, or is not what it says."""

    exit_code = 2


class PrerequisiteError(NwEvalError):
    """Something that the chosen options need is not installed."""

    exit_code = 2


_EXTRAS = frozenset({"onnxruntime", "torch"})
"""Packages of which each is an extra of its own name."""


def not_installed(error: BaseException) -> PrerequisiteError | None:
    """Return what to say of an import that failed, if an extra brings the package; else None."""
    if not isinstance(error, ModuleNotFoundError) or error.name not in _EXTRAS:
        return None
    return PrerequisiteError(
        f"the package {error.name} is not installed", fix=f"pip install 'nw-eval[{error.name}]'"
    )


class TrialError(NwEvalError):
    """A trial could not be run to a result; the policy is not to blame for a score of 0."""

    exit_code = 4


class ActionError(TrialError):
    """A policy's action is not one finite number for each joint."""


class NotFiniteError(ActionError):
    """A number of an action, or of what a network gives, is NaN or infinite."""


class DivergedError(TrialError):
    """A position, velocity, acceleration or control became NaN, infinite or huge."""


class ServerError(TrialError):
    """A policy's server does not answer, or not to the question; the policy may be all right."""


class StoreError(NwEvalError):
    """Results cannot be written or are damaged."""

    exit_code = 4


class FetchError(NwEvalError):
    """Something is to be fetched, and the network or the hub does not let it come now."""

    exit_code = 4


class IncomparableError(NwEvalError):
    """Two runs do not pair: different trials, versions or scenes."""

    exit_code = 5


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint for a misspelt name: `did you mean 'x'?`, or the list of known names."""
    names = sorted(known)
    close = get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean {close[0]!r}?"
    if not names:
        return "none are known"
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"known: {', '.join(names[:_LISTED])}{more}"


def is_interrupt(error: BaseException) -> bool:
    """Whether an exception is the user's Ctrl-C, which must end more than a trial.

    Workers ignore Ctrl-C (`engine.worker.start`), so a KeyboardInterrupt in one of them is of the
    policy.
    """
    hears = signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    return hears and isinstance(error, KeyboardInterrupt)
