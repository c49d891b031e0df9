"""What is wrong with the ground under a trail."""

from __future__ import annotations

from nw_eval.scenes.finding import Code, SceneFinding, Severity
from nw_eval.survey.feet import SUNK, DroppedFeet
from nw_eval.survey.ground import TOLERANCE, Flaw, GroundFlaw, SurveyedGround
from nw_eval.words import Task

LONGEST_GAP = 1.0
"""Length of a gap from rim to rim, m, that may be what the course is about."""

INVENTED = 0.1
"""Area of ground that physics may add to what the mesh shows, m2: a small hole that is closed."""

_MOST = 5  # findings of one scene; the largest
_CODES: dict[Flaw, Code] = {
    "missing": "ground_missing",
    "untouched": "ground_untouched",
    "unseen": "ground_unseen",
}
_FIXES: dict[Flaw, str] = {
    "missing": "close the mesh there, photograph that ground too, or lead the trail elsewhere",
    "untouched": "what hangs there is thinner than physics can carry, or its faces look down: make "
    "it a closed solid 15 mm thick or more",
    "unseen": "close the mesh there, or open it up to the corridor's sides if that is a gap",
}


def ground_findings(ground: SurveyedGround, task: Task) -> list[SceneFinding]:
    """Return a finding for each of the largest flaws, in the order of the trail."""
    largest = sorted(ground.flaws, key=lambda flaw: -flaw.area)[:_MOST]
    return [_finding(flaw, ground, task) for flaw in ground.flaws if flaw in largest]


def feet_findings(feet: DroppedFeet) -> list[SceneFinding]:
    """Return that feet sink in, if any did."""
    if not feet.sunk:
        return []
    x, y, _ = feet.place
    return [
        SceneFinding(
            code="feet_sink",
            severity="error",
            message=f"{feet.sunk} of {feet.count} feet that were dropped on the trail came to rest "
            f"under the ground, up to {feet.deepest:.3f} m at {feet.along:.2f} m along it, "
            f"({x:.2f}, {y:.2f}); {SUNK:g} m is allowed",
            fix="look for folded or doubled faces there, and faces that look down",
            value=feet.deepest,
            place=feet.place,
        )
    ]


def _finding(flaw: GroundFlaw, ground: SurveyedGround, task: Task) -> SceneFinding:
    x, y, _ = flaw.place
    where = f"from {flaw.first:.2f} to {flaw.last:.2f} m along the trail, round ({x:.2f}, {y:.2f})"
    size = f"{flaw.width:.2f} m wide in the {ground.width:.2f} m where feet go, {flaw.area:.3f} m2"
    off = "" if flaw.off is None else f", by {flaw.off:.2f} m ({TOLERANCE:g} m is allowed)"
    added = f" ({INVENTED:g} m2 of such ground is a warning)" if flaw.kind == "unseen" else ""
    messages: dict[Flaw, str] = {
        "missing": f"there is no ground {where}: {size}",
        "untouched": f"ground is seen {where}, where physics has none or lower one{off}: {size}",
        "unseen": f"physics carries feet {where}, where the mesh shows no ground or lower one{off}"
        f": {size}{added}",
    }
    severity, fix = _severity(flaw), _FIXES[flaw.kind]
    if task == "gaps" and flaw.kind == "missing" and flaw.across and _length(flaw) <= LONGEST_GAP:
        severity, fix = "note", "nothing, if that is a gap of the course"
    return SceneFinding(
        code=_CODES[flaw.kind],
        severity=severity,
        message=messages[flaw.kind],
        fix=fix,
        value=flaw.area,
        place=flaw.place,
    )


def _severity(flaw: GroundFlaw) -> Severity:
    """A small hole that physics closes changes what a policy is told; a large one, the course."""
    closed = flaw.kind == "unseen" and flaw.area <= INVENTED and not flaw.across
    return "warning" if closed else "error"


def _length(flaw: GroundFlaw) -> float:
    return flaw.last - flaw.first
