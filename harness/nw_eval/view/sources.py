"""What a word names that is to be looked at: a log or run, a place, or a policy."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from nw_eval.catalogue import is_built_in
from nw_eval.errors import NwEvalError, UsageError
from nw_eval.files.inside import what_is
from nw_eval.results.run_folder import taken_over_log
from nw_eval.scenes.folder import SCENE_FILE

Kind = Literal["log", "scene", "policy"]


def kind_of(source: str | None, *, policy: str | None, scene: str | None) -> Kind | None:
    """Return what a source is; None without one.

    Args:
        source: a path, or a name.
        policy: that is named beside it.
        scene: likewise.

    Raises:
        UsageError: it is neither, or one thing too much is named.
    """
    if source is None:
        if policy is None and scene is None:
            raise UsageError(
                "there is nothing to look at",
                fix="name a log, a run's folder, a place or a policy, or --policy and --scene",
            )
        return None
    kind = _kind(source)
    if kind == "log" and (policy is not None or scene is not None):
        raise UsageError(
            f"{source} shows what was logged, with its own policy and place",
            fix="leave --policy and --scene out; `nw-eval replay` runs another policy in it",
        )
    if (kind == "scene" and scene is not None) or (kind == "policy" and policy is not None):
        raise UsageError(f"two of one kind: {source} and --{kind}", fix="name one of them")
    return kind


def _kind(source: str) -> Kind:
    path = taken_over_log(Path(source))
    if is_built_in(source) or source.startswith("neverwhere:"):
        return "scene"
    if what_is(path / SCENE_FILE) == "file" or path.name == SCENE_FILE:
        return "scene"
    if what_is(path) == "file" and path.suffix == ".mcap":
        return "log"
    if any(what_is(path / name) == "file" for name in ("run.json", "journal.jsonl")):
        return "log"
    if source.startswith("hub:"):
        raise UsageError(
            f"{source} may be a place or a policy", fix=f"say which: --scene or --policy {source}"
        )
    if _is_policy(source):
        return "policy"
    raise UsageError(
        f"there is no log, run, place or policy at {source!r}",
        fix="name one: a file of mcap/, a folder in reports/, or as `nw-eval scenes list` and "
        "`nw-eval policies list` do",
    )


def _is_policy(source: str) -> bool:
    from nw_eval.policies import load_bundle

    if what_is(Path(source)) != "nothing":
        return True  # Its loading says what is wrong with it.
    try:
        load_bundle(source)
    except NwEvalError:
        return False
    return True
