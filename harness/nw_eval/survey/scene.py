"""All that is looked at along a scene's trail."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.robots import get_robot
from nw_eval.scenes.finding import SceneFinding
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Scene
from nw_eval.survey.feet import DroppedFeet, drop_feet
from nw_eval.survey.findings.of_ground import feet_findings, ground_findings
from nw_eval.survey.findings.of_views import view_findings
from nw_eval.survey.ground import SurveyedGround, survey_ground
from nw_eval.survey.samples import trail_samples
from nw_eval.survey.stance import stance_of
from nw_eval.survey.views import SurveyedViews, survey_views
from nw_eval.words import Robot


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was measured along a trail, and what is wrong there.

    Attributes:
        robot: by whose stance and camera.
        length: of the trail from the start, m.
        ground: under its feet.
        feet: that were dropped there.
        views: of its camera; None where the scene has no splat, or it was not looked at.
        findings: what is wrong or remarkable.
    """

    robot: Robot
    length: float
    ground: SurveyedGround
    feet: DroppedFeet
    views: SurveyedViews | None
    findings: tuple[SceneFinding, ...]


def survey_scene(scene: Scene, *, robot: Robot = "go1", read_splat: bool = True) -> Survey:
    """Go along a scene's trail with a robot's eye and feet.

    Args:
        scene: whose mesh is in order as far as `check_scene` sees.
        robot: who stands there.
        read_splat: look at the splat, too; the kernels that draw it are compiled on first use.

    Raises:
        SceneError: the splat cannot be read.
    """
    spec = get_robot(robot)
    stance = stance_of(spec)
    rays = RayScene(scene.mesh())
    ground = survey_ground(scene, rays, stance.half_width)
    feet = drop_feet(scene, rays, stance.half_width)
    views = None
    if read_splat and scene.splat is not None:
        views = survey_views(scene, rays, spec, stance)
    return Survey(
        robot=robot,
        length=float(trail_samples(scene, 1.0).along[-1]),
        ground=ground,
        feet=feet,
        views=views,
        findings=(
            *ground_findings(ground, scene.task),
            *feet_findings(feet),
            *(() if views is None else view_findings(views)),
        ),
    )
