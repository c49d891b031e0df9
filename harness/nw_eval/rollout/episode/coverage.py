"""How much of its images a policy saw covered by the splat."""

from __future__ import annotations

import json


class ImageCoverage:
    """Smallest and mean splat coverage of the images that the policy was shown."""

    def __init__(self) -> None:
        self._count, self._smallest, self._total = 0, 1.0, 0.0

    def add(self, share: float) -> None:
        """Add one image's coverage, 0..1."""
        self._count += 1
        self._smallest = min(self._smallest, share)
        self._total += share

    @property
    def smallest(self) -> float | None:
        """The least covered image; None without images."""
        return self._smallest if self._count else None

    @property
    def mean(self) -> float | None:
        """None without images."""
        return self._total / self._count if self._count else None

    def state(self) -> bytes:
        """Return count, smallest and sum."""
        numbers = [self._count, self._smallest, self._total]
        return repr(numbers).encode()  # the JSON of finite numbers, as in `TrailProgress`

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._count, self._smallest, self._total = json.loads(state)
