"""The commands of the README and of docs/ do what they are there for.

Each page is followed from top to bottom in an empty folder: its files are written where their names
say, its commands run. What costs too much runs with fewer trials, or is listed with the reason.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import MappingProxyType

import onnx
import pytest
from onnx import TensorProto, helper

from nw_eval import cli
from nw_eval.cli.verbs import parse

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

_EXTENDING = ("robots", "tasks", "scores", "axes", "splat-formats", "reporters", "testing")
OWN_TESTS = {
    "docs/how-to/extending/sensors.md": "tests/sim/sensors/test_wrappers_page.py",
    "docs/tutorials/checkpoint-to-check.md": "tests/docs/test_tutorials.py",
    "docs/tutorials/your-own-robot.md": "tests/docs/test_tutorials.py",
    **{
        f"docs/how-to/extending/{name}.md": "tests/eval/extending/test_extending_page.py"
        for name in _EXTENDING
    },
}
"""Pages whose worked examples have tests of their own, with all that they print."""

BY_NIGHT = {
    *("docs/how-to/training.md", "docs/how-to/gate-limits.md", "docs/how-to/ladders.md"),
    *("docs/how-to/scene.md", "docs/how-to/leaderboard.md", "docs/concepts/power.md"),
}
"""Pages that take a quarter of a minute or more. By day their commands are read but not run. Tests
of tests/learn and tests/eval/api train, climb ladders, plan and publish by day too."""

_ONE_TRIAL = "--trials 1 --scenes hurdles/one_low_carpet --record none"
REDUCED = MappingProxyType(
    {
        "nw-eval run my-suite.yaml --out mine": _ONE_TRIAL,
        "nw-eval run smoke --policy ./my-trot --allow-code": _ONE_TRIAL,
        "nw-eval run my-scene.yaml --out my-run": "--record none",
        "nw-eval run smoke --policy policies/mine": _ONE_TRIAL,
        "nw-eval run smoke --policy go1-parkour --out board/parkour": _ONE_TRIAL,
        "nw-eval run smoke --out looked-at": _ONE_TRIAL,
        "nw-eval run smoke": _ONE_TRIAL,
        "nw-eval run smoke --policy stand --baseline none --out board/stand": _ONE_TRIAL,
        "nw-eval sweep smoke --axis friction=0.2,1.25 --trials 2 --out my-sweep": (
            "--trials 1 --scenes hurdles/one_low_carpet"
        ),
    }
)
"""Options that make a command cheap and leave it what it is."""

ENDS = MappingProxyType(
    {
        "nw-eval run my-suite.yaml --out mine": 3,  # One trial decides nothing.
        "nw-eval run ./steps.yaml --policy stand --baseline go1-parkour": 1,
    }
)
"""Exit codes of commands that do not end with 0."""

NOT_RUN = MappingProxyType(
    {
        "nw-eval watch logs/go2 --suite hurdles --policy my-policy/policy.yaml": (
            "till Ctrl-C; tests/eval/api/test_watching.py watches a training"
        ),
        "nw-eval bisect hurdles logs/go2 --policy my-policy/policy.yaml "
        "--good logs/go2/model_1500.pt --bad logs/go2/model_3000.pt": (
            "of a training of one's own; test_series.py searches some checkpoints"
        ),
        "nw-eval baseline save hurdles-state --policy go1-parkour": (
            "a thousand trials; test_baselines.py saves smaller ones"
        ),
        "nw-eval policies init my-dance/policy.onnx --robot ./g1": (
            "a policy of one's own; tests/policies/drafting/test_tracking_drafts.py drafts some"
        ),
        "nw-eval run hurdles --policy my-policy --track wandb": (
            "test_trackers.py and tests/eval/report/trackers track runs"
        ),
        **dict.fromkeys(
            [
                (
                    "nw-eval policies init go2_moe_cts_124k.pt --robot go2 --layout legged-gym "
                    "--out robogauge-moe.yaml"
                ),
                "nw-eval policies check ./robogauge-moe.yaml",
                (
                    "nw-eval limits stairs/up stairs/down hurdles/bar gaps/gap ramps/up ramps/down "
                    "-p ./robogauge-moe.yaml"
                ),
                "nw-eval limits stairs/up hurdles/bar ramps/up -p ./robogauge-moe.yaml --contacts",
            ],
            "of somebody's checkpoint; tests/policies drafts and checks others",
        ),
        "nw-eval run hurdles --engine ray": "starts a cluster; tests/eval/engine/ray runs on some",
        "nw-eval run hurdles --policy ./my-policy --engine ray --address auto": (
            "on a cluster; tests/eval/engine/ray does"
        ),
        "nw-eval sweep hurdles-state --axis friction=0.1..1.2:6 --axis payload=0..10:6 "
        "--axis latency=0..0.12:7 --baseline go1-act-depth --trials 12 "
        "--scenes hurdles/one_low_carpet hurdles/two_brick_dusk": (
            "minutes; the page runs a smaller one"
        ),
        "nw-eval report --site site runs/*": "in a workflow; the page does it with two runs",
        "nw-eval scores walk.mcap --robot go1": "a robot's log; tests/gate/scores has one",
        "make run": "minutes; CI does it on a fresh machine",
        **dict.fromkeys(
            [
                "nw-eval report reports/smoke-go1-parkour-* --open",
                (
                    "nw-eval replay reports/smoke-go1-parkour-*/mcap/hurdles/three_low/"
                    "hurdles-three_low-000.mcap --picture trial.png"
                ),
            ],
            "a shell's star; tests/reporting and tests/sim/rollout/replaying do",
        ),
        **dict.fromkeys(
            [
                (
                    "nw-eval watch checkpoints --suite suites/walk.yaml "
                    "--policy policies/walk/policy.yaml --trials 20 --once --out reports/ten"
                ),
                "nw-eval compare reports/ten/runs/*",
                (
                    "nw-eval run suites/walk.yaml --policy policies/walk --checkpoint "
                    "checkpoints/model_900.onnx --seed 2 --trials 20 --out reports/held-out"
                ),
                (
                    "nw-eval bisect suites/walk.yaml checkpoints --policy "
                    "policies/walk/policy.yaml --good checkpoints/model_900.onnx "
                    "--bad checkpoints/model_1000.onnx"
                ),
            ],
            "ten checkpoints, minutes; tests/eval/api watch, compare and search smaller series",
        ),
        "make test": "this is part of it",
        "nw-eval policies check ./my-policy": "test_readme.py does, with the card of the README",
        "nw-eval run hurdles --policy ./my-policy": "as `run smoke` of the same page, with a bar",
        **dict.fromkeys(
            [
                "nw-eval plan all-state --baseline go1-parkour",
                "nw-eval plan hurdles --baseline go1-act-rgb",
            ],
            "as the line above them, of larger baselines; test_trial_plans.py plans from baselines",
        ),
        "nw-eval plan hurdles --detect 0.05 --run reports/hurdles": (
            "a run of the whole suite takes minutes; test_trial_plans.py plans from one"
        ),
        "nw-eval study single-scene single-scene-reduced": (
            "the better part of an hour; test_study_resumption.py runs a small one"
        ),
        "nw-eval study single-scene --resume runs/single-scene-reduced": ("goes on with that"),
        "nw-eval study observations mine.yaml --out my-study": (
            "some minutes; test_study_configs.py reads the config of the page"
        ),
        **dict.fromkeys(
            [
                "nw-eval scenes fetch hub:org/corridor",
                "nw-eval scenes fetch hub:org/corridor@v2",
                "nw-eval scenes fetch neverwhere:hurdle_stata_v1",
                "nw-eval policies fetch hub:org/trot",
                "nw-eval run my-scene.yaml --policy hub:org/trot",
                "nw-eval scenes push ./my-scene hub:org/my-scene",
            ],
            "nobody's repositories; tests/scenes/hub has a hub of its own",
        ),
        **dict.fromkeys(
            ["nw-eval scenes fetch real:stairs", "nw-eval run real"],
            "from the network; tests/scenes/test_real_scenes.py fetches from this machine",
        ),
        **dict.fromkeys(
            [
                "nw-eval scenes import scan.glb --out my-hall",
                "nw-eval scenes import scan.obj --out my-yard --unit cm --trail 0,0 2,0 4,0.5",
                (
                    "nw-eval scenes level my-yard --floor 0.1,0,0.02 3.9,0.2,0.11 2,1.5,0.06 "
                    "--trail 0,0 3,0"
                ),
                "nw-eval scenes import map.png --out my-stairs --cell 0.04 --white 1.25",
                "nw-eval scenes import phone.glb --out my-room --splat phone.spz",
                "nw-eval scenes import survey.laz --out my-field --unit ft",
            ],
            "scans of somebody; tests/twin/scans imports and levels some",
        ),
        "nw-eval policies fold policy.onnx --out one.onnx": "test_policies_page.py folds a graph",
        "nw-eval policies fold checkpoints/000150000000 --out policy.safetensors": (
            "needs the extra orbax; tests/policies/test_orbax.py folds a checkpoint"
        ),
        "nw-eval train student student-rgb-small": (
            "minutes; tests/learn/student trains smaller ones"
        ),
        "python tests/twin/loop/closed_loop.py hurdles/one_low_carpet --out loop": (
            "minutes, and lies in the sources; tests/twin/loop runs it by night"
        ),
        "nw-eval twin build photographs/ --out corridor --tag-edge 0.16": (
            "minutes; tests/twin/building builds a room by night"
        ),
        **dict.fromkeys(
            [
                "nw-eval scenes check ./corridor",
                "nw-eval scenes render ./corridor --out corridor.png",
                "nw-eval run corridor/suite.yaml --policy go1-act-rgb",
                "nw-eval view ./corridor",
                "nw-eval check my-places.yaml",
            ],
            "of that scene",
        ),
        "nw-eval twin label corridor": "till Ctrl-C; tests/twin/label does, and uses its page",
        **dict.fromkeys(
            [
                "nw-eval view looked-at",
                "nw-eval view hurdles/one_low_carpet",
                "nw-eval view go1-act-rgb",
                "nw-eval view --policy go1-act-rgb --scene hurdles/two_logs_park",
                (
                    "nw-eval view my-run --baseline baseline-run "
                    "--trial hurdles-one_low_carpet-000 --at 1.5"
                ),
                "nw-eval view my-run/mcap/hurdles/one_low_carpet/hurdles-one_low_carpet-000.mcap",
            ],
            "till Ctrl-C; tests/eval/view does, and uses its page",
        ),
        "nw-eval run corridor/suite.yaml": "of that place; test_label_browser.py runs one by night",
        "nw-eval train student student-rgb": "hours",
        (
            "nw-eval limits hurdles/bar hurdles/block hurdles/clearance -p go1-parkour "
            "--out reports/limits"
        ): "minutes",
        "nw-eval plan hurdles-state --limits reports/limits --write-suite hurdles-sharp.yaml": (
            "the folder is there after minutes; tests/eval/api/test_trial_plans.py has a small one"
        ),
        "nw-eval sim2real limits.csv reports/limits": (
            "the same; tests/eval/api/test_agreements.py has a small one"
        ),
        "nw-eval train student student-rgb-further": "an hour",
        "nw-eval train student student-rgb-ray": "an hour",
        "nw-eval train student student-rgb-ray-further": "an hour",
        "nw-eval train student --resume runs/student-rgb": "hours",
        "nw-eval run hurdles --policy runs/student-rgb/policies/round-16": (
            "the policy is there after hours; tests/learn/student runs smaller ones"
        ),
    }
)
"""Commands that are left out, and why."""

OUTPUT = re.compile(r"^nw-eval replay reports/hurdles-")
"""What the README's run printed, not what a reader types."""

