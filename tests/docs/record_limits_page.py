"""The tables and the picture of docs/limits-of-policies.md, from what `nw-eval limits` found.

`python tests/docs/record_limits_page.py GROUP NAME=FOLDER ...` takes the limits of folders into the
record, `limits.json`, and writes tables and picture anew; without arguments it only writes them.
GROUP is the table in which a policy stands: one of `HEADS`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from nw_eval.reporting.html.limits import bounds_words
from nw_gate.limits.limit import Limit
from nw_gate.results.provenance import read_run_info

ROOT = Path(__file__).parents[2]
RECORD = Path(__file__).with_name("limits.json")
PAGE = ROOT / "docs" / "limits-of-policies.md"
PICTURE = ROOT / "docs" / "images" / "limits.svg"
LADDERS = ("stairs/up", "stairs/down", "hurdles/bar", "gaps/gap", "ramps/up", "ramps/down")
DRAWN = {"stairs/up": "stairs up, rise", "hurdles/bar": "bars, height", "ramps/up": "slope up"}
"""Ladders of the picture, with their titles."""
WIDTH = 2
"""Rungs between the bounds where a search ends, without a star."""
HEADS = {
    group: f"| {first} | {' | '.join(ladders)} |"
    for group, first, ladders in (
        ("shipped", "shipped policy", LADDERS),
        ("public", "public checkpoint", LADDERS),
        ("contacts", "with contacts", tuple(DRAWN)),
        ("gains", "kp", ("stairs/up", "hurdles/bar", "gaps/gap")),
    )
}


def recorded() -> list[dict[str, Any]]:
    """Return the recorded policies in their order; each has group, name, digest and limits."""
    return json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.is_file() else []


def limits_of(policy: Mapping[str, Any]) -> dict[str, Limit]:
    """Return a recorded policy's limits by ladder."""
    return {ladder: Limit.from_dict(saved) for ladder, saved in policy["limits"].items()}


def of_folder(group: str, name: str, folder: Path) -> dict[str, Any]:
    """Return what a folder of `nw-eval limits` found, as the record has it."""
    found = json.loads((folder / "limits.json").read_text(encoding="utf-8"))["limits"]
    infos = [read_run_info(folder / each["run"] / "run.json") for each in found]
    info = infos[0]
    return {
        "group": group,
        "name": name,
        "checkpoint": info.policy.checkpoint_digest,
        "robot": info.suite["robot"] if "/" not in str(info.suite["robot"]) else "",
        "limits": {
            each["ladder"]: each["limit"]
            for each, run in zip(found, infos, strict=True)
            if not run.interrupted
        },
    }


def table(group: str) -> Iterator[str]:
    """Yield the lines of a table: bounds, and how many trials they took."""
    ladders = HEADS[group].strip("| ").split(" | ")[1:]
    for policy in recorded():
        if policy["group"] == group:
            limits = limits_of(policy)
            cells = [_cell(limits[name]) if name in limits else "" for name in ladders]
            yield f"| {' | '.join([policy['name'], *cells])} |"


def _cell(limit: Limit) -> str:
    star = "" if limit.width == WIDTH else "*"
    star += "" if limit.decided else "?"
    return f"{bounds_words(limit)}{star} ({len(limit.trials)})"


def page() -> str:
    """Return the page with its tables as the record gives them."""
    text = PAGE.read_text(encoding="utf-8")
    for group, head in HEADS.items():
        start = text.index(head)
        end = re.compile(r"\n(?!\|)").search(text, start)
        assert end is not None, f"the table of {group} ends"
        rule = f"|{'---|' * (head.count('|') - 1)}"
        text = text[:start] + "\n".join([head, rule, *table(group)]) + text[end.start() :]
    return text


LEFT, WIDE, APART, HIGH, TOP = 176, 176, 24, 26, 76
COLOURS = {"touch": ("#b3432b", "#e8b9ad"), "contacts": ("#2b6fb3", "#adcce8")}
"""Of the sure part of a bar and of what is between its bounds."""


def picture() -> str:
    """Return an SVG with a bar for each policy and ladder, light between its bounds."""
    policies = [each for each in recorded() if each["group"] in {"shipped", "public"}]
    touching = {each["name"]: each for each in recorded() if each["group"] == "contacts"}
    width, height = LEFT + len(DRAWN) * (WIDE + APART), TOP + HIGH * len(policies) + 12
    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img"'
            ' font-family="sans-serif" font-size="12" fill="#222">'
        ),
        "<title>How far each policy can go, with bounds</title>",
        f'<rect width="{width}" height="{height}" rx="8" fill="#fdfdfc"/>',
        f'<text x="12" y="22" fill="{COLOURS["touch"][0]}">a touch ends a trial</text>',
        f'<text x="12" y="40" fill="{COLOURS["contacts"][0]}">with contacts</text>',
    ]
    for column, (ladder, title) in enumerate(DRAWN.items()):
        x = LEFT + column * (WIDE + APART)
        rungs = limits_of(policies[0])[ladder].ladder
        easiest, hardest = (rungs.says(rungs.rungs[end]) for end in (0, -1))
        parts += [
            f'<text x="{x}" y="22" font-weight="bold">{title}</text>',
            f'<text x="{x}" y="{TOP - 14}" fill="#666">{easiest}</text>',
            f'<text x="{x + WIDE}" y="{TOP - 14}" fill="#666" text-anchor="end">{hardest}</text>',
        ]
    for row, each in enumerate(policies):
        y = TOP + HIGH * row
        bold = ' font-weight="bold"' if each["group"] == "shipped" else ""
        parts.append(f'<text x="12" y="{y + 11}"{bold}>{escape(each["name"])}</text>')
        for how, policy in (("touch", each), ("contacts", touching.get(each["name"]))):
            limits = {} if policy is None else limits_of(policy)
            for column, ladder in enumerate(DRAWN):
                if ladder in limits:
                    top = y if how == "touch" else y + 10
                    parts.append(_bar(limits[ladder], LEFT + column * (WIDE + APART), top, how))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _bar(limit: Limit, x: int, y: int, how: str) -> str:
    low, high = ((end + 1) / (len(limit.ladder.rungs) + 1) * WIDE for end in limit.ends)
    lengths = ((WIDE, "#eee"), (high, COLOURS[how][1]), (low, COLOURS[how][0]))
    bars = "".join(
        f'<rect x="{x}" y="{y}" width="{length:.1f}" height="8" fill="{colour}"/>'
        for length, colour in lengths
    )
    return f"<g><title>{escape(bounds_words(limit))}</title>{bars}</g>"


def main(words: list[str]) -> None:
    """Take folders into the record, and write the page."""
    if words:
        known = {(each["group"], each["name"]): each for each in recorded()}
        for word in words[1:]:
            name, _, folder = word.partition("=")
            found, key = of_folder(words[0], name, Path(folder)), (words[0], name)
            # A ladder that was searched again stands in place of the first search.
            found["limits"] = known.get(key, found)["limits"] | found["limits"]
            known[key] = found
        RECORD.write_text(json.dumps(list(known.values())) + "\n", encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
    PICTURE.write_text(picture(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
