"""The scenes that students may be taught in, and what workers need of them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from nw_eval.built_in.splits import split_of
from nw_eval.catalogue import FoundScene, references
from nw_eval.engine.listener import Silence
from nw_eval.engine.prepare import build_splats, check_splats, open_backend, ready_scans
from nw_eval.errors import UsageError
from nw_eval.learn.program.progress import EVERY

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from nw_eval.cards import Card


class _Told(Silence):
    """Passes lines for people on, and every ten seconds which splat is being built."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._said_at = time.monotonic()

    def message(self, text: str) -> None:
        """Pass it on."""
        self._say(text)

    def scene(self, name: str, fraction: float) -> None:
        """Say it, if it is time."""
        if (now := time.monotonic()) - self._said_at >= EVERY:
            self._said_at = now
            self._say(f"builds the splats that are not there yet: {name} · {fraction:.0%} of it")


def training_scenes(patterns: Sequence[str]) -> tuple[FoundScene, ...]:
    """Return the scenes that patterns name, without those that evaluations are for.

    Raises:
        SceneError: a pattern matches nothing, or a scene cannot be opened.
        UsageError: nothing is left.
    """
    found = [each for each in references(patterns) if split_of(each[0]) != "eval"]
    if not found:
        raise UsageError(
            f"scenes: {', '.join(patterns)}: these are evaluation scenes, in which nobody learns",
            fix="name others, such as `split:train`",
        )
    return tuple(FoundScene.at(*each) for each in found)


def make_ready(scenes: Sequence[FoundScene], card: Card, say: Callable[[str], None]) -> None:
    """Compile and build what all workers need, once, before the first of them starts.

    Args:
        scenes: that will be driven in.
        card: the student's.
        say: takes a line for people.

    Raises:
        UsageError: the student must see a splat, and a scene has none.
        SceneError: a splat cannot be made.
    """
    opened, listener = [found.scene for found in scenes], _Told(say)
    check_splats(card, opened)
    ready_scans(opened, listener)
    if card.splat_images:
        open_backend("cpu", listener, is_fenced=True)
        build_splats(opened, listener)