_BLOCK = re.compile(r"^```([\w-]*)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_COMMAND = re.compile(r"^ {4,}(?:- run: )?((?:nw-eval|python|make|mkdir) .+?)(?:\s+#.*)?$")


def _name(page: Path) -> str:
    """Where a page lies in the sources."""
    return page.relative_to(ROOT).as_posix()


def files_of(page: Path) -> dict[str, str]:
    """The files that a page shows, by their names."""
    text = page.read_text(encoding="utf-8")
    return {name: body for _, name, body in _BLOCK.findall(text) if name}


def commands_of(page: Path) -> list[str]:
    """What a page tells its reader to type: lines of its blocks, fenced or indented, in order."""
    lines = _BLOCK.sub(_indented, page.read_text(encoding="utf-8")).splitlines()
    found = [_COMMAND.match(line) for line in lines]
    return [x[1] for x in found if x is not None and not OUTPUT.match(x[1])]


def _indented(block: re.Match[str]) -> str:
    """A fenced block as an indented one; nothing of a file."""
    return "" if block[2] else "".join(f"    {line}\n" for line in block[3].splitlines())


def named_in_prose(page: Path) -> list[str]:
    """The commands between backquotes, one for each of `list|show`."""
    told: list[str] = []
    for command in re.findall(r"`nw-eval ([^`]+)`", _BLOCK.sub("", page.read_text("utf-8"))):
        (choice,) = re.findall(r"\w+(?:\|\w+)+", command) or [""]
        told += [command.replace(choice, each) if choice else command for each in choice.split("|")]
    return told


def save_checkpoint(path: Path) -> None:
    """Write a network of 48 numbers, as velocity policies have them, that answers zeros."""
    zeros = helper.make_tensor("zeros", TensorProto.FLOAT, [48, 12], [0.0] * 48 * 12)
    obs = helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 48])
    actions = helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])
    node = helper.make_node("MatMul", ["obs", "zeros"], ["actions"])
    graph = helper.make_graph([node], "g", [obs], [actions], [zeros])
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))


