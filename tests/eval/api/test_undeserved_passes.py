"""Settings that try for a PASS that nobody earned: a robot that stands still never gets one.

Each either is refused by name before anything runs, or ends with a verdict that is not PASS.
"""

import math

import pytest
from ruamel.yaml import YAML

from nw_base.errors import NwEvalError, StoreError, SuiteError, UsageError
from nw_eval import api

PLACE = {
    "nw-scene": 1,
    "name": "my/place",
    "task": "hurdles",
    "licence": "MIT",
    "collision": "boxes.yaml",
    "trail": [[2.0, 0.0, 0.0], [4.0, 0.0, 0.0]],
}
BOXES = {"boxes": [{"center": [5.0, 1.5, 0.1], "half_size": [0.1, 0.1, 0.1]}]}
SUITE = {
    "nw-eval": 1,
    "name": "attacked",
    "robot": "go1",
    "policy": "stand",
    "trials": 20,
    "seed": 7,
    "episode": {"duration": 0.2},
    "scenes": ["place"],
    "record": "none",
    "gate": {"success_rate": 0.75, "confidence": 0.95},
}


def write(path, data):
    with path.open("w", encoding="utf-8") as file:
        YAML(typ="safe", pure=True).dump(data, file)


@pytest.fixture
def attack(tmp_path, monkeypatch):
    """Run the suite of a robot that stands still, with some settings changed."""
    monkeypatch.chdir(tmp_path)

    def run(suite, place, options):
        (tmp_path / "place").mkdir()
        write(tmp_path / "place" / "boxes.yaml", BOXES)
        write(tmp_path / "place" / "scene.yaml", {**PLACE, **place})
        write(tmp_path / "suite.yaml", {**SUITE, **suite})
        return api.run("suite.yaml", in_process=True, out=tmp_path / "run", **options)

    return run


def gate(**settings):
    return {"gate": {**SUITE["gate"], **settings}}


def trail(*points):
    return {"trail": list(points)}


TWO = ["place", "flat/carpet_room"]

