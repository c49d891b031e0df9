"""The splat of a built-in place: made once into the user's cache."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import SceneError
from nw_eval.files.cache import cache_dir
from nw_eval.scenes.digest import digest

if TYPE_CHECKING:
    from nw_eval.built_in.places.parts import Place
    from nw_eval.scenes.scene import Progress

# Raise it with every change that changes a Gaussian of any scene.
GENERATOR_VERSION = 4


@dataclass(frozen=True, kw_only=True)
class BuiltInSplat:
    """Gaussians generated from a place's textured geometry."""

    place: Place

    @property
    def key(self) -> str:
        """Hex digest of the place and of the generator's version."""
        return self._key

    @cached_property
    def _key(self) -> str:
        return digest(GENERATOR_VERSION, self.place)

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store; build it in the cache on first use."""
        from nw_eval.splat.store import FORMAT, SUFFIX, compile_store, open_store

        # Versions of nw-eval that share a cache do not undo each other's.
        name = f"{self.place.name.replace('/', '-')}-{self.key[:16]}-{FORMAT}"
        path = cache_dir("scenes") / f"{name}{SUFFIX}"
        if path.is_file():
            try:
                open_store(path, key=self.key)
            except SceneError:
                pass  # Damaged: made anew below.
            else:
                return path
        from nw_eval.built_in.bake.generate import generate

        compile_store(generate(self.place, progress), path, key=self.key)
        if progress is not None:
            progress("stored", 1.0)
        return path
