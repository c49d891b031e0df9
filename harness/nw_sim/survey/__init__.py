"""A scene gone along before a robot does: what its camera will see, and what its feet will meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_base.plural import plural
from nw_scenes.finding import SceneFinding
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_scenes.scene import Scene
from nw_sim.survey.course import course_samples, stance_of
from nw_sim.survey.ground import (
    FOOT,
    MOST_ROUGH,
    PATCH,
    DroppedFeet,
    SurveyedGround,
    drop_feet,
    feet_findings,
    footing_findings,
    ground_findings,
    survey_ground,
)
from nw_sim.survey.legs import Fit, beyond_finding, fit_of, legs_of
from nw_sim.survey.views import (
    FARTHEST,
    LEAST_COVERED,
    MOST_MEDIAN,
    MOST_P95,
    MOST_SHIFT,
    NEAR,
    WIDEST,
    SurveyedViews,
    survey_views,
    view_findings,
)


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was measured along a course, and what is wrong there.

    Attributes:
        robot: by whose stance and camera.
        length: of the course from the start, m.
        legs: what its steps and gaps ask of the robot's legs.
        ground: under its feet.
        feet: that were dropped there.
        views: of its camera; None where the scene has no splat, or it was not looked at.
        findings: what is wrong or remarkable.
    """

    robot: str
    length: float
    legs: Fit
    ground: SurveyedGround
    feet: DroppedFeet
    views: SurveyedViews | None
    findings: tuple[SceneFinding, ...]


def survey_scene(scene: Scene, *, robot: str = "go1", read_splat: bool = True) -> Survey:
    """Go along a scene's course with a robot's eye and feet.

    Args:
        scene: whose mesh is in order as far as `check_scene` sees.
        robot: who stands there.
        read_splat: look at the splat, too; the kernels that draw it are compiled on first use.

    Raises:
        SceneError: the splat cannot be read.
    """
    spec = get_robot(robot)
    stance = stance_of(spec)
    legs = fit_of(scene, legs_of(spec))
    beyond = beyond_finding(legs)
    rays = RayScene(scene.mesh())
    ground = survey_ground(scene, rays, stance.half_width, stance.length)
    feet = drop_feet(scene, rays, stance.half_width)
    views = None
    if read_splat and scene.splat is not None:
        views = survey_views(scene, rays, spec, stance)
    return Survey(
        robot=robot,
        length=float(course_samples(scene, 1.0).along[-1]),
        legs=legs,
        ground=ground,
        feet=feet,
        views=views,
        findings=(
            *(() if beyond is None else (beyond,)),
            *ground_findings(ground, scene.task),
            *feet_findings(feet),
            *footing_findings(ground.footing, robot, legs.legs.length),
            *(() if views is None else view_findings(views)),
        ),
    )


def survey_lines(survey: Survey) -> tuple[str, ...]:
    """Return what was measured, each number with its limit where it has one."""
    ground, feet = survey.ground, survey.feet
    line = (
        f"ground: of {survey.length:.1f} m of course, {ground.width:.2f} m wide where the feet of "
        f"{survey.robot} go, {100 * ground.sound:.1f} % is seen as it is touched; "
        f"{feet.sunk} of {feet.count} dropped feet sank in"
    )
    lines = [line, str(survey.legs)]
    if survey.views is not None:
        lines += _view_lines(survey.views)
    return tuple(lines)


def footing_lines(survey: Survey) -> tuple[str, ...]:
    """Return how rough the ground is along the course, and how stepped and steep."""
    footing, length = survey.ground.footing, survey.length
    known = np.isfinite(footing.roughness)
    if not known.any():
        return (f"roughness: no ground is known along {length:.1f} m of course",)
    usual, most = 1e3 * np.quantile(footing.roughness[known], (0.5, 0.9))
    bears = 1e3 * MOST_ROUGH * survey.legs.legs.length
    step = np.where(np.isfinite(footing.step), footing.step, 0.0)
    highest, slopes = int(np.argmax(step)), np.degrees(footing.slope[np.isfinite(footing.slope)])
    steepest = f"{np.median(slopes):.0f} degrees (median), {slopes.max():.0f} at most"
    roughness = (
        f"roughness: the ground is {usual:.0f} mm off the plane of {PATCH:g} m (median), "
        f"{most:.0f} mm or less on 90 % of {length:.1f} m of course; feet of {survey.robot} bear "
        f"{bears:.0f} mm"
    )
    steps = (
        f"steps: {step[highest]:.2f} m over {FOOT:g} m at most, {footing.along[highest]:.1f} m "
        f"along the course; slopes are {steepest if len(slopes) else 'not known'}"
    )
    return roughness, steps


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
