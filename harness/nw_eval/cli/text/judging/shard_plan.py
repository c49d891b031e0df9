"""The parts of a run, for people and for the matrix of a CI job."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.api import ShardPlan


def shard_page(planned: ShardPlan) -> str:
    """Return the parts as lines of text: what to type for each, and about what it takes."""
    count = len(planned.parts)
    rows = [("part", "trials", "minutes")]
    rows += [
        (f"--shard {index}/{count}", str(part.trials), f"{part.minutes:.1f}")
        for index, part in enumerate(planned.parts, start=1)
    ]
    most = "at most " if planned.parts[0].baseline is not None else ""
    return "\n".join(
        [
            f"suite     {planned.suite}: {most}{plural(planned.trials, 'trial')} in {count} parts",
            "",
            *aligned(rows, right=(1, 2)),
            "",
            "`nw-eval merge RUN... --out FOLDER` puts them together, and judges the whole.",
        ]
    )


def shard_matrix(planned: ShardPlan) -> str:
    """Return the parts as the JSON of a GitHub matrix, in one line: a job for each part."""
    count = len(planned.parts)
    jobs = [
        {
            "suite": planned.suite,
            "shard": f"{index}/{count}",
            "index": index,
            "count": count,
            "trials": part.trials,
        }
        for index, part in enumerate(planned.parts, start=1)
    ]
    return json.dumps({"include": jobs})
