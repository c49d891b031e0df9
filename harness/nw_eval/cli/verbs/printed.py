"""What verbs print for programs: `--json`."""

from __future__ import annotations

import json as jsons
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

from nw_gate.results.baseline import BaselineResults

if TYPE_CHECKING:
    from nw_eval.api import RunReport
    from nw_gate.limits.limit import Limit


@dataclass(frozen=True, kw_only=True)
class Printed:
    """A verb that prints JSON, too."""

    json: bool = False
    """Print JSON."""


def json_text(value: Any) -> str:
    """Return a result as JSON: fields of dataclasses by name, of a baseline what it is alone."""
    return jsons.dumps(_plain(value), indent=2, allow_nan=False)


def json_line(value: Any) -> str:
    """Return a result as JSON in one line."""
    return jsons.dumps(_plain(value), allow_nan=False)


def judged_json(judged: RunReport, code: int) -> str:
    """Return a verdict and where its evidence lies as JSON.

    Args:
        judged: the run.
        code: exit code of the process.
    """
    verdict = judged.verdict
    fields = {
        "verdict": verdict.verdict,
        "exit_code": code,
        "suite": str(judged.info.suite.get("name", "")),
        "policy": judged.info.policy.name,
        "baseline": None if judged.baseline is None else judged.baseline.name,
        "success": verdict.success,
        "bounds": list(verdict.interval),
        "bar": verdict.bar,
        "drop": None if verdict.against is None else verdict.against.drop,
        "trials": verdict.n,
        "planned": verdict.planned,
        "completed": verdict.completed,
        "errors": verdict.errors,
        "reasons": verdict.reasons,
        "scenes": {
            scene.scene: {"success": scene.mean, "trials": scene.n, "completed": scene.completed}
            for scene in verdict.per_scene
        },
        "limits": {
            item.ladder: {
                "verdict": item.word,
                "cleared": _bound(item.candidate, "lower"),
                "not_cleared": _bound(item.candidate, "upper"),
                "baseline_cleared": _bound(item.baseline, "lower"),
                "baseline_not_cleared": _bound(item.baseline, "upper"),
                "unit": None if item.candidate is None else item.candidate.ladder.unit,
                "trials": 0 if item.candidate is None else len(item.candidate.trials),
            }
            for item in verdict.limits
        },
        "run": judged.typed_folder,
        "report": judged.typed_page,
        "html": judged.typed_html,
    }
    return json_text(fields)


def _bound(limit: Limit | None, which: Literal["lower", "upper"]) -> float | None:
    bound = None if limit is None else getattr(limit, which)
    return None if bound is None else bound.value


def _plain(value: Any) -> Any:
    """Return a value as JSON has it; a number that is not finite is null, a path is text."""
    if isinstance(value, BaselineResults):
        return _plain(value.manifest)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if (fields := _fields(value)) is not None:
        return {_NAMES.get(str(key), str(key)): _plain(each) for key, each in fields.items()}
    if hasattr(value, "tolist"):  # An array, or a number of numpy's.
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in cast("list[Any]", value)]
    if isinstance(value, (set, frozenset)):
        return sorted(_plain(list(cast("set[Any]", value))))
    return str(value)


_NAMES = {"bank": "baseline"}
"""Fields by the names that users know them by."""


def _fields(value: Any) -> Mapping[Any, Any] | None:
    """Return the fields of a value by name; None = it has none."""
    if isinstance(value, Mapping):
        return cast("Mapping[Any, Any]", value)
    if hasattr(value, "model_dump"):
        return value.model_dump()
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return value._asdict() if hasattr(value, "_asdict") else None
