"""Policy cards: everything about a checkpoint that is not in the checkpoint. Nothing here runs one.

`load_card` reads a `Card`; `JointControl` has its settings of actions as arrays.
"""

from nw_policies.cards.card import Card
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.joint_control import (
    Action,
    JointControl,
    actuator_values,
    motor_groups,
    motors_follow,
    mounted_robot,
    physics_steps,
)
from nw_policies.cards.load import load_card

__all__ = [
    "Action",
    "Card",
    "InputSpec",
    "JointControl",
    "actuator_values",
    "load_card",
    "motor_groups",
    "motors_follow",
    "mounted_robot",
    "physics_steps",
]
