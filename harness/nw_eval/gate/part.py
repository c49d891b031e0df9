"""What is said of a part of a run: whether its trials ran. The whole is judged, and no part of it.

Which trials a part has follows from hashes: it is no sample that anything is claimed of, it need
not have met a critical scene, and it has no whole round. So the word is RAN, or what keeps the part
from being put together with the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nw_eval.gate.absolute import judge
from nw_eval.gate.verdict import Verdict
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.suite.model import Gate


def of_part(rows: Sequence[Row], run: RunInfo, gate: Gate) -> Verdict:
    """Return RAN, INFRASTRUCTURE where a trial has no result, INVALID where the bank fails here.

    Args:
        rows: of the part's plan.
        run: what they are of; `run.shard` says which part.
        gate: the suite's settings, of which no bar and no tier counts.
    """
    bare = gate.model_copy(
        update={"success_rate": None, "max_drop": None, "tiers": {}, "validity": None}
    )
    planned = {scene: count for scene, count in run.planned.items() if count}
    verdict = judge(rows, bare, planned)
    scores = tuple(replace(item, tier=gate.tier(item.scene)) for item in verdict.per_scene)
    word, reasons = verdict.verdict, verdict.reasons
    if run.baseline is not None and run.baseline.moved:
        word, reasons = "INVALID", run.baseline.moved
    elif word == "RAN":
        reasons = ()
    whole = f"{run.shard}: `nw-eval merge` puts all parts together, and judges the whole"
    return replace(verdict, verdict=word, reasons=(*reasons, whole), per_scene=scores)
