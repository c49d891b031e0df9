"""What the networks gave that feed a policy, and if they hear what they are given."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nw_eval.cards import Card
from nw_eval.onboarding.probe.findings import Finding
from nw_eval.onboarding.probe.recording import Recording
from nw_eval.onboarding.probe.rows import ProbedOutput


def network_rows(card: Card, recording: Recording) -> tuple[ProbedOutput, ...]:
    """Return what each output of each network gave."""
    found: list[ProbedOutput] = []
    for name, output in _outputs(card):
        values = recording.fed[output].reshape(len(recording.actions), -1).astype(np.float64)
        found.append(
            ProbedOutput(
                network=name,
                output=output,
                numbers=values.shape[1],
                rate=card.networks[name].rate or card.control.rate,
                low=float(values.min()),
                mean=float(values.mean()),
                high=float(values.max()),
                constant=int((values == values[:1]).all(axis=0).sum()),
            )
        )
    return tuple(found)


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
