"""What measurements have in common that remember nothing."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray


class Stateless:
    """A measurement of numbers that depends on the moment alone."""

    is_image = False
    coverage: float | None = None

    def reset(self) -> None:
        """Nothing to forget."""

    def memory(self) -> dict[str, NDArray[Any]]:
        """Nothing to remember."""
        return {}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Nothing to go back to."""
