"""The operating curve of a gate as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nw_eval.files.cache import atomic_path, followed
from nw_eval.stats.bank.curve import CurvePoint
from nw_eval.stats.bank.evidence import Margins

_WORDS = (
    ("REGRESSED", "#c0392b"),
    ("INCONCLUSIVE", "#b8b8b8"),
    ("PASS", "#2e8b57"),
)


def draw_curve(points: Sequence[CurvePoint], path: Path, *, margins: Margins, title: str) -> None:
    """Draw which share of policies of each drop is convicted, passed and left open, and the trials.

    Args:
        points: of the curve, drops rising.
        path: of the PNG.
        margins: of the gate.
        title: what it is the curve of.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    drops = [point.drop for point in points]
    shares = [
        [100 * point.regressed for point in points],
        [100 * point.undecided for point in points],
        [100 * point.passed for point in points],
    ]
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.4))
    upper.stackplot(
        drops, shares, labels=[word for word, _ in _WORDS], colors=[colour for _, colour in _WORDS]
    )
    upper.set(ylim=(0, 100), xlim=(drops[0], drops[-1]), ylabel="of such policies, %")
    for axes in (upper, lower):
        for drop in (margins.tolerate, margins.max_drop):
            axes.axvline(drop, color="black", linewidth=1, linestyle="--")
    for drop, name in ((margins.tolerate, "tolerate"), (margins.max_drop, "max_drop")):
        upper.annotate(f"{name} {drop:g}", (drop, 100), (3, 4), textcoords="offset points")
    upper.legend(loc="center right", reverse=True)
    # A dollar sign in a title begins no formula.
    figure.suptitle(title, parse_math=False)
    lower.plot(drops, [point.trials for point in points], color="#34495e", marker="o")
    lower.set(ylim=(0, None), xlabel="true drop of mean success", ylabel="trials, mean")
    lower.grid(alpha=0.3)
    with atomic_path(followed(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})
