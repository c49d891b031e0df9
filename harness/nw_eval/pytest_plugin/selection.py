"""What `--lf` means for suites."""

from __future__ import annotations

import pytest

from nw_eval.pytest_plugin.items import SceneItem, VerdictItem
from nw_eval.pytest_plugin.tested import TestedSuite


def leave_verdicts_out(session: pytest.Session) -> None:
    """Deselect the verdict of a suite of which some scenes are to run, and not all.

    Where a scene failed the verdict did, and it takes every scene to say another. It is still among
    the last failed, and `--lf` runs it as soon as no scene of its suite is.
    """
    chosen: dict[TestedSuite, int] = {}
    for item in session.items:
        if isinstance(item, SceneItem):
            chosen[item.suite] = chosen.get(item.suite, 0) + 1
    left_out: list[pytest.Item] = [
        item
        for item in session.items
        if isinstance(item, VerdictItem)
        and 0 < chosen.get(item.suite, 0) < len(item.suite.shown.scenes)
    ]
    if left_out:
        session.config.hook.pytest_deselected(items=left_out)
        session.items[:] = [item for item in session.items if item not in left_out]
