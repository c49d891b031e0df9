"""The vocabulary: every list of words that rooms share, each defined once."""

from __future__ import annotations

from typing import Literal, get_args

Task = Literal["hurdles", "gaps", "ramps", "stairs", "open"]
"""What a scene asks for; `open` ground asks for nothing."""

Tier = Literal["critical", "supporting", "informational"]
"""How much a scene counts for the verdict: alone, in the mean, or not at all."""

Protocol = Literal["strict", "neverwhere-2026"]
"""How a trial is run: `neverwhere-2026` is the published evaluation, bug for bug."""

Record = Literal["all", "failures", "none", "summary"]
"""Trials whose camera images are kept in their logs; states and events always are."""

Backend = Literal["cpu", "cuda"]
"""What draws splats."""

Projection = Literal["ewa", "ray"]
"""How Gaussians become pixels: by EWA's affine approximation, or along each pixel's own ray."""
PROJECTIONS: tuple[Projection, ...] = get_args(Projection)

Kernels = Literal["ewa", "ray", "lens", "networks", "rays"]
"""What the CPU's kernels are compiled for, each for itself: either projection of a pinhole, lenses
that bend, the networks of policies, and rays that meet triangles."""
KERNELS: tuple[Kernels, ...] = get_args(Kernels)
SPLAT_KERNELS: tuple[Kernels, ...] = ("ewa", "ray", "lens")
"""Of them those that draw pictures of splats."""
BLIND: tuple[Kernels, ...] = ("networks", "rays")
"""Those of trials that draw nothing."""

Engine = Literal["local", "ray"]
"""Where trials run: in processes of this machine, or on the nodes of a Ray cluster."""

Collision = Literal["terrain", "triangles"]
"""How scan meshes collide: as height fields and boxes, fast, or by their own triangles."""

Viewer = Literal["foxglove", "rerun"]
"""A program that shows logs; Lichtblick reads what Foxglove does."""

Tracker = Literal["wandb", "mlflow", "tensorboard"]
"""Trackers of experiments that can show a run, each by the name of its library and extra."""

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
"""Which way is up in a splat's frame; trainers leave it at -y, aligned scenes have +z."""

Described = Literal["suite", "policy", "scene", "collision", "ladder"]
"""Files that people write and a JSON Schema describes; `collision` is a scene's file of boxes."""

PanelKind = Literal["pinned", "fresh"]
"""Which starts a checkpoint meets: those that the suite's seed names, or its own."""

Arm = Literal["candidate", "baseline"]
"""Whether a trial's policy is the one that is judged, or one that it is compared with."""

Status = Literal["ok", "error"]
"""Whether a trial came to a result."""

Outcome = Literal[
    "completed", "fell", "collided", "stuck", "off_course", "timeout", "policy_failed"
]
"""How a trial that ran can end. `policy_failed`: the policy itself failed, twice in one way."""

PolicyFault = Literal["exception", "action", "diverged", "exit"]
"""How a policy itself fails: its code raised; its action is not finite numbers, or huge; the
physics diverged under what it told the motors; its process ended by itself in mid-trial."""

Fault = Literal["policy_error", "physics_error", "crashed", "hung"]
"""How a trial can fail to come to a result: never counted as a failure of the policy."""

ROBOTS = ("go1", "go2")
"""Of the published scenes, and as `robots.BUILT_IN`, which a test compares."""
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
POLICY_FAULTS: tuple[PolicyFault, ...] = get_args(PolicyFault)
FAULTS: tuple[Fault, ...] = get_args(Fault)

RasterizeMode = Literal["classic", "antialiased"]
"""What Gaussians were trained for, in gsplat's words: `antialiased` compensates opacity for the
blur of small ones, `classic` does not."""
RASTERIZE_MODES: tuple[RasterizeMode, ...] = get_args(RasterizeMode)
