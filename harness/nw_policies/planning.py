"""Plans networks where their files are read: in the policy's process, or in this one."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from nw_base.clean import clean
from nw_base.errors import NwEvalError
from nw_policies.bundle import PlannedFile
from nw_policies.cards.feeding import InputSpec
from nw_policies.drawing import DrawingPolicy
from nw_policies.executor import RecordedFile, UnsupportedError
from nw_policies.fed_policy import FedPolicy
from nw_policies.planned import unsupported
from nw_policies.policy import Observation, Policy


@runtime_checkable
class Recordable(Protocol):
    """A network that can be recorded as a graph."""

    where: str
    inputs: tuple[InputSpec, ...]

    def recorded(self, observation: Observation) -> RecordedFile:
        """Return the graphs for observations of these sizes.

        Raises:
            UnsupportedError: it has an operator, or a use of one, that a graph cannot have; named.
        """
        ...


def plan_policy(policy: Any, shown: Observation) -> dict[str, PlannedFile]:
    """Return the plans of an open policy, and of the networks that feed it, by their names.

    Args:
        policy: which its own runtime runs.
        shown: observations of the sizes and types that it will be shown.

    Raises:
        PolicyError: it has an operator that nw-eval does not run.
    """
    arrays = dict(shown)
    own = policy.policy if isinstance(policy, DrawingPolicy) else policy
    files: dict[str, PlannedFile] = {}
    if isinstance(own, FedPolicy):
        for feeder in own.feeders:
            files[feeder.name] = _planned(feeder.network, arrays)
            arrays |= feeder.named(feeder.network.run(arrays))
        own = own.policy
    files[""] = _planned(own, arrays)
    return files


def _planned(network: Any, shown: Observation) -> PlannedFile:
    from nw_policies.executor.plan import plan

    network = getattr(network, "network", network)
    if not isinstance(network, Recordable):
        raise TypeError(type(network).__name__)
    try:
        recorded = network.recorded(shown)
        parts = tuple((every, plan(graph)) for every, graph in recorded.parts)
    except UnsupportedError as error:
        raise unsupported(network.where, error) from None
    except NwEvalError:
        raise
    except Exception as error:  # noqa: BLE001 - torch raises anything for what does not fit.
        lines = clean(error).strip().splitlines() or [type(error).__name__]
        reason = UnsupportedError(f"a network that fails as it is recorded: {lines[-1]}")
        raise unsupported(network.where, reason) from None
    return PlannedFile(inputs=network.inputs, parts=parts, first=recorded.first)


class InProcess:
    """A policy that its own runtime runs in this process, and that can be planned."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def __getattr__(self, name: str) -> Any:
        return getattr(self.policy, name)

    def planned(self, shown: Observation) -> dict[str, PlannedFile]:
        """As `OpenPolicy`."""
        return plan_policy(self.policy, shown)
