"""Policy cards: everything about a checkpoint that is not in the checkpoint. Nothing here runs one.

`load_card` reads a `Card`; `JointControl` is what it says of actions, as arrays.
"""

from nw_eval.cards.card import Card
from nw_eval.cards.joint_control import (
    Action,
    JointControl,
    actuator_values,
    motors_follow,
    mounted_robot,
    physics_steps,
)
from nw_eval.cards.load import load_card
from nw_eval.cards.networks import InputSpec

__all__ = [
    "Action",
    "Card",
    "InputSpec",
    "JointControl",
    "actuator_values",
    "load_card",
    "motors_follow",
    "mounted_robot",
    "physics_steps",
]