REFUSED = {
    "a bar of 0": (gate(success_rate=0), {}, {}, "success_rate"),
    "a bar of 0 in words": (gate(success_rate="0.0"), {}, {}, "success_rate"),
    "a bar below 0": (gate(success_rate=-0.5), {}, {}, "success_rate"),
    "a bar of NaN": (gate(success_rate=math.nan), {}, {}, "success_rate"),
    "no confidence": (gate(confidence=0.0), {}, {}, "confidence"),
    "less confidence than a coin's": (gate(confidence=0.49), {}, {}, "confidence"),
    "a drop of all": (gate(max_drop=1.0), {}, {}, "max_drop"),
    "more tolerated than dropped": (gate(max_drop=0.1, tolerate=0.5), {}, {}, "tolerate"),
    "no false alarm ever": (gate(false_alarm=0.0), {}, {}, "false_alarm"),
    "no rounds": (gate(rounds=0), {}, {}, "rounds"),
    "all trials may leave": (gate(validity={"alpha": 0.5, "at_most": 1.0}), {}, {}, "at_most"),
    "a tier of nothing": (gate(tiers={"hurdles/*": "critical"}), {}, {}, "no scene 'hurdles/"),
    "a tier of a split": (gate(tiers={"split:eval": "critical"}), {}, {}, "no scene 'split:eval'"),
    "a tier that is none": (gate(tiers={"my/place": "ignored"}), {}, {}, "tiers"),
    "no trials": ({"trials": 0}, {}, {}, "trials"),
    "trials below 0": ({"trials": -3}, {}, {}, "trials"),
    "no trials on the command line": ({}, {}, {"trials": 0}, "--trials 0"),
    "no scenes": ({"scenes": []}, {}, {}, "scenes"),
    "one scene many times": ({"scenes": ["place"] * 3}, {}, {}, "place"),
    "no scene that matches": ({}, {}, {"scenes": ("none/*",)}, "matches no scene"),
    "no time": ({"episode": {"duration": 0.0}}, {}, {}, "duration"),
    "endless time": ({"episode": {"duration": math.inf}}, {}, {}, "duration"),
    "a reach of its own in the suite": ({"reach_radius": 9.0}, {}, {}, "reach_radius"),
    "a reach of its own in the scene": ({}, {"reach_radius": 9.0}, {}, "reach_radius"),
    "a goal at the start": ({}, trail([0.0, 0.0, 0.0]), {}, "reached at the start"),
    "three of four at the start": (
        {},
        trail([0.05, 0.0, 0.0], [0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [4.0, 0.0, 0.0]),
        {},
        "waypoints 0 to 2 are reached at the start",
    ),
    "a start that is drawn onto the goal": (
        {},
        {"spawn": {"position": [0.0, 0.0, 0.0], "x_jitter": 1.0}, **trail([1.2, 0.0, 0.0])},
        {},
        "reached at the start",
    ),
    "a goal that is drawn onto the start": (
        {},
        {"waypoint_noise": [1.0, 0.0], **trail([1.2, 0.0, 0.0])},
        {},
        "reached at the start",
    ),
    "a goal of NaN": ({}, trail([math.nan, 0.0, 0.0]), {}, "trail"),
    "no goal": ({}, {"trail": []}, {}, "trail"),
    "a seed below 0": ({"seed": -1}, {}, {}, "seed"),
    "a part beyond the last": ({}, {}, {"shard": "3/2"}, "--shard"),
}

JUDGED = {
    "nothing changed": ({}, {}, "REGRESSED"),
    "the lowest bar": (gate(success_rate=1e-6), {}, "INCONCLUSIVE"),
    "as unsure as can be": (gate(success_rate=0.01, confidence=0.5), {}, "INCONCLUSIVE"),
    "one trial": ({}, {"trials": 1}, "INCONCLUSIVE"),
    "no gate": ({"gate": {}}, {}, "RAN"),
    "everything informational": (gate(tiers={"*": "informational"}), {}, "INFRASTRUCTURE"),
    "a scene by its name and a glob": (
        {"scenes": ["flat/carpet_room", "flat/*"]},
        {},
        "REGRESSED",
    ),
    "any drop": (gate(max_drop=0.99), {}, "REGRESSED"),
    "no comparison": (gate(baseline="none", max_drop=0.1), {}, "REGRESSED"),
    "half of the rounds named": (gate(rounds=1), {}, "REGRESSED"),
    "blows count for nothing": (
        {"episode": {"duration": 0.2, "contact_termination": False}},
        {},
        "REGRESSED",
    ),
    "a validity that no trial meets": (gate(validity={"alpha": 0.99}), {}, "REGRESSED"),
    "an empty axis": ({"perturb": {"friction": []}}, {}, "REGRESSED"),
    "the published protocol": ({"protocol": "neverwhere-2026"}, {}, "REGRESSED"),
    "another panel": ({}, {"seed": 8}, "REGRESSED"),
    "a panel of its own": ({}, {"panel": "fresh"}, "REGRESSED"),
    "without the critical scene, by a glob": (
        {"scenes": TWO, **gate(tiers={"my/*": "critical"})},
        {"scenes": ("flat/*",)},
        "INFRASTRUCTURE",
    ),
    "without the critical scene, by its name": (
        {"scenes": TWO, **gate(tiers={"my/place": "critical"})},
        {"scenes": ("flat/*",)},
        "INFRASTRUCTURE",
    ),
    "with one of two critical scenes": (
        {"scenes": TWO, **gate(tiers={"*": "critical"})},
        {"scenes": ("flat/*",)},
        "INFRASTRUCTURE",
    ),
    "without a critical variant": (
        {"scenes": ["flat/carpet_room", "hurdles/one_low_*~1"], **gate(tiers={"*~1": "critical"})},
        {"scenes": ("flat/*",)},
        "INFRASTRUCTURE",
    ),
    "without a critical scene of a split": (
        {"scenes": ["flat/carpet_room", "split:eval"], **gate(tiers={"hurdles/*": "critical"})},
        {"scenes": ("flat/*",)},
        "INFRASTRUCTURE",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_meant_is_refused_by_name_and_nothing_runs(name, attack, tmp_path):
    suite, place, options, why = REFUSED[name]
    with pytest.raises((SuiteError, UsageError, NwEvalError)) as refused:
        attack(suite, place, options)
    assert refused.value.exit_code == 2
    assert why in str(refused.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", JUDGED)
def test_a_robot_that_stands_still_does_not_pass(name, attack):
    suite, options, word = JUDGED[name]
    judged = attack(suite, {}, {"trials": 20, **options})
    assert judged.verdict.verdict == word


def test_a_part_of_a_run_is_no_verdict_and_cannot_be_merged_alone(attack, tmp_path):
    part = attack({"scenes": TWO}, {}, {"shard": "1/2"})
    assert part.verdict.verdict == "RAN"
    with pytest.raises(UsageError, match="which is not the whole run"):
        api.judge(part.folder)
    with pytest.raises(StoreError, match="there is no part 2 of 2"):
        api.merge([part.folder], out=tmp_path / "merged")


def test_a_run_that_is_resumed_without_its_critical_scene_does_not_pass(attack, tmp_path):
    critical = {"scenes": TWO, **gate(tiers={"my/*": "critical"})}
    attack(critical, {}, {"trials": 1})
    again = api.run(resume=tmp_path / "run", scenes=("flat/*",), in_process=True)
    assert again.verdict.verdict == "INFRASTRUCTURE"
    assert "critical scene my/place has no result" in again.verdict.reasons[0]
