"""From a robot's figures to its specification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.robots.mjcf import body_names, write_mjcf
from nw_eval.robots.spec import JOINT_KINDS, LEGS, RobotSpec

if TYPE_CHECKING:
    from nw_eval.robots.figures import Figures


def make_spec(figures: Figures) -> RobotSpec:
    """Return the robot of those figures, its MJCF written."""
    links = [link for leg in figures.legs for link in (leg.hip, leg.thigh, leg.calf)]
    return RobotSpec(
        name=figures.name,
        joints=tuple(f"{leg}_{kind}_joint" for leg in LEGS for kind in JOINT_KINDS),
        default_pose=figures.default_pose,
        joint_ranges=tuple(link.range for link in links),
        kp=figures.kp,
        joint_damping=figures.joint_damping,
        torque_limits=(figures.torque_limit,) * len(links),
        armature=figures.armature,
        friction_loss=figures.friction_loss,
        feet=LEGS,
        monitored_geoms=figures.monitored_geoms,
        published_monitored_geoms=figures.published_monitored_geoms,
        cameras=figures.cameras,
        height_camera_offset=figures.height_camera_offset,
        bodies=body_names(figures),
        visuals=figures.visuals,
        spawn_height=figures.spawn_height,
        mjcf=write_mjcf(figures),
    )
