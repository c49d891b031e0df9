"""The splat of a build, trained four times: from points or from the mesh, blind to depth or not.

After Table I of "The Neverwhere Visual Parkour Benchmark Suite", for a place of one's own. All four
see the same photographs, and are compared on the same ones that were kept from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError
from nw_eval.twin.align import read_alignment
from nw_eval.twin.align.apply import moved_points
from nw_eval.twin.appearance import AppearanceOptions, AppearanceReport, train_splat
from nw_eval.twin.capture import read_capture

if TYPE_CHECKING:
    from nw_eval.twin.building.folder import BuildFolder

LOW = 0.6
"""Height below which a photograph shows what a legged robot's camera sees, m above the floor."""


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One way to train.

    Attributes:
        name: of its folder.
        mesh: whether Gaussians begin on the mesh; else at the points that calibration found.
        depth: whether the depths of the reconstruction count in the loss.
    """

    name: str
    mesh: bool
    depth: bool


ARMS = (
    Arm(name="points", mesh=False, depth=False),
    Arm(name="points-depth", mesh=False, depth=True),
    Arm(name="mesh", mesh=True, depth=False),
    Arm(name="mesh-depth", mesh=True, depth=True),
)
"""The first is what the others are compared with; the last is how a build trains."""


@dataclass(frozen=True, kw_only=True)
class TrainedArm:
    """What came of one way.

    Attributes:
        arm: which.
        report: of its training.
        low: names of those photographs held out that were taken from a robot's height; None where
            the build has no alignment yet, so that no height is known.
    """

    arm: Arm
    report: AppearanceReport
    low: frozenset[str] | None


def ablate(
    folder: BuildFolder,
    options: AppearanceOptions,
    say: Callable[[str], None],
    *,
    threads: int = 2,
) -> tuple[TrainedArm, ...]:
    """Train all four, each in `build/ablation/<arm>/`; one that was cut off goes on.

    Args:
        folder: of a build whose mesh is there.
        options: of the splat; `mesh` and `depth` are set by each arm.
        say: takes a line for people.
        threads: that share each step; no result depends on them.

    Raises:
        SceneError: the build has no mesh, or is damaged.
        UsageError: no photograph would be held out, so that nothing could be compared.
        StoreError: nothing can be written.
    """
    folder.needs("reconstruct")
    low = _low(folder)
    outcomes: list[TrainedArm] = []
    for number, arm in enumerate(ARMS, 1):
        say(f"ablation: {number} of {len(ARMS)}, {arm.name}")
        report = train_splat(
            folder.capture,
            folder.mesh,
            folder.path / "ablation" / arm.name,
            replace(options, mesh=arm.mesh, depth=arm.depth),
            say,
            threads=threads,
        )
        if not report.views:
            raise UsageError(
                f"none of {report.photos} photographs is held out: there is nothing to compare on",
                fix="name some with --held-out, such as 'low_*'",
            )
        outcomes.append(TrainedArm(arm=arm, report=report, low=low))
    return tuple(outcomes)


def _low(folder: BuildFolder) -> frozenset[str] | None:
    """Return the names of the photographs that were taken from a robot's height."""
    if not folder.align.is_file():
        return None
    capture = read_capture(folder.capture)
    centres = moved_points(read_alignment(folder.align).T_metric_capture, capture.centres)
    shots = zip(capture.shots, centres[:, 2], strict=True)
    return frozenset(shot.name for shot, height in shots if height < LOW)
