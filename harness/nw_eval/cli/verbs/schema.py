"""`nw-eval schema`: the JSON Schema of suites, cards and scenes, for editors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from nw_base.words import Described


@dataclass(frozen=True, kw_only=True)
class Schema:
    """Write the JSON Schema that editors use to complete and check files."""

    kind: tyro.conf.Positional[Described] = "suite"
    """Which kind of file: a suite, a policy's card, scene.yaml, or a scene's file of boxes."""
    out: Path | None = None
    """Where to write it; standard output when absent."""

    def __call__(self) -> int:
        from nw_eval import api

        described = api.schema(self.kind, out=self.out)
        if self.out is None:
            print(json.dumps(described, indent=2))
        return 0
