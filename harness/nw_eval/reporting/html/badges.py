"""Badges for a README, as shields.io reads them from an address: one of all suites, one of each.

Every file is a JSON of `https://shields.io/badges/endpoint-badge`, with what a suite's latest run
came to.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from nw_eval.clean import clean
from nw_eval.reporting.html.runs import ListedRun

_COLOURS = {
    "PASS": "brightgreen",
    "RAN": "blue",
    "INCONCLUSIVE": "yellow",
    "REGRESSED": "red",
    "INFRASTRUCTURE": "lightgrey",
    "INVALID": "lightgrey",
}
"""By the verdict's word, the best first: the badge of all suites has the colour of the worst."""


def badges(runs: Sequence[ListedRun], *, stem: str = "badge") -> dict[str, str]:
    """Return the text of each badge by the name of its file: `STEM.json`, `STEM-SUITE.json`.

    Args:
        runs: in any order; of each suite the latest one counts.
        stem: of the files' names.
    """
    latest = {run.suite: run for run in sorted(runs, key=lambda run: run.order)}
    found: dict[str, str] = {}
    for suite, run in sorted(latest.items()):
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", suite)[:64]
        found.setdefault(f"{stem}-{slug}.json", _badge(suite, _words(run), run.verdict.verdict))
    words = [run.verdict.verdict for run in latest.values()]
    if not words:
        return {}
    if len(latest) == 1:
        message = _words(next(iter(latest.values())))
    else:
        counted = [(words.count(word), word) for word in _COLOURS if word in words]
        message = ", ".join(f"{count} {word}" for count, word in counted)
    worst = max(words, key=list(_COLOURS).index)
    return {f"{stem}.json": _badge("nw-eval", message, worst), **found}


def _words(run: ListedRun) -> str:
    success = run.verdict.success
    mean = "" if success is None else f" {success:.3f}"
    return f"{run.verdict.verdict}, {run.policy}{mean}"


def _badge(label: str, message: str, word: str) -> str:
    facts = {
        "schemaVersion": 1,
        "label": clean(label, at_most=64),
        "message": clean(message, at_most=120),
        "color": _COLOURS[word],
    }
    return f"{json.dumps(facts, indent=2)}\n"
