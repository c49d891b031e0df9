"""Where the metric frame lies: z up, the floor at 0, x along the way that the cameras went."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def placed(*, up: Values, scale: float, floor: float, centres: Values, forward: Values) -> Values:
    """Return T_metric_capture (4, 4).

    The origin lies on the floor below the first camera, x leads to the camera that is farthest from
    it in the plane. Where no camera moved, x is the way that the first one looks.

    Args:
        up: (3,) unit vector in the capture's frame.
        scale: metres in a unit of the capture.
        floor: its height along `up`, in the capture's unit.
        centres: (V, 3) of the cameras, one at least.
        forward: (3,) where the first camera looks.
    """
    ways = centres - centres[0]
    ways = ways - np.einsum("ni,i->n", ways, up)[:, None] * up
    lengths = np.linalg.norm(ways, axis=1)
    heights = np.einsum("ni,i->n", centres, up) - floor
    x = ways[int(np.argmax(lengths))]
    if lengths.max() < 0.05 * float(np.abs(heights).max()):
        x = forward - (forward @ up) * up
    if np.linalg.norm(x) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        x = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])  # It looks straight down.
    x = x - (x @ up) * up
    x = x / np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = centres[0] - float(heights[0]) * up
    T = np.eye(4)
    T[:3, :3] = scale * rotation
    T[:3, 3] = -scale * rotation @ origin
    return T
