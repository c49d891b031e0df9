"""The end of a run as the terminal shows it."""

from __future__ import annotations

import sys
from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api import RunReport

_PAGE = 120
"""Columns of text where there is no terminal to ask."""


def summary(judged: RunReport, *, folded: bool = False) -> str:
    """Return the first tables of a judged run, its verdict and where its report lies.

    Args:
        judged: the run.
        folded: whether GitHub's runner is to fold the tables.
    """
    from rich.console import Console

    from nw_eval.reporting.console import print_tables, print_verdict
    from nw_eval.reporting.github.commands import END_GROUP, begin_group

    stream = StringIO()
    screen = Console(file=sys.stdout)
    console = Console(
        file=stream,
        width=screen.width if screen.is_terminal else _PAGE,
        force_terminal=screen.is_terminal,
        no_color=screen.no_color,
    )
    if folded:
        stream.write(f"{begin_group('Tables')}\n")
    print_tables(console, judged.info, judged.rows, judged.verdict, judged.typed_folder)
    if folded:
        stream.write(f"{END_GROUP}\n")
    print_verdict(console, judged.info, judged.rows, judged.verdict)
    if judged.typed_page is not None:
        both = "" if judged.html is None else f" and {judged.html.name}"
        console.print(f"report: {judged.typed_page}{both}", highlight=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())
