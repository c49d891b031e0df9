"""`nw-eval schema`: the JSON Schema of suites, cards and scenes, for editors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nw_eval.cli.verbs.verb import Verb, verb_of


@verb_of("schema")
class Schema(Verb):
    """Write the JSON Schema that editors use to complete and check files."""

    kind = "suite"
    out: Path | None
    """The file to write (default: standard output)."""

    def show(self, result: Mapping[str, Any]) -> str:
        return json.dumps(result, indent=2) if self.out is None else ""
