"""The pages on suites say what the code does: keys, defaults, rules, thresholds, bugs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from nw_base.protocol import STRICT
from nw_base.trials import MAX_TRIALS
from nw_base.words import OUTCOMES, Protocol, Tier
from nw_eval.suite import Suite, load_suite
from nw_eval.suite.model import MAX_CELLS
from nw_gate.settings import Gate
from nw_places.splits import Split
from nw_scenes.robots import get_robot
from nw_sim.catalogue import names
from nw_sim.physics.model import GRAVITY, compile_model
from nw_sim.tasks.course import PUBLISHED_FIRST_SEED, REACH_RADIUS, REACH_STEPS, Limits

ROOT = Path(__file__).parents[2]
PAGES = (
    "reference/suite.md",
    "reference/gate.md",
    "reference/outcomes.md",
    "concepts/seeds.md",
    "concepts/verdict.md",
)
TEXT = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in PAGES)
PROSE = " ".join(TEXT.split())


def table(heading: str) -> list[list[str]]:
    """The rows of the table whose first column has this heading, as cells."""
    (rows,) = re.findall(
        rf"^\| {re.escape(heading)} \|.*\n\|[-|:]+\n((?:\|.*\n)+)", TEXT, re.MULTILINE
    )
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows.splitlines()]


def test_its_bounds_are_those_of_the_code() -> None:
    train, evaluation = (len(names(split)) for split in get_args(Split))
    for said in (
        f"at most {MAX_CELLS} cells, a run at most {MAX_TRIALS} trials",
        f"{train} built-in scenes to train in, and the {evaluation} others",
        f"`RandomState({PUBLISHED_FIRST_SEED} + i)`",
    ):
        assert said in PROSE, said


def test_its_words_are_those_of_the_format() -> None:
    assert [row[0].strip("`") for row in table("tier")] == list(get_args(Tier))
    (header,) = re.findall(r"^\| \| `(.*?)` \| `(.*?)` \|$", TEXT, re.MULTILINE)
    assert set(header) == set(get_args(Protocol))


def test_the_outcomes_are_told_in_the_order_in_which_they_are_looked_for() -> None:
    rules = {row[0].strip("`"): row[1] for row in table("outcome")}
    assert set(rules) == set(OUTCOMES) - {"policy_failed"}
    source = (ROOT / "harness/nw_sim/tasks/course.py").read_text(encoding="utf-8")
    body = source.split("    def check(")[1].split("    def state(")[0]
    assert re.findall(r'return "(\w+)"', body) == list(rules)
    limits = Limits()
    assert f"over {limits.tilt:g} rad" in rules["fell"]
    assert f"more than {limits.monitored_force:g} N" in rules["collided"]
    assert f"more than {limits.off_course_distance:g} m" in rules["off_course"]
    assert f"more than {limits.below_ground:g} m under" in rules["off_course"]
    assert f"for {limits.stuck_after:g} s" in rules["stuck"]
    assert f"{limits.stuck_distance:g} m shorter" in rules["stuck"]


def test_a_waypoint_is_reached_by_the_rule_of_the_page() -> None:
    assert REACH_STEPS == 6, "the page says the sixth"
    assert f"after the sixth one within {REACH_RADIUS:g} m" in PROSE


def test_the_watched_parts_are_the_robots() -> None:
    for robot in ("go1", "go2"):
        for geom in get_robot(robot).monitored:
            assert f"`{geom}`" in PROSE
    assert get_robot("go1").published_monitored == ("face",)
    assert get_robot("go2").published_monitored == get_robot("go2").monitored


def test_the_damped_body_is_damped_as_the_page_says() -> None:
    assert "drag of 0.5 N s/m and 0.5 N m s/rad (Go2: 0.6)" in PROSE
    assert [set(get_robot(name).joint_damping) for name in ("go1", "go2")] == [{0.5}, {0.6}]
    assert f"gravity ({GRAVITY:g} m/s²)" in PROSE


def test_its_suite_has_every_key_and_is_taken(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```yaml my-suite.yaml\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    file = tmp_path / "my-suite.yaml"
    file.write_text(text)
    suite = load_suite(file)
    assert suite.model_fields_set == set(Suite.model_fields)
    assert suite.gate.model_fields_set == set(Gate.model_fields)


def test_suites_of_one_panel_differ_in_what_the_page_says_only() -> None:
    hurdles, smoke = load_suite("hurdles-state"), load_suite("smoke")
    assert hurdles.digest == smoke.digest
    same = {"robot", "protocol", "seed", "episode", "task", "perturb", "render"}
    for key in same:
        assert getattr(hurdles, key) == getattr(smoke, key)
    assert (
        "covers robot, protocol, seed, episode, `task`, `render` and `perturb`, and nothing else "
        "but the `plugins`" in PROSE
    )


def test_with_a_friction_of_the_suite_that_value_alone_counts() -> None:
    from nw_sim.catalogue import get_scene
    from nw_sim.physics.model import Actuators

    robot, scene = get_robot("go1"), get_scene("flat/carpet_room")
    for friction, wanted in ((None, 1.25), (0.6, 0.6)):
        model = compile_model(
            robot,
            scene,
            protocol=STRICT,
            actuators=Actuators.of(robot),
            friction=friction,
            payload=0.0,
            timestep=0.005,
        )
        ground, foot = model.geom("ground"), model.geom("FR")
        outranks = int(ground.priority[0]) > int(foot.priority[0])
        counts = ground.friction[0] if outranks else np.maximum(ground.friction, foot.friction)[0]
        assert counts == pytest.approx(wanted)
