"""What computes the results of a run, and whose policy it is: it tells machine types apart."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.plugins import code_named, version_named
from nw_base.words import Backend
from nw_eval.engine.machine import cpu_kind
from nw_gate.results.provenance import (
    FetchedInfo,
    PolicyInfo,
    library_versions,
    rows_code_digest,
)
from nw_policies.bundle import senses_by_code
from nw_policies.executor import IDENTITY
from nw_policies.planned import depends_on
from nw_scenes.ray_tree import IDENTITY as RAYS

if TYPE_CHECKING:
    from nw_policies import Bundle
    from nw_policies.cards import Card

_CHANGING_BITS = ("mujoco", "numpy", "onnxruntime", "torch", "numba")
"""Libraries whose versions make bits differ between runs of the same trials."""


_OF_NATIVE = ("onnxruntime", "torch", "cpu")
"""What says nothing where nw-eval runs the networks."""


def engine_of(
    render: Backend, plugins: Iterable[str] = (), card: Card | None = None
) -> dict[str, str]:
    """Return what makes bits differ between runs of the same trials.

    ONNX Runtime, torch and the kind of processor do, unless nw-eval runs all networks of a card:
    then results are of one kind on an architecture, for which MuJoCo is built.

    Args:
        render: the splat renderer.
        plugins: what packages bring along, as `Suite.plugins` names it. Their code counts beside
            their version, which may not tell it apart.
        card: of the policy; None = of any.
    """
    versions = library_versions()
    found = {
        **{name: versions[name] for name in _CHANGING_BITS if name in versions},
        "renderer": renderer_name(render),
        "rays": RAYS,
        "cpu": cpu_kind(),
        "code": rows_code_digest()[:16],
        **{key: f"{version_named(key)} {code_named(key)[:16]}" for key in plugins},
    }
    if card is None or senses_by_code(card) or not (card.is_planned or card.adapter == "zero"):
        return found
    for name in _OF_NATIVE:
        found.pop(name, None)
    return {**found, "networks": IDENTITY, "architecture": platform.machine()}


def policy_info(bundle: Bundle) -> PolicyInfo:
    """Return what run.json says of a policy."""
    return PolicyInfo(
        name=bundle.name,
        adapter=bundle.card.adapter,
        card_digest=bundle.digest,
        checkpoint_digest=bundle.checkpoint_digest,
        computes=bundle.computes,
        card="" if bundle.card_path is None else bundle.reference,
        origin="" if bundle.checkpoint is not None else bundle.origin,
        depends_on=depends_on(bundle),
        fetched=None if bundle.card_path is None else fetched_info(bundle.card_path),
    )


def fetched_info(path: Path) -> FetchedInfo | None:
    """Return what a policy, a scene or a robot was fetched as, if it was."""
    from nw_scenes.hub.reference import origin_of

    origin = origin_of(path)
    if origin is None:
        return None
    return FetchedInfo(
        reference=origin.reference, revision=origin.revision, files=dict(origin.files)
    )


def renderer_name(render: Backend) -> str:
    """Return what run.json calls a splat renderer."""
    return f"{render} gsplat-1.5"
