"""Limits of policies: as a table, in Markdown, and as a page with a bar for each ladder.

The files are `limits.md` and `limits.html`. A bar goes from the easiest rung to the hardest one
that is shown to be cleared; what lies between both bounds is drawn lighter. The curve below it is
what the trials suggest, and no claim rests on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.evidence import CLIP_BYTES, Film
from nw_eval.reporting.markdown import escaped, markdown_table, write_report
from nw_eval.reporting.tables.table import Table

if TYPE_CHECKING:
    from nw_gate.limits.limit import Limit

LEFT, RIGHT = 8.0, 552.0
"""Edges of a bar's axis, in units of its drawing."""
TOP, BOTTOM = 8.0, 88.0
"""Edges of a curve's axis."""
_FILM_BYTES = 60_000
"""Of one film, at most: those of twelve ladders are 1.4 MB, and base64 adds a third."""


@dataclass(frozen=True, kw_only=True)
class RungFilm:
    """The last seconds of a trial at a rung, from outside."""

    says: str
    """What it shows, such as "0.24 m: fell"."""
    film: Film
    seconds: float
    """That it shows, simulated."""


@dataclass(frozen=True, kw_only=True)
class LadderLimit:
    """A policy's limit on one ladder."""

    policy: str
    """The name of its folder."""
    ladder: str
    """The ladder's name, such as `hurdles/bar`."""
    title: str
    """What its rungs are, for people."""
    limit: Limit
    run: Path = Path()
    """The folder of its trials."""
    errors: int = 0
    """Trials that ended in an error of the machine, without which the search could not go on."""
    films: tuple[RungFilm, ...] = ()
    """A completed trial at the last rung that is cleared, and a failed one at the first that is
    not; as far as there are such trials and they could be drawn."""


