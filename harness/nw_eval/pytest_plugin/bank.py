"""Saving what a policy scores as the bank of a suite, for somebody to look at."""

from __future__ import annotations

from contextlib import chdir
from functools import partial
from typing import TYPE_CHECKING

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.plural import plural
from nw_eval.pytest_plugin.options import SETTINGS

if TYPE_CHECKING:
    from nw_eval.pytest_plugin.tested import TestedSuite


def update(suite: TestedSuite) -> None:
    """Save the bank of a suite; fail if that changed it, so that a review comes before its use."""
    from nw_eval import api
    from nw_eval.pytest_plugin.telling.progress import Log

    settings = suite.config.stash[SETTINGS]
    # The suite's baseline is that of its own policy: another one is not saved over it.
    name = settings.baseline or (suite.shown.baseline if settings.policy is None else None)
    save = partial(
        api.save_baseline,
        suite.typed,
        policy=settings.policy,
        name=None if name == "none" else name,
        workers=settings.workers,
        cache=settings.cache,
        checkpoint=settings.checkpoint,
        listener=Log(),
    )
    saved, fault = None, ""
    try:
        with chdir(suite.project):
            saved = save()
            if saved.action == "kept":  # Only what says something else is replaced.
                saved = save(renew=True)
    except NwEvalError as error:
        fault = str(error)
    if saved is None:
        pytest.fail(fault, pytrace=False)
    if saved.action == "unchanged":
        return
    manifest = saved.bank.manifest
    pytest.fail(
        f"{saved.file} is {saved.action}: {manifest.policy.name}, "
        f"{plural(manifest.starts, 'start')} in each scene\n"
        "Look at what has changed, commit it, and run again without --nw-update-baseline.",
        pytrace=False,
    )
