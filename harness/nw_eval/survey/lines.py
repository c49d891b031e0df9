"""The figures of a survey as lines for people."""

from __future__ import annotations

from nw_eval.plural import plural
from nw_eval.survey.findings.of_views import (
    FARTHEST,
    LEAST_COVERED,
    MOST_MEDIAN,
    MOST_P95,
    MOST_SHIFT,
    WIDEST,
)
from nw_eval.survey.scene import Survey
from nw_eval.survey.views import NEAR, SurveyedViews


def survey_lines(survey: Survey) -> tuple[str, ...]:
    """Return what was measured, each number with its limit where it has one."""
    ground, feet = survey.ground, survey.feet
    line = (
        f"ground: of {survey.length:.1f} m of trail, {ground.width:.2f} m wide where the feet of "
        f"{survey.robot} go, {100 * ground.sound:.1f} % is seen as it is touched; "
        f"{feet.sunk} of {feet.count} dropped feet sank in"
    )
    lines = [line]
    if survey.views is not None:
        lines += _view_lines(survey.views)
    return tuple(lines)


def _view_lines(seen: SurveyedViews) -> list[str]:
    views, apart = seen.views, seen.disagreement
    whole = 100 * min(view.alpha for view in views)
    line = f"camera: in {plural(len(views), 'image')} along it the splat covers {whole:.1f} %"
    covered = [view.covered for view in views if view.covered is not None]
    if covered:
        line += f", and {100 * min(covered):.1f} % of what the mesh has within {NEAR:g} m"
        line += f" (at least {100 * LEAST_COVERED:.0f} %)"
    lines = [f"{line}, or more"]
    if apart.median is not None and apart.p95 is not None:
        x, y, z = apart.shift
        lines.append(
            f"depth: on the course splat and mesh are {apart.median:.3f} m apart, 95 % within "
            f"{apart.p95:.3f} m (at most {MOST_MEDIAN:g} and {MOST_P95:g} m), in all moved by "
            f"({x:.2f}, {y:.2f}, {z:.2f}) m (at most {MOST_SHIFT:g} m)"
        )
    known = [view.nearest for view in views if view.nearest is not None]
    if known:
        lines.append(
            f"captures: the nearest camera is {max(near.distance for near in known):.2f} m and "
            f"{max(near.angle for near in known):.2f} rad away, or less (at most {FARTHEST:g} m "
            f"and {WIDEST:g} rad)"
        )
    return lines
