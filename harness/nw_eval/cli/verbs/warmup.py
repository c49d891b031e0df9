"""`nw-eval warmup`: compile the kernels and build the scenes ahead of the first run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import WarmUp


@verb_of("warmup", listens=True)
class Warmup(Verb):
    """Compile the rendering kernels into the cache and build the splats of the given scenes."""

    def show(self, result: WarmUp) -> str:
        built = f", {len(result.scenes)} scenes built" if result.scenes else ""
        return f"kernels ready after {result.kernel_seconds:.1f} s{built}"
