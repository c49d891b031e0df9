"""What is wrong with what the robot's camera sees along a trail."""

from __future__ import annotations

from nw_eval.scenes.finding import SceneFinding, Severity
from nw_eval.survey.disagreement import Disagreement
from nw_eval.survey.views import NEAR, SurveyedView, SurveyedViews

# Measured on the built-in places: what is near is covered to 0.98 in the worst view; a splat that
# lies where it should seems up to 0.08 m off; half of a course is within 0.035 m of its splat, and
# 95 % within 0.112 m. One that is moved by 0.2 m seems 0.12 m off, or more.

LEAST_COVERED = 0.9
"""Share of what is near that the splat should cover."""
TOO_LITTLE = 0.75
"""Share below which images show something else than the place."""
MOST_SHIFT = 0.1
"""How far a splat may lie from the mesh, m."""
MOST_MEDIAN = 0.1
"""How far half of the course may be from its splat, m."""
MOST_P95 = 0.125
"""How far 95 % of the course should be from its splat at most, m."""
FAR_P95 = 0.25
"""From where on that is an error, m."""
FARTHEST = 1.5
"""How far the robot's camera should be from the nearest capture camera, m."""
WIDEST = 1.0
"""Angle between the two optical axes, rad, likewise."""


def view_findings(seen: SurveyedViews) -> list[SceneFinding]:
    """Return what is wrong with the splat as it is seen from a trail."""
    return [*_coverage(seen.views), *_depth(seen), *_captures(seen.views)]


def _coverage(views: tuple[SurveyedView, ...]) -> list[SceneFinding]:
    found: list[SceneFinding] = []
    near = [(view.covered, view) for view in views if view.covered is not None]
    if near:
        share, view = min(near, key=lambda each: each[0])
        below = sum(covered < LEAST_COVERED for covered, _ in near)
        if below:
            severity: Severity = "error" if share < TOO_LITTLE else "warning"
            found.append(
                SceneFinding(
                    code="splat_thin",
                    severity=severity,
                    message=f"the splat covers {100 * share:.0f} % of what the mesh shows within "
                    f"{NEAR:g} m at {_where(view)}; "
                    f"{100 * LEAST_COVERED:.0f} % is wanted, and {below} of {len(near)} views "
                    "have less",
                    fix="train it on photographs of that stretch, or lead the trail elsewhere",
                    value=share,
                    place=view.position,
                )
            )
    emptiest = min(views, key=lambda view: view.alpha)
    if emptiest.alpha < LEAST_COVERED and not found:
        found.append(
            SceneFinding(
                code="open_view",
                severity="note",
                message=f"the splat covers {100 * emptiest.alpha:.0f} % of the whole image at "
                f"{_where(emptiest)}; the rest is white, and far away or nothing in the mesh, too",
                fix="`alpha` of a suite's gate.validity must be below that",
                value=emptiest.alpha,
                place=emptiest.position,
            )
        )
    return found


def _depth(seen: SurveyedViews) -> list[SceneFinding]:
    disagreement = seen.disagreement
    x, y, z = disagreement.shift
    moved = (x * x + y * y + z * z) ** 0.5
    if moved > MOST_SHIFT:
        return [_shifted(disagreement, moved)]
    median, p95 = disagreement.median, disagreement.p95
    if median is None or p95 is None or (median <= MOST_MEDIAN and p95 <= MOST_P95):
        return []
    view = max(seen.views, key=lambda view: view.p95 or 0.0)
    return [
        SceneFinding(
            code="splat_off_mesh",
            severity="error" if median > MOST_MEDIAN or p95 > FAR_P95 else "warning",
            message=f"on the course within {NEAR:g} m splat and mesh are {median:.3f} m apart in "
            f"the median and {p95:.3f} m in the 95th percentile ({MOST_MEDIAN:g} and "
            f"{MOST_P95:g} m are allowed); it is worst at {_where(view)}, there "
            f"{view.p95 or 0.0:.2f} m",
            fix="look at `nw-eval scenes render`: Gaussians float there, or the mesh is coarse",
            value=p95,
            place=view.position,
        )
    ]


def _shifted(disagreement: Disagreement, moved: float) -> SceneFinding:
    x, y, z = disagreement.shift
    fix = f"check T_world_splat; adding ({-x:.2f}, {-y:.2f}, {-z:.2f}) to its translation fits"
    if not disagreement.shifts_as_one:
        fix = "check T_world_splat: scale, rotation and translation"
    return SceneFinding(
        code="splat_shifted",
        severity="error",
        message=f"the splat lies ({x:.2f}, {y:.2f}, {z:.2f}) m from the mesh, {moved:.2f} m in "
        f"all; {MOST_SHIFT:g} m is allowed",
        fix=fix,
        value=moved,
    )


def _captures(views: tuple[SurveyedView, ...]) -> list[SceneFinding]:
    known = [(view.nearest, view) for view in views if view.nearest is not None]
    beyond = [
        (nearest, view)
        for nearest, view in known
        if nearest.distance > FARTHEST or nearest.angle > WIDEST
    ]
    if not beyond:
        return []
    nearest, view = max(
        beyond, key=lambda each: max(each[0].distance / FARTHEST, each[0].angle / WIDEST)
    )
    return [
        SceneFinding(
            code="far_from_captures",
            severity="warning",
            message=f"nothing was photographed like the robot's view at {_where(view)}: the "
            f"nearest camera is {nearest.distance:.2f} m away and turned by "
            f"{nearest.angle:.2f} rad ({FARTHEST:g} m and {WIDEST:g} rad are allowed); "
            f"so are {len(beyond)} of {len(known)} views",
            fix="photograph that stretch again, from low down, looking along the trail",
            value=nearest.distance,
            place=view.position,
        )
    ]


def _where(view: SurveyedView) -> str:
    x, y, _ = view.position
    return f"{view.along:.2f} m along the trail, ({x:.2f}, {y:.2f})"
