"""`nw-eval twin ablate`: what mesh and depths are worth to a splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from nw_eval.cli.verbs.twin.options import SplatFlags, settings_of


@dataclass(frozen=True, kw_only=True)
class AblateSplat(SplatFlags):
    """Train the splat four times, to compare: from points or the mesh, without or with depths.

    The scene's own splat stays as it is. A training that was cut off goes on.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder, with a mesh in its `build/`."""
    threads: int | None = None
    """That share the work; one for each core when absent. They change no result."""

    def __call__(self) -> int:
        from nw_eval.twin.building.ablation import ablate, table_text, write_table
        from nw_eval.twin.building.folder import BuildFolder

        settings = settings_of(self, self.threads)
        folder = BuildFolder(self.scene)
        say = lambda line: print(line, flush=True)  # noqa: E731
        outcomes = ablate(folder, settings.splat, say, threads=settings.threads)
        print(table_text(outcomes))
        print(f"table: {write_table(folder.path / 'ablation', outcomes)}")
        return 0
