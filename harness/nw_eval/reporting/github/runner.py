"""The files by which a step hands GitHub's runner a summary and outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from nw_eval.errors import StoreError

_WHOLE = 1024 * 2**10
"""Bytes of a step's summary, all runs of the step together; GitHub drops a larger one whole."""


@dataclass(frozen=True, kw_only=True)
class Runner:
    """What the environment says of GitHub's runner."""

    summary: Path | None
    output: Path | None
    workspace: Path
    """The folder of the repository."""


def runner_of(environment: Mapping[str, str]) -> Runner:
    """Return what an environment says of GitHub's runner."""

    def path(name: str) -> Path | None:
        return Path(value) if (value := environment.get(name)) else None

    return Runner(
        summary=path("GITHUB_STEP_SUMMARY"),
        output=path("GITHUB_OUTPUT"),
        workspace=path("GITHUB_WORKSPACE") or Path.cwd(),
    )


def room_in(summary: Path | None) -> int:
    """Return how many bytes a step's summary still takes."""
    try:
        size = 0 if summary is None else summary.stat().st_size
    except OSError:  # Not there yet; whether it can be written shows when it is.
        size = 0
    return max(0, _WHOLE - size - 1)


def append(path: Path | None, text: str, variable: str) -> None:
    """Add whole lines to a file of the runner's.

    Args:
        path: the file; None if the environment names none.
        text: lines.
        variable: of the environment, for an error.

    Raises:
        StoreError: there is none, or it cannot be written.
    """
    if path is None:
        raise StoreError(f"the environment has no {variable}", fix="run it as a step of a job")
    try:
        with path.open("a+b") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - 1))
            begun = file.read(1) not in {b"", b"\n"}  # Somebody's line has no end.
            file.write((b"\n" if begun else b"") + text.encode())
    except OSError as error:
        raise StoreError(f"cannot write {variable}: {error.strerror or error}") from error


def outputs_text(outputs: Mapping[str, str]) -> str:
    """Return outputs as the runner reads them: each between lines that its value cannot hold."""
    return "".join(_output(name, value) for name, value in outputs.items())


def _output(name: str, value: str) -> str:
    # A value does not hold its own digest, so that the same run writes the same file.
    fence = f"nw_eval_{sha256(value.encode(errors='surrogateescape')).hexdigest()}"
    return f"{name}<<{fence}\n{value}\n{fence}\n"
