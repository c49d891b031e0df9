"""One nasty name through every door of the real command line: nobody obeys it, nobody is called."""

import hashlib
import json
import re

import pytest
from command_line import ends

# A line of its own, a repainted screen, orders to CI runners, a turned name, a password, a call of
# somebody, a link, and far too much of it.
NASTY = (
    "nice\n::error::owned\r\x1b[2J\x1b]0;t\x07##[error]x ##vso[task.x]\u202etxt\u2066 "
    "ws://bob:hunter2@host/x @maintainer #12 www.evil.example " + "z" * 5000
)
QUOTED = json.dumps(NASTY)  # As YAML reads it, too.

SCENE = f"""\
nw-scene: 1
name: NAME
task: hurdles
licence: {QUOTED}
title: {QUOTED}
trail: [[0.4, 0, 0]]
"""
CARD = f"""\
nw-policy: 1
name: stranger
title: {QUOTED}
licence: {QUOTED}
robot: go1
adapter: "python:angry:Angry"
control: {{action: joint_position_offset}}
observations:
  body: {{sensor: proprio, layout: parkour53}}
"""
ANGRY = f"""\
class Angry:
    inputs = ()
    def __init__(self, bundle): self.step = 0
    def reset(self, seed): self.step = 0
    def act(self, observation):
        self.step += 1
        if self.step > 3:
            raise RuntimeError({NASTY!r})
        return [0.0] * 12
    def state(self): return b""
    def restore(self, state): pass
    def close(self): pass
"""
SUITE = """\
nw-eval: 1
name: mine
robot: go1
policy: ./policy/policy.yaml
trials: 1
seed: 1
episode: {duration: 1.0}
scenes: [./place]
record: none
gate: {success_rate: 0.5}
"""


@pytest.fixture
def nw_eval(project, capfd, monkeypatch):
    """Run a command line; return all that it says, after looking at it."""
    monkeypatch.chdir(project)

    def run(*arguments):
        ends(*arguments)
        said = capfd.readouterr()
        for stream in said:
            harmless(stream)
        assert "Traceback" not in said.err
        return said.out + said.err

    return run


def harmless(said):
    assert not re.search(r"^\s*::", said, re.MULTILINE), said
    for mark in ("\x1b", "\x07", "\r", "\u202e", "\u2066", "##[", "##vso[", "hunter2"):
        assert mark not in said, (mark, said)
    assert max((len(line) for line in said.split("\n")), default=0) < 4000


@pytest.fixture
def project(tmp_path):
    place = tmp_path / "place"
    place.mkdir()
    (place / "scene.yaml").write_text(SCENE.replace("NAME", "mine/kerb"))
    (place / "collision.yaml").write_text("boxes: []\n")
    policy = tmp_path / "policy"
    policy.mkdir()
    (policy / "policy.yaml").write_text(CARD)
    (policy / "angry.py").write_text(ANGRY)
    (tmp_path / "suite.yaml").write_text(SUITE)
    return tmp_path


def test_scenes_say_their_names_harmlessly(project, nw_eval):
    said = nw_eval("scenes", "list", "./place")
    assert "nice ::error::owned \\x1b[2J" in said
    assert "nice ::error::owned" in nw_eval("scenes", "show", "./place")
    nw_eval("scenes", "check", "./place")
    scene = project / "place" / "scene.yaml"
    for change in (
        SCENE.replace("NAME", QUOTED),
        SCENE.replace("NAME", "a") + f"collision: {QUOTED}\n",
        SCENE.replace("NAME", "a") + f"splat: {QUOTED}\n",
        SCENE.replace("NAME", "a") + f"{QUOTED}: 1\n",
        SCENE.replace("NAME", "a").replace("[[0.4, 0, 0]]", QUOTED),
    ):
        scene.write_text(change)
        assert "scene.yaml:" in nw_eval("scenes", "check", "./place")
    for reference in (NASTY, f"neverwhere:{NASTY}"):
        assert "nice" in nw_eval("scenes", "check", reference)


def test_published_files_say_their_names_harmlessly(project, nw_eval):
    folder = project / "a\n::error::b\x1b"
    folder.mkdir()
    (folder / "x\n::error::y.xml").write_text("<mujoco><body></mujoco>")
    assert "not well formed" in nw_eval("scenes", "check", f"neverwhere:{folder}")


def test_cards_and_suites_say_their_words_harmlessly(project, nw_eval):
    assert "nice ::error::owned" in nw_eval("policies", "show", "policy")
    nw_eval("policies", "list")
    card, suite = project / "policy" / "policy.yaml", project / "suite.yaml"
    for change in (
        CARD.replace("name: stranger", f"name: {QUOTED}"),
        CARD.replace("body:", f"{QUOTED}:"),
        CARD.replace("parkour53", QUOTED),
        CARD.replace('"python:angry:Angry"', "remote") + f"options: {{url: {QUOTED}}}\n",
        CARD.replace('"python:angry:Angry"', "remote") + "options: {url: 'ws://bob:hunter2@[/'}\n",
        CARD.replace('"python:angry:Angry"', "onnx") + f"checkpoint: {{file: {QUOTED}}}\n",
        CARD.replace('"python:angry:Angry"', "onnx")
        + f"checkpoint: {{file: none.onnx, source: {QUOTED}, sha256: {'0' * 64}}}\n",
    ):
        card.write_text(change)
        nw_eval("policies", "show", "policy")
        nw_eval("policies", "check", "policy")
    for change in (
        SUITE.replace("name: mine", f"name: {QUOTED}"),
        SUITE.replace("./policy/policy.yaml", QUOTED),
        SUITE.replace("[./place]", f"[{QUOTED}]"),
        SUITE.replace("{success_rate: 0.5}", f"{{tiers: {{{QUOTED}: critical}}}}"),
        SUITE + f"{QUOTED}: 1\n",
    ):
        suite.write_text(change)
        nw_eval("check", "suite.yaml")


def test_a_policy_that_fails_in_a_trial_says_so_harmlessly_in_every_page(project, nw_eval):
    said = nw_eval("run", "suite.yaml", "--allow-code", "--out", "run", "--workers", "1")
    assert "nice ::error::owned" in said
    page = (project / "run" / "report.md").read_text()
    harmless(page)
    outside_code = re.sub(r"`[^`\n]*`", "", page)
    assert not re.search(r"@maintainer|#12|www\.|://", outside_code)
    again = nw_eval("report", "run")
    assert "mine/kerb" in again
    for log in (project / "run").rglob("*.mcap"):
        nw_eval("replay", log)


def test_a_checkpoint_with_nasty_names_is_drafted_and_refused_harmlessly(project, nw_eval):
    onnx = pytest.importorskip("onnx")
    name = NASTY.replace("hunter2", "x")  # Here it is part of a name, not of an address.
    from onnx import TensorProto, helper

    node = helper.make_node("Relu", [name[:300]], ["b\n::error::c\x1b"])
    graph = helper.make_graph(
        [node], name[:300],
        [helper.make_tensor_value_info(name[:300], TensorProto.FLOAT, [1, 12])],
        [helper.make_tensor_value_info("b\n::error::c\x1b", TensorProto.FLOAT, [1, 12])],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    model.doc_string = name
    path = project / "policy" / "net.onnx"
    onnx.save(model, path)
    nw_eval("policies", "init", path, "--robot", "go1", "--out", "draft.yaml")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    (project / "policy" / "policy.yaml").write_text(
        CARD.replace('"python:angry:Angry"', "onnx")
        + f"checkpoint: {{file: net.onnx, sha256: {digest}}}\n"
    )
    nw_eval("policies", "check", "policy")
