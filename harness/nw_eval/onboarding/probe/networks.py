"""What the networks gave that feed a policy, and if they hear what they are given."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nw_eval.cards import Card
from nw_eval.onboarding.probe.findings import Finding
from nw_eval.onboarding.probe.recording import Recording


def network_rows(card: Card, recording: Recording) -> list[tuple[str, ...]]:
    """Return a row for each output of each network, with a heading; none without networks."""
    rows: list[tuple[str, ...]] = []
    for name, output in _outputs(card):
        values = recording.fed[output].reshape(len(recording.actions), -1).astype(np.float64)
        constant = int((values == values[:1]).all(axis=0).sum())
        rate = card.networks[name].rate or card.control.rate
        rows.append(
            (
                name,
                output,
                f"{values.shape[1]}",
                f"{rate} Hz",
                f"{values.min():z.3f}",
                f"{values.mean():z.3f}",
                f"{values.max():z.3f}",
                f"{constant} of {values.shape[1]}" if constant else "",
            )
        )
    heading = ("network", "gives", "numbers", "asked", "min", "mean", "max", "constant")
    return [heading, *rows] if rows else []


def network_findings(card: Card, recording: Recording) -> list[Finding]:
    """Return which networks do not hear what they are given."""
    found: list[Finding] = []
    for name, output in _outputs(card):
        values = recording.fed[output]
        if len(values) > 1 and (values == values[:1]).all():
            text = f"network `{name}`: `{output}` is the same at every step: "
            found.append(Finding(kind="fault", text=f"{text}it does not hear its inputs"))
    return found


def _outputs(card: Card) -> Iterator[tuple[str, str]]:
    """Yield every output of a network after the name of the network."""
    for name, network in card.networks.items():
        for output in network.given_as(name):
            yield name, output
