"""How often each kind of fault was played, how it first ended, and how often all was well."""

from collections import Counter

from kinds import KINDS, possible


def table(ended, seed):
    """Return the tally as Markdown.

    Args:
        ended: for each case its kind, how it ended at first, and what was wrong with it.
        seed: of all.
    """
    failed = sum(bool(each["wrong"]) for each in ended)
    lines = [
        f"{len(ended)} faults of seed {seed}, {failed} not as they must be",
        "",
        "| fault | times | recovered | exit code at first |",
        "|---|---:|---:|---|",
    ]
    for kind in sorted({each["kind"] for each in ended}):
        mine = [each for each in ended if each["kind"] == kind]
        ends = Counter(each["ended"] for each in mine)
        first = "; ".join(f"{count} x {end}" for end, count in sorted(ends.items()))
        recovered = sum(not each["wrong"] for each in mine)
        lines.append(f"| {kind} | {len(mine)} | {recovered} | {first} |")
    impossible = [f"{name} ({KINDS[name].needs})" for name in KINDS if name not in possible()]
    if impossible:
        lines += ["", f"Not possible here, for want of something: {', '.join(impossible)}."]
    return "\n".join(lines) + "\n"
