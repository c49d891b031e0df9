"""Recurrent state that travels through a graph: inputs that an output of the last step feeds."""

from __future__ import annotations

import re
from collections.abc import Mapping

Shape = tuple[int | None, ...]


def state_pairs(inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]) -> dict[str, str]:
    """Return the inputs whose next value is an output, by their names: `h_in` and `h_out`.

    Exporters write `h_in` and `h_out` (rsl_rl, Isaac Lab), `in_h` and `out_h`, `h` and `h_next`,
    `prev_state` and `next_state`. The shapes must be the same.
    """
    pairs: dict[str, str] = {}
    for source, shape in inputs.items():
        stem = re.sub(r"(^|_)(in|input|prev)$|^(prev|in)_", "", source)
        for target, other_shape in outputs.items():
            other = re.sub(r"(^|_)(out|output|next)$|^(next|out)_", "", target)
            if other != target and other == stem and other_shape == shape:
                pairs[source] = target
    return pairs
