"""What takes long and is begun before the arguments are even parsed."""

from __future__ import annotations

from collections.abc import Sequence

_FENCELESS = ("--in", "--engine", "--allow", "--render")
"""Beginnings of options with which trials run elsewhere, or in processes that are not forked."""
_HELP = frozenset({"-h", "--help"})


def begin(arguments: Sequence[str]) -> None:
    """Start what trials are forked from, for a command that will most likely run some.

    It imports for as long as the verb does itself and the run is planned, on another core. Where
    the guess is wrong, it ends with this process.
    """
    if len(arguments) < 2 or arguments[0] != "run" or _HELP & set(arguments):
        return
    if not any(word.replace("_", "-").startswith(_FENCELESS) for word in arguments):
        from nw_eval.rollout.confined.start import prepare

        prepare()
