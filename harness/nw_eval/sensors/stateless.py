"""What measurements have in common that remember nothing."""

from __future__ import annotations

from nw_eval.memory import Forgetful


class Stateless(Forgetful):
    """A measurement of numbers that depends on the moment alone."""

    is_image = False
    coverage: float | None = None

    def reset(self) -> None:
        """Nothing to forget."""
