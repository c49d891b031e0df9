"""`nw-eval doctor`: what this machine offers."""

from __future__ import annotations

import json as jsons
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from nw_base.plural import in_words, plural
from nw_eval.cli.terminal.lines import aligned

if TYPE_CHECKING:
    from nw_eval.api.doctor import Checkup


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Show system information for bug reports.

    Shows versions, the sandbox of policies, cores, memory, the cache, kernels, GPUs and installed
    extras. Exit code 4 if something that nw-eval needs is missing or broken, else 0.
    """

    json: bool = False
    """Print JSON."""

    def __call__(self) -> int:
        from nw_eval.api.doctor import check_up

        checkup = check_up()
        print(jsons.dumps(asdict(checkup), indent=2) if self.json else checkup_page(checkup))
        return checkup.exit_code


def checkup_page(checkup: Checkup) -> str:
    """Return what a machine offers as lines of text."""
    from nw_eval.api.doctor import USES

    versions = dict(checkup.versions)
    own = [f"nw-eval {versions.pop('nw-eval')}", f"Python {versions.pop('python')}"]
    rows = [
        ("version", ", ".join([*own, versions.pop("system")])),
        ("libraries", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("fence", str(checkup.fence["meaning"])),
    ]
    if cpu := checkup.processor:
        cores = f"{cpu['usable']} usable ({cpu['affinity']} by affinity, {cpu['installed']} there)"
        rows += [("processor", f"{cpu['name']} ({cpu['kind']})"), ("cores", cores)]
    if memory := checkup.memory:
        limit = memory["limit"]
        free, there = (in_words(memory[key] or 0) for key in ("available", "installed"))
        limited = "" if limit is None else f", limited to {in_words(limit)}"
        rows.append(("memory", f"{free} of {there} free{limited}"))
    if "bytes" in (cache := checkup.cache):
        space = f"{in_words(int(cache['bytes']))}, {in_words(int(cache['free']))} free on its disk"
        rows.append(("cache", f"{cache['folder']}: {space}"))
    compiled = f"compiled: {', '.join(checkup.kernels)}" if checkup.kernels else "not compiled"
    rows.append(("kernels", compiled))
    rows.append(("GPU", ", ".join(checkup.gpus) or "none seen; only `run --render cuda` uses one"))
    installed = [extra for extra, unmet in checkup.extras.items() if not unmet]
    rows.append(("extras", ", ".join(installed) or ("none" if checkup.extras else "unknown")))
    rows += [
        ("  missing", f"{extra}: {USES[extra]} (needs {', '.join(unmet)})")
        for extra, unmet in checkup.extras.items()
        if unmet
    ]
    rows += [("warning", words) for words in checkup.warnings]
    rows += [("PROBLEM", words) for words in checkup.problems]
    if checkup.problems:
        rows.append(("", f"{plural(len(checkup.problems), 'problem')}: runs may fail"))
    return "\n".join(aligned(rows))
