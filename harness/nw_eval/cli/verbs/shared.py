"""Options that are the same in all verbs that have them: their types, letters and words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import tyro

_Suite = Annotated[
    str,
    tyro.conf.arg(help="A suite file or a shipped suite's name (`nw-eval suites` lists them)."),
]
Suite = tyro.conf.Positional[_Suite]
Workers = Annotated[
    int | None,
    tyro.conf.arg(aliases=["-j"], help="Worker processes (default: one per core)."),
]
Scenes = Annotated[
    tuple[str, ...] | None,
    tyro.conf.arg(
        metavar="GLOB ...",
        help="Only scenes that match one of these globs; `split:train` and `split:eval` work, too.",
    ),
]
Checkpoint = Annotated[Path | None, tyro.conf.arg(help="Use these weights instead of the card's.")]
AllowCode = Annotated[bool, tyro.conf.arg(help="Allow the policy's card to import Python code.")]
NoCache = Annotated[bool, tyro.conf.arg(help="Run every trial; neither read nor write the cache.")]
Label = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]],
    tyro.conf.arg(
        metavar="KEY=VALUE",
        help="A label for the run's pages and for indexes of runs, such as training_run=may-3. "
        "CI's repository, commit, branch, pull_request, job and job_url are added.",
    ),
]
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
