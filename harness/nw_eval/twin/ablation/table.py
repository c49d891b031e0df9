"""The table of an ablation: every way's figures, and how far each is from the first."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from statistics import fmean, stdev

from nw_eval.reporting.markdown import markdown_table, write_report
from nw_eval.reporting.tables.table import Table
from nw_eval.stats.student import t_quantile
from nw_eval.twin.ablation.ablate import LOW, TrainedArm

PAGE = "table.md"
_COLUMNS = ("begins on", "depths", "Gaussians", "PSNR, dB", "against the first", "SSIM", "low")
_CONFIDENCE = 0.95


def table_text(outcomes: Sequence[TrainedArm]) -> str:
    """Return the table as Markdown that reads as plain text.

    Differences are taken view by view, since all ways meet the same ones; their interval is
    Student's, over the views.

    Args:
        outcomes: at least one; the others are compared with the first.
    """
    table = Table(
        title="What mesh and depths are worth to the splat",
        columns=(
            "begins on",
            "depths",
            "Gaussians",
            "PSNR, dB",
            "against the first",
            "SSIM",
            "low",
        ),
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