def type_in(command: str) -> int:
    """Run a command as a shell would; return its exit code."""
    verb, *arguments = shlex.split(f"{command} {REDUCED.get(command, '')}")
    if verb == "nw-eval":
        with pytest.raises(SystemExit) as left:
            cli.main(arguments)
        return int(left.value.code or 0)
    line = f"{sys.executable} {command[7:]}" if verb == "python" else command
    return subprocess.run(["bash", "-ec", line], check=False).returncode


def test_every_page_with_a_test_of_its_own_has_one() -> None:
    for page, file in OWN_TESTS.items():
        assert Path(page).stem in (ROOT / file).read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.nightly if _name(page) in BY_NIGHT else ())
        for page in PAGES
        if _name(page) not in OWN_TESTS and commands_of(page)
    ],
    ids=_name,
)
def test_a_page_can_be_followed(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in files_of(page).items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text, encoding="utf-8")
    save_checkpoint(tmp_path / "exported.onnx")
    for command in commands_of(page):
        if command not in NOT_RUN:
            assert type_in(command) == ENDS.get(command, 0), command


def test_no_command_is_left_out_that_no_page_has() -> None:
    typed = {command for page in PAGES for command in commands_of(page)}
    assert {*REDUCED, *ENDS, *NOT_RUN} <= typed


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_the_program_takes_every_command_of_a_page(
    page: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in commands_of(page):
        if command.startswith("nw-eval "):
            parse(shlex.split(command.split(" || ")[0])[1:], description="")
    for command in named_in_prose(page):
        with pytest.raises(SystemExit) as left:  # Most name no file: their help is enough.
            parse([*shlex.split(command.split(" ||")[0]), "--help"], description="")
        assert left.value.code == 0, f"{_name(page)}: {command}\n{capsys.readouterr().err}"
