"""`nw-eval warmup`: compile the kernels and build the scenes ahead of the first run."""

from __future__ import annotations

from dataclasses import dataclass

import tyro


@dataclass(frozen=True, kw_only=True)
class Warmup:
    """Compile the rendering kernels into the cache, and build the splats of the named scenes."""

    scenes: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names or globs of scenes to build as well."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.progress import RunProgress

        with RunProgress() as listener:
            done = api.warmup(self.scenes, listener=listener)
            built = f", {len(done.scenes)} scenes built" if done.scenes else ""
            print(f"kernels ready after {done.kernel_seconds:.1f} s{built}")
        return 0
