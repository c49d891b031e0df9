"""Options that are the same in all verbs that have them: their types, letters and words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import tyro

_Suite = Annotated[
    str,
    tyro.conf.arg(
        help="A suite file, or the name of a shipped suite (`nw-eval suites` lists them)."
    ),
]
Suite = tyro.conf.Positional[_Suite]
Workers = Annotated[
    int | None,
    tyro.conf.arg(aliases=["-j"], help="Worker processes; the number of cores when absent."),
]
Scenes = Annotated[
    tuple[str, ...] | None,
    tyro.conf.arg(
        metavar="GLOB ...",
        help="Only scenes that match one of these globs, or are of `split:train` or `split:eval`.",
    ),
]
Checkpoint = Annotated[
    Path | None, tyro.conf.arg(help="Weights to use in place of those that the card names.")
]
AllowCode = Annotated[bool, tyro.conf.arg(help="Let the policy's card import Python code.")]
NoCache = Annotated[bool, tyro.conf.arg(help="Run every trial, and keep no result for later runs.")]
SHARED: Mapping[str, Any] = MappingProxyType(
    {
        "suite": _Suite,
        "workers": Workers,
        "scenes": Scenes,
        "checkpoint": Checkpoint,
        "allow_code": AllowCode,
        "no_cache": NoCache,
    }
)
"""These by their names, for verbs that are made of a function."""
