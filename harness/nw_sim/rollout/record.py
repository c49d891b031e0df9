"""What a log says about its trial in text: enough to run it again, and to compare the ends."""

from __future__ import annotations

import json
import math
import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from nw_base import __version__
from nw_base.clean import clean, without_credentials
from nw_base.trials import MAX_TRIALS, Trial
from nw_policies.executor import IDENTITY as NETWORKS
from nw_scenes.ray_tree import IDENTITY as RAYS
from nw_sim.catalogue import parse_reference
from nw_sim.rendering import PUBLISHED
from nw_sim.rollout.job import TrialJob, as_outcome, policy_fault
from nw_sim.tasks import COURSE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_sim.rollout.job import TrialResult

TRIAL, PROVENANCE, VERDICT = "nw.trial", "nw.provenance", "nw.verdict"

_LONGEST = 600.0  # s; as `suite.model.EpisodeRules` allows

# Whose versions change bits. A replay under others is refused a verdict on its bits.
_LIBRARIES = ("mujoco", "numpy", "onnxruntime", "torch", "numba")
_RUNTIMES = ("onnxruntime", "torch")
# Fields of a job that say how it was run, where to, and what its caller allowed, not what it is. A
# log may be untrusted: none of them is written, and none is believed.
_CIRCUMSTANCE = frozenset({"allow_code", "attachments", "mcap", "record", "time_limit"})
# In which round a trial is due is its run's affair: a log is the same in whichever it was.
_OF_TRIALS = tuple(name for name in Trial.__dataclass_fields__ if name != "place")


@cache
def provenance(*, is_planned: bool) -> Mapping[str, str]:
    """Return versions and architecture, without importing anything heavy.

    Args:
        is_planned: whether nw-eval runs the policy's networks: then no other runtime counts.
    """
    facts = {"nw-eval": __version__, "architecture": platform.machine(), "rays": RAYS}
    for name in _LIBRARIES:
        with suppress(PackageNotFoundError):
            facts[name] = version(name)
    if is_planned:
        facts = {name: value for name, value in facts.items() if name not in _RUNTIMES}
        facts["networks"] = NETWORKS
    return MappingProxyType(facts)


def trial_metadata(job: TrialJob) -> dict[str, str]:
    """Return the job as texts: the readable keys, and `job` with all of it as JSON."""
    trial = job.trial
    fields = _kept(vars(job))
    for name in ("checkpoint", "robot_folder"):
        fields[name] = None if fields[name] is None else str(fields[name])
    # What is not used is left out: such a log is as it was before there was a choice.
    del fields["task"], fields["rendering"]
    if job.task != COURSE:
        fields["task"] = job.task.model_dump()
    if job.rendering != PUBLISHED:
        fields["rendering"] = job.rendering.model_dump()
    for name in ("scores", "operator"):
        if not fields[name]:
            del fields[name]
    fields["trial"] = {name: getattr(trial, name) for name in _OF_TRIALS}
    return {
        "trial": trial.id,
        "suite": trial.suite,
        "scene": trial.scene,
        "task": trial.task,
        "index": str(trial.index),
        "seed": str(trial.seed),
        "policy": job.policy_name or job.policy,
        "job": json.dumps(fields, sort_keys=True),
    }


def job_from_metadata(metadata: Mapping[str, str]) -> TrialJob:
    """Return the job of `trial_metadata`: with no log, and no leave to run code.

    Raises:
        ValueError: the metadata is damaged or of another version.
    """
    try:
        fields = _kept(json.loads(metadata["job"]))
        scene = fields.get("scene")
        if isinstance(scene, str) and "collision" not in fields:  # Older logs say it before it.
            fields["scene"], fields["collision"] = parse_reference(scene)
        job = _form().validate_python(fields)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "job"
        reason = clean(f"{place}: {first['msg'].lower()}", at_most=200)
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = clean(repr(error), at_most=200)
    else:
        reason = _fault(job)
        if reason is None:
            return job
    raise ValueError(f"its metadata {TRIAL!r} is damaged: {reason}")


@cache
def _form() -> TypeAdapter[TrialJob]:
    """Return the reader of jobs: making it takes longer than reading hundreds."""
    return TypeAdapter(TrialJob)


def _fault(job: TrialJob) -> str | None:
    """Return which number of a job no suite could have given, or None."""
    trial = job.trial
    if not 0.0 < job.duration <= _LONGEST:
        return f"duration: {job.duration} s is not between 0 and {_LONGEST:g}"
    if not 0 <= trial.index < MAX_TRIALS:
        return f"trial.index: {clean(trial.index, at_most=30)} is not between 0 and {MAX_TRIALS}"
    if not 0 <= trial.suite_seed < 2**63:
        return f"trial.suite_seed: {clean(trial.suite_seed, at_most=30)} does not fit 63 bits"
    for axis, value in trial.perturbation:
        if not math.isfinite(value):
            return f"trial.perturbation: {clean(axis, at_most=30)} is {value}"
    return None


def _kept(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in _CIRCUMSTANCE}


def verdict_metadata(result: TrialResult) -> dict[str, str]:
    """Return a result as texts, without anything that a second run would measure anew.

    A log tells of one attempt: a policy's own failure is its outcome, the first time too.
    """
    if policy_fault(result) is not None:
        result = as_outcome(result)
    return {
        "status": result.status,
        "outcome": result.outcome or "",
        "end_reason": result.end_reason,
        "error_type": result.error_type or "",
        "error_text": clean(result.error_text),
        "waypoints_reached": str(result.waypoints_reached),
        "waypoints_total": str(result.waypoints_total),
        "steps": str(result.steps),
        **({"control_rate": repr(result.control_rate)} if result.control_rate != 50 else {}),
        **({"scores": json.dumps(dict(result.scores))} if result.scores else {}),
        "state_digest": result.state_digest,
        "action_digest": result.action_digest,
    }


def attachments(card_text: str, suite_text: str) -> tuple[tuple[str, str], ...]:
    """Return what every log of a run carries along: the resolved suite and the policy's card."""
    return ("suite.yaml", suite_text), ("policy.yaml", without_credentials(card_text))
