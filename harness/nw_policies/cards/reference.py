"""What a card says of the motion that its policy tracks."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from nw_policies.cards.model import Rate
from nw_policies.cards.networks import Checkpoint, PlainFile
from nw_policies.cards.terms import Foot

Names = Annotated[tuple[Foot, ...], Field(min_length=1, max_length=500)]


class Reference(Checkpoint):
    """The motion that a policy tracks: a file beside the card, or the checkpoint that holds it."""

    file: PlainFile | None = None  # pyright: ignore[reportIncompatibleVariableOverride] - a checkpoint always has one.
    """Path inside the card's folder; null = a suite names the motion."""
    rate: Rate | None = None
    """Frames per second of the file, Hz, where it does not say it itself; null = the policy's rate
    for a motion in a checkpoint."""
    joints: Names | None = None
    """The joints of the file in its order, where it does not name them. null = the robot's, or in
    the order in which the poses of its bodies are right. Joints of the robot that the file lacks
    stay in the default pose."""
    anchor: Foot | None = None
    """The body that the policy compares with the motion's; null = the robot's root."""
    bodies: Names | None = None
    """The bodies whose errors count; null = all. Those of them that no other one hangs on, such as
    feet and hands, are the end effectors."""
