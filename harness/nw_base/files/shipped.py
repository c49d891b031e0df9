"""Where the suites, policies and baselines of nw-eval lie: in the wheel or the checkout."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

Kind = Literal["suites", "policies"]


def shipped(kind: Kind | Literal["baselines"]) -> Path:
    """Return the folder of the shipped suites, policies, or baselines.

    An installed wheel carries them as `nw_eval/data/<kind>`. An editable install has no such
    folder: there they are `<kind>/` at the root of the checkout, and the baselines where every
    project has its own. The folder may be missing where neither was packed; callers then find
    nothing in it.
    """
    root = Path(__file__).resolve().parents[2]  # All packages lie side by side.
    packed = root / "nw_eval" / "data" / kind
    if packed.is_dir():
        return packed
    return root.parent / "reports" / kind if kind == "baselines" else root.parent / kind


def available(kind: Kind, search: Path | None = None) -> dict[str, Path]:
    """Return every suite (its file) or policy (its folder) that can be asked for by name.

    Args:
        kind: `suites` are `<name>.yaml`, `policies` are folders with a `policy.yaml`.
        search: a project folder whose own `<kind>/` comes first, by default the working directory.

    Returns:
        Names in alphabetical order with their paths. A project's own entry hides a shipped one.
    """
    paths: dict[str, Path] = {}
    for folder in (shipped(kind), (search or Path.cwd()) / kind):
        if kind == "suites":
            paths |= {path.stem: path for path in folder.glob("*.yaml")}
        else:
            paths |= {path.parent.name: path.parent for path in folder.glob("*/policy.yaml")}
    return dict(sorted(paths.items()))
