"""What a worker needs to run one trial: plain values that travel between processes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.suite.model import PUBLISHED, Rendering
from nw_eval.suite.trials import Trial
from nw_eval.tasks import COURSE, AnyTask
from nw_eval.words import Backend, Collision, Kernels, Projection, Protocol, Record

if TYPE_CHECKING:
    from nw_eval.cards import Card


@dataclass(frozen=True, kw_only=True)
class TrialJob:
    """One trial to run, and where its evidence goes.

    Nothing in it depends on the other trials of the run, on the worker, or on the order.
    """

    trial: Trial
    robot: str  # what robots.get_robot understands
    robot_folder: Path | None = None  # where it lies, if that is a folder
    protocol: Protocol = "strict"
    task: AnyTask = COURSE  # what the robot is to do
    scores: tuple[str, ...] = ()  # what is measured beside
    duration: float  # s of simulated time after which the trial times out
    contact_termination: bool = True  # whether a blow to head or trunk ends it
    scene: str  # what `catalogue.open_scene` understands: a built-in name or a folder
    collision: Collision = "terrain"  # how the mesh of a folder collides
    policy: str  # what policies.load_bundle understands
    policy_name: str = ""  # the bundle's name, by which a replay elsewhere can find it
    checkpoint: Path | None = None  # weights instead of those that the card names
    checkpoint_digest: str  # hex SHA-256; empty = whatever a server serves
    allow_code: bool = False  # the caller's word, which no file can give
    record: Record = "failures"  # camera images for which trials; the rest is always logged
    mcap: Path | None = None  # where the log goes; None = no log
    render: Backend = "cpu"  # what draws splats
    rendering: Rendering = PUBLISHED  # and how
    time_limit: float = 600.0  # s of wall time after which the trial counts as hung
    attachments: tuple[tuple[str, str], ...] = ()  # (name, text): the suite, the policy's card


def kernels_of(robot: str, card: Card, *projections: Projection) -> tuple[Kernels, ...]:
    """Return which kernels of the CPU draw what a robot's cameras see, as a card mounts them.

    A perturbation may bend a lens that the robot's folder says is straight: that takes the time to
    compile, and no more.

    Args:
        robot: what `get_robot` understands.
        card: of the policy that sees it.
        projections: of pinholes.
    """
    # Robots of folders are read by the simulator's compiler.
    from nw_eval.cards import mounted_robot
    from nw_eval.robots import get_robot

    lenses = [mount.intrinsics for mount in mounted_robot(get_robot(robot), card).cameras.values()]
    is_bent = any(lens is not None and lens.distortion is not None for lens in lenses)
    return (*dict.fromkeys(projections), *(("lens",) if is_bent else ()))
