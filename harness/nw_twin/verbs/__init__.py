"""What `nw-eval` can do with this package: twins of photographs, and scenes of scans."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.cli.verbs.verb import VerbTable

    VERBS: VerbTable

_TABLE = """
Bring your own:
  scenes
    import ImportScan scan.glb --out my-hall
    level LevelScene my-hall --flip
  twin - how-to/twins.md make a scene of photographs
    build BuildTwin photographs/ --out corridor --tag-edge 0.16
    calibrate Calibrate photographs/ --out corridor
    reconstruct Reconstruct corridor
    align Align corridor --tag-edge 0.16
    splat TrainSplat corridor
    place PlaceScene corridor
    ablate AblateSplat corridor
    label LabelScene corridor --open
"""

_OPTIONS: dict[str, tuple[str, ...]] = {
    "Cameras": (
        *("matching", "frames", "per_second", "lens", "share", "features", "side"),
        "megapixels",
    ),
    "Mesh": ("mesher", "depth_side", "faces", "unit", "up"),
    "Scale": ("tag_edge", "camera_height", "length", "metric"),
    "Elevation map": ("cell", "white", "black", "no_data"),
    "Gaussians": ("iterations", "gaussians", "longest", "held_out", "splat", "splat_transform"),
}

_WORKERS = {"--threads": "--workers"}
_PARTS = ("build", "calibrate", "reconstruct", "align", "splat", "place", "ablate", "label")


def __getattr__(name: str) -> Any:
    """Return `VERBS`, which the entry-point group `nw_eval.verbs` names.

    It is made when it is asked for: `nw_eval.cli.verbs`, whose class it is of, asks for it while it
    is imported itself, and could not where this module had begun that import.

    Raises:
        AttributeError: there is no such name.
    """
    if name != "VERBS":
        raise AttributeError(name)
    from nw_eval.cli.verbs.verb import VerbTable

    return VerbTable(
        table=_TABLE,
        module=__name__,
        renamed_flags={f"twin {part}": _WORKERS for part in _PARTS},
        option_groups=_OPTIONS,
    )
