"""The verbs in their groups, with a line, a page of the docs and examples; and names that changed.

`nw-eval --help` is this table and those of packages, which the entry-point group `nw_eval.verbs`
names. No verb is imported for it.
"""

from __future__ import annotations

import os
from pathlib import Path

from nw_base.verb import Verb, add_verbs, declared

_CHECKOUT = Path(__file__).parents[4]
"""The folder of pyproject.toml, where this is no installed package."""


_TABLE = """
Evaluate:
  run Run reference/suite.md evaluate a checkpoint on a suite and give a verdict
    $ hurdles --policy ./my-policy
    $ smoke --policy ./my-policy --trials 2
  check Check reference/suite.md validate a suite and show what it would run
    $ hurdles --policy ./my-policy
  plan PlanTrials concepts/power.md compute how many trials detect a drop, or list shards
    $ hurdles --detect 0.1
    $ hurdles --shards 4 --json
  suites Suites reference/suite.md list the named suites
    $
  watch Watch how-to/watch.md evaluate the checkpoints of a training as they appear
    $ logs/go2 --suite hurdles --policy my-policy/policy.yaml
  bisect BisectSeries concepts/baseline.md find the first checkpoint of a series that got worse
    $ hurdles logs/go2 --good model_100.pt --bad model_900.pt -p ./my-policy
  merge MergeRuns how-to/sharded-suites.md merge the shards of a run and give a verdict
    $ part-1 part-2 --out whole
Judge:
  gate GateRun concepts/verdict.md judge a finished run by its bar and a baseline
    $ reports/my-run --baseline go1-parkour
  baseline - concepts/baseline.md save, list, show, check, verify or compare baselines
    save Save hurdles-state --policy go1-parkour
    list List
    show Show hurdles/go1-act-rgb
    check Check hurdles/go1-act-rgb
    verify Verify hurdles/go1-act-rgb --trials 10%
    diff Diff old.parquet new.parquet
  report Report how-to/leaderboard.md write the report of a run, or a page over many runs
    $ reports/my-run --open
    $ reports/hurdles-* --site site
  compare Compare how-to/compare.md compare policies scene by scene
    $ reports/my-run reports/another-run --out compared.md
  sim2real SimToReal how-to/compare.md compare simulated results with real-robot results
    $ real.csv reports/my-run reports/another-run
  verify Verify concepts/determinism.md check a run for changes and re-run some trials
    $ reports/my-run --trials 5%
  ledger Ledger concepts/verdict.md summarize a ledger: false alarms, repeated tests
    $ verdicts.jsonl
Look:
  view ViewTrials how-to/viewing.md open a trial or a live policy in the browser
    $ reports/my-run
    $ go1-parkour --scene hurdles/one_low_carpet
  replay Replay how-to/replay.md re-run a recorded trial, film it, or show its log
    $ trial.mcap
    $ trial.mcap --video trial.mp4
  attribute Attribute how-to/failures.md find when and why failed trials became unrecoverable
    $ reports/my-run --baseline go1-parkour
  scores Scores reference/scores.md compute scores from the log of a trial or of a robot
    $ trial.mcap
    $ walk.mcap --robot go1
  sensors Sensors reference/sensors.md draw what a policy's sensors see
    $ go1-act-rgb --out seen.png
Stress:
  limits Limits how-to/ladders.md find the hardest obstacle that a policy completes, with bounds
    $ -p ./my-policy
    $ hurdles/bar 'stairs/*' -p ./my-policy --baseline go1-parkour
  sweep SweepAxes how-to/perturbations.md evaluate a suite over friction, payload, latency ...
    $ hurdles --axis friction=0.3..1.2 --policy ./my-policy
Bring your own:
  policies - how-to/policy-card.md list, show, check, draft, fetch or serve policies
    list List
    show Show go1-parkour
    check Check ./my-policy
    init Init model_1500.pt --robot go1
    fold Fold policy.onnx --out one.onnx
    serve Serve ./my-policy --port 8765
    fetch FetchPolicy hub:org/trot
  robots - how-to/robot.md list, show, check, draft or fetch robots
    list List
    show Show go1
    init Init my-robot/robot.urdf
    check Check ./my-robot
    fetch Fetch menagerie:unitree_a1
  scenes - how-to/scene.md list, show, check, draw, import, fetch or push scenes
    list List 'hurdles/*'
    ladders Ladders hurdles/bar
    show Show hurdles/one_low_carpet
    check Check ./my-place --out suite.yaml
    render Render 'hurdles/*' --out scenes.png
    fetch FetchScenes hub:org/corridor
    push PushScene ./my-place hub:org/my-place
  splat - reference/meshes-and-splats.md inspect, convert or render Gaussian-splat files
    info Info scan.ply
    convert Convert scan.ply --out scan.spz
    render Render scan.ply --out scan.png
  schema Schema reference/suite.md write the JSON Schema of suites, cards and scenes for editors
    $ suite --out suite.schema.json
Train:
Upkeep:
  doctor Doctor reference/stability.md show system information for bug reports
    $
    $ --json
  cache - concepts/determinism.md show, prune or verify the cache of trial results
    info ShowCache
    prune PruneCache --limit 2
    verify VerifyCache
  warmup Warmup reference/environment.md compile kernels and build scenes before the first run
    $ 'hurdles/*'
  completion Completion reference/stability.md print a shell-completion script
    $ bash
"""
"""Groups; in them verbs: name, class, page, line; in these their examples, or verbs of the family:
name, class, example."""


