"""What a suite's task may ask of a policy beside a velocity, by the policy's card and its robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from nw_base.errors import PolicyError
from nw_policies.cards import JointControl
from nw_policies.cards.joints import short_name
from nw_policies.cards.observations import ProprioObservation
from nw_policies.cards.terms import Target, named_places
from nw_sim.tasks.targets import OwnTarget

if TYPE_CHECKING:
    from nw_policies.cards import Card
    from nw_scenes.robots import RobotSpec


def own_targets(card: Card, robot: RobotSpec) -> dict[str, OwnTarget]:
    """Return all that a task may ask for of a policy, by name: joints by their short one.

    Raises:
        PolicyError: `control.commanded` names no joint, or one whose action is no position.
    """
    control = JointControl.from_card(card, robot)
    wanted = card.control.commanded
    if wanted is None:
        driven = set(control.driven.tolist())
        places = [place for place in range(len(control.names)) if place not in driven]
    else:
        places = sorted(named_places(wanted, control.names, "control.commanded"))
    own: dict[str, OwnTarget] = {}
    for place in places:
        name, index = short_name(control.names[place]), int(control.order[place])
        if control.kinds[place] not in {"joint_position", "joint_position_offset"}:
            raise PolicyError(
                f"control.commanded: {name} is told {control.kinds[place]}, no position",
                fix="leave it out",
            )
        own[name] = OwnTarget(float(control.base[place]), *robot.joint_ranges[index], index, True)
    for seen in card.observations.values():
        for term in seen.frame_terms if isinstance(seen, ProprioObservation) else ():
            if isinstance(term, Target):
                for name, value in term.of.items():
                    if (key := short_name(name)) not in own:
                        own[key] = _read(key, value, robot)
    return own


def _read(name: str, value: float, robot: RobotSpec) -> OwnTarget:
    """Return what a policy reads and follows itself: an angle of a joint, or any other number."""
    joints = [short_name(joint) for joint in robot.joints]
    if name not in joints:
        return OwnTarget(value, -math.inf, math.inf, None, False)
    index = joints.index(name)
    return OwnTarget(value, *robot.joint_ranges[index], index, False)
