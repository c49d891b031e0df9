"""What `nw-eval` can do with this package: twins of photographs, and scenes of scans."""

from __future__ import annotations

from nw_base.verb import VerbTable

_TABLE = """
Bring your own:
  scenes
    import ImportScan scan.glb --out my-hall
    level LevelScene my-hall --flip
  twin - how-to/twins.md build a scene from photographs
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


VERBS = VerbTable(
    table=_TABLE,
    module=__name__,
    renamed_flags={f"twin {part}": _WORKERS for part in _PARTS},
    option_groups=_OPTIONS,
)