_groups: dict[str, dict[str, Verb]] = {}

add_verbs(_groups, _TABLE, __name__.removesuffix(".table"))
_OTHERS = tuple(declared())
for _others in _OTHERS:
    add_verbs(_groups, _others.table, _others.module)
GROUPS = {title: verbs for title, verbs in _groups.items() if verbs}
"""Verbs by the title of their group, with those of packages that are installed."""
VERBS = {name: verb for group in GROUPS.values() for name, verb in group.items()}

OF_EXTRAS = {
    **dict.fromkeys(("twin", "scenes import", "scenes level"), "twin"),
    **dict.fromkeys(("train", "study"), "learn"),
}
"""Commands of packages that come with an extra, to say so where they are absent."""

_EXAMPLES = (
    "nw-eval run hurdles --policy ./my-policy        a verdict on a checkpoint",
    "nw-eval gate reports/my-run --baseline mine     the same with a baseline",
    "nw-eval view reports/my-run                     its trials in the browser",
    "nw-eval sweep hurdles --axis friction=0.3..1.2  where the policy fails",
    "nw-eval policies init model.pt --robot go1      draft a policy card",
    "nw-eval train student student-rgb-small         a policy of your own",
    "nw-eval doctor                                  system information",
)
EXAMPLES = tuple(each for each in _EXAMPLES if each.split()[1] in VERBS)
"""One for each group."""


def docs_line(page: str = "") -> list[str]:
    """Return the line of a help page that says where a page of the docs is; none if it is unknown.

    That is below the address `Documentation` of the package's metadata, or else a file of the
    checkout that this is run from.

    Args:
        page: as the table has it; empty = all of them.
    """
    from importlib.metadata import PackageNotFoundError, metadata

    try:
        urls = metadata("nw-eval").get_all("Project-URL") or []
    except PackageNotFoundError:
        urls = []
    for name, _, address in (each.partition(", ") for each in urls):
        if name == "Documentation":
            return [f"Docs: {address.rstrip('/')}/{page.removesuffix('.md')}"]
    file = _CHECKOUT / "docs" / page
    if not (_CHECKOUT / "pyproject.toml").is_file() or not file.exists():
        return []
    inside = file.is_relative_to(Path.cwd())
    return [f"Docs: {os.path.relpath(file) if inside else file}"]


EXIT_CODES = """Exit codes: 0 PASS, or RAN if the suite has no bar; 1 REGRESSED; 2 wrong usage
or file; 3 INCONCLUSIVE; 4 infrastructure error; 5 invalid comparison; 130
interrupted."""

RENAMED = {"agree": "sim2real", "blame": "attribute"}
"""Verbs by their names until 0.1, which are understood for one release."""

RENAMED_FLAGS: dict[str, dict[str, str]] = {
    "run": {"--panel": "--seed-set"},
    "check": {"--panel": "--seed-set"},
    "plan": {"--png": "--out"},
    "watch": {"--card": "--policy"},
    "bisect": {"--starts": "--baseline-trials"},
    "sweep": {"--against": "--baseline"},
    "view": {"--against": "--baseline"},
    "attribute": {"--at-most": "--trials"},
    "verify": {"--sample": "--trials"},
    "baseline save": {"--starts": "--trials", "--from": "--run"},
    "baseline verify": {"--share": "--trials"},
    "scenes check": {"--suite": "--out"},
}
"""The same for options of verbs."""
OUT_WAS_POSITIONAL = {"splat convert"}
"""Verbs that took what --out names as their last argument."""

OPTION_GROUPS: dict[str, tuple[str, ...]] = {
    "Policy and robot": ("policy", "robot", "checkpoint", "allow_code"),
    "Trials": (
        *("trials", "scenes", "seed", "panel", "shard", "resume", "all_rounds", "time_limit"),
        *("memory_limit", "collision", "render"),
    ),
    "Comparison": (
        *("baseline", "baseline_policy", "baseline_trials", "recheck", "max_drop", "tolerate"),
        "confidence",
    ),
    "Machine": ("workers", "engine", "address", "in_process", "no_cache"),
    "Output": (
        *("out", "record", "ledger", "json", "junit", "comment", "github", "no_github"),
        *("track", "reporter", "label"),
    ),
    "Scene": ("trail", "task"),
    "Name and licence": ("name", "note", "licence"),
}
"""Titles under which `--help` lists the options of a verb that has many, by field."""
TITLES_OF_PACKAGES: dict[str, str] = {}
"""Packages by the titles that they add; such a title is for options of the package's own verbs."""

for _others in _OTHERS:
    RENAMED_FLAGS.update(_others.renamed_flags)
    OUT_WAS_POSITIONAL.update(_others.out_was_positional)
    OPTION_GROUPS.update(_others.option_groups)
    TITLES_OF_PACKAGES.update(dict.fromkeys(_others.option_groups, _others.module))
