"""The splat of a build, trained four times: from points or from the mesh, blind to depth or not.

After Table I of "The Neverwhere Visual Parkour Benchmark Suite", for a scene of one's own. All four
see the same photographs, and are compared on the same ones that were kept from them. The table has
every way's figures, and how far each is from the first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from statistics import fmean, stdev
from typing import TYPE_CHECKING

from nw_base.errors import UsageError
from nw_eval.reporting.markdown import markdown_table, write_report
from nw_eval.reporting.tables.table import Table
from nw_gate.stats.interval import t_quantile
from nw_twin.align.alignment import read_alignment
from nw_twin.building.appearance import AppearanceOptions, AppearanceReport, train_splat
from nw_twin.capture import read_capture
from nw_twin.place import moved_points

if TYPE_CHECKING:
    from nw_twin.building.folder import BuildFolder

LOW = 0.6
"""Height below which a photograph shows what a legged robot's camera sees, m above the floor."""

PAGE = "table.md"
_COLUMNS = ("begins on", "depths", "Gaussians", "PSNR, dB", "against the first", "SSIM", "low")
_CONFIDENCE = 0.95


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


def table_text(outcomes: Sequence[TrainedArm]) -> str:
    """Return the table as Markdown that reads as plain text.

    Differences are taken view by view, since all ways meet the same ones; their interval is
    Student's, over the views.

    Args:
        outcomes: at least one; the others are compared with the first.
    """
    table = Table(
        title="What mesh and depths are worth to the splat",
        columns=_COLUMNS,
        rows=tuple(_row(each, outcomes[0]) for each in outcomes),
        numbers=frozenset({"Gaussians", "PSNR, dB", "SSIM", "low"}),
    )
    views, low = outcomes[0].report.views, outcomes[0].low
    seen = sum(view.name in low for view in views) if low else 0
    note = (
        f"PSNR and SSIM are means over {len(views)} photographs that no training saw, exposures "
        f"allowed for. Low: PSNR on the {seen} of them from below {LOW:g} m, as a robot sees."
    )
    return f"{markdown_table(table)}\n\n{note}"


def write_table(folder: Path, outcomes: Sequence[TrainedArm]) -> Path:
    """Write the table into a folder, and return its path.

    Raises:
        StoreError: it cannot be written.
    """
    write_report(folder / PAGE, table_text(outcomes) + "\n")
    return folder / PAGE


def _row(outcome: TrainedArm, first: TrainedArm) -> tuple[str, ...]:
    arm, views = outcome.arm, outcome.report.views
    low = [view.psnr_corrected for view in views if view.name in (outcome.low or ())]
    return (
        "mesh" if arm.mesh else "points of calibration",
        "yes" if arm.depth else "no",
        f"{outcome.report.gaussians:,}",
        f"{outcome.report.psnr:.2f}",
        "" if outcome is first else _against(outcome, first),
        f"{outcome.report.ssim:.3f}",
        f"{fmean(low):.2f}" if low else "",
    )


def _against(outcome: TrainedArm, first: TrainedArm) -> str:
    """Return the mean difference of PSNR by view, with its interval where there are two or more."""
    pairs = zip(outcome.report.views, first.report.views, strict=True)
    differences = [one.psnr_corrected - other.psnr_corrected for one, other in pairs]
    middle = fmean(differences)
    if len(differences) < 2:
        return f"{middle:+.2f}"
    spread = stdev(differences) / sqrt(len(differences))
    half = t_quantile(_CONFIDENCE, len(differences) - 1) * spread
    return f"{middle:+.2f} ({middle - half:+.2f} to {middle + half:+.2f})"