def film_bytes(limits: int) -> int:
    """Return how many bytes each film of a page with so many limits may have."""
    return min(_FILM_BYTES, CLIP_BYTES // (2 * max(1, limits)))


def write_limits(limits: Sequence[LadderLimit], out: Path, remarks: Sequence[str] = ()) -> None:
    """Write the files of some limits.

    Args:
        limits: the limits.
        out: the folder, which is there.
        remarks: sentences on what could not be shown.

    Raises:
        StoreError: a file cannot be written.
    """
    parts = ["# Limits", escaped(_note(limits)), markdown_table(limits_table(limits))]
    parts += ["\n".join(f"* {escaped(line)}" for line in limits_words(limits))]
    write_report(out / "limits.md", "\n\n".join(parts) + "\n")
    page = render(
        "limits.html.j2",
        note=_note(limits),
        policies=list(dict.fromkeys(each.policy for each in limits)),
        ladders=drawn_ladders(limits),
        table=limits_table(limits),
        words=limits_words(limits),
        remarks=remarks,
    )
    write_report(out / "limits.html", page)


def limits_table(limits: Sequence[LadderLimit]) -> Table:
    """Return a line for each ladder and policy."""
    return Table(
        title="Limits",
        columns=("ladder", "policy", "cleared up to", "not cleared at", "trials", "decided"),
        rows=tuple(
            (
                each.ladder,
                each.policy,
                *each.limit.bound_texts,
                str(len(each.limit.trials)),
                "yes" if each.limit.decided else "no",
            )
            for each in limits
        ),
        numbers=frozenset({"trials"}),
    )


def bounds_words(limit: Limit) -> str:
    """Return the bounds of a limit in a few words, such as "0.26 to 0.34 m".

    Where a rung is cleared by another share of trials than half of them, that is said, too.
    """
    low, high = limit.lower, limit.upper
    if low is not None and high is not None:
        text = f"{low.value:.6g} to {limit.ladder.says(high.value)}"
    elif low is not None:
        text = f"{limit.ladder.says(low.value)} or harder"
    else:
        text = "undecided" if high is None else f"easier than {limit.ladder.says(high.value)}"
    return text if limit.share == _SHARE else f"{text} for {100.0 * limit.share:.4g} %"


_SHARE = 0.5


def limits_words(limits: Sequence[LadderLimit]) -> list[str]:
    """Return a sentence for each limit."""
    several = len({each.policy for each in limits}) > 1
    return [
        f"{each.policy}, {each.limit.sentence}" if several else each.limit.sentence
        for each in limits
    ]


def _note(limits: Sequence[LadderLimit]) -> str:
    if not limits:
        return "No ladder was climbed."
    first = limits[0].limit
    return (
        f"A rung is cleared if the policy completes at least {100 * first.share:.4g} % of its "
        f"trials there. Each bound holds with {100 * first.confidence:.4g} % confidence."
    )


@dataclass(frozen=True, kw_only=True)
class DrawnLimit:
    """One policy on one ladder, in units of its drawing."""

    policy: str
    style: int
    """Which of the policies it is, from 0."""
    cleared: float
    """Where the bar ends: x of the hardest rung that is cleared."""
    failed: float
    """x of the easiest rung that is shown not to be cleared."""
    bounds: tuple[str, str]
    says: str
    dots: tuple[tuple[float, str], ...]
    """x and "k of n" of each rung that was tried."""
    line: str
    """The curve, as SVG's `path` takes it."""
    band: str
    """Its band, as SVG's `polygon` takes it."""
    films: tuple[tuple[str, Film], ...]
    """What each shows, and the film."""
    seconds: float
    """Of the longest film."""


@dataclass(frozen=True, kw_only=True)
class DrawnLadder:
    """One ladder with its policies."""

    name: str
    title: str
    easiest: str
    hardest: str
    limits: tuple[DrawnLimit, ...]


def drawn_ladders(limits: Sequence[LadderLimit]) -> list[DrawnLadder]:
    """Return each ladder with the limits on it, in units of its drawing."""
    policies = list(dict.fromkeys(each.policy for each in limits))
    names = list(dict.fromkeys(each.ladder for each in limits))
    found: list[DrawnLadder] = []
    for name in names:
        here = [each for each in limits if each.ladder == name]
        ladder = here[0].limit.ladder
        found.append(
            DrawnLadder(
                name=name,
                title=here[0].title,
                easiest=ladder.says(ladder.rungs[0]),
                hardest=ladder.says(ladder.rungs[-1]),
                limits=tuple(_limit(each, policies.index(each.policy)) for each in here),
            )
        )
    return found


def _limit(each: LadderLimit, style: int) -> DrawnLimit:
    limit, count = each.limit, len(each.limit.ladder.rungs)

    def x(rung: float) -> float:
        share = (rung + 1.0) / (count + 1.0)
        return round(LEFT + (RIGHT - LEFT) * min(1.0, max(0.0, share)), 1)

    def y(rate: float) -> float:
        return round(BOTTOM - (BOTTOM - TOP) * rate, 1)

    low, high = limit.ends
    curve = limit.curve
    points = [(x(rung), y(point.rate)) for rung, point in enumerate(curve)]
    upper = [(x(rung), y(point.high)) for rung, point in enumerate(curve)]
    lower = [(x(rung), y(point.low)) for rung, point in enumerate(curve)]
    return DrawnLimit(
        policy=each.policy,
        style=style,
        cleared=x(low),
        failed=x(high),
        bounds=limit.bound_texts,
        says=limit.sentence,
        dots=tuple(
            (x(rung), f"{done} of {tried} at {limit.ladder.says(limit.ladder.rungs[rung])}")
            for rung, (done, tried) in enumerate(zip(limit.completed, limit.tried, strict=True))
            if tried
        ),
        line="M" + "L".join(f"{a:g} {b:g}" for a, b in points),
        band=" ".join(f"{a:g},{b:g}" for a, b in [*upper, *reversed(lower)]),
        films=tuple((film.says, film.film) for film in each.films),
        seconds=max((film.seconds for film in each.films), default=0.0),
    )
