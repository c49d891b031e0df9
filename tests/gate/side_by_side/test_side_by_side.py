"""Policies are compared on the starts that all of them met, or not at all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nw_eval.errors import IncomparableError, UsageError
from nw_eval.gate.side_by_side import Entrant, side_by_side
from nw_eval.results.bank import BankKey, Start

SCENES = {"hurdles/low": "11" * 32, "hurdles/high": "22" * 32}
KEY = BankKey(
    suite_digest="aa" * 32,
    seed=1,
    protocol="strict",
    scenes=SCENES,
    simulator={"mujoco": "4.0.0", "renderer": "cpu gsplat-1.5"},
)


def entrant(source, reached, policy=None, **changes):
    """A policy from the waypoints (of four) that its trials reached in each scene."""
    results = {
        (scene, (), index): Start(
            scene=scene,
            task="hurdles",
            seed_index=index,
            success=count / 4,
            completed=count == 4,
            waypoints_reached=count,
            waypoints_total=4,
            outcome="completed" if count == 4 else "fell",
            end_reason="",
            trajectory="0" * 16,
        )
        for scene, counts in zip(SCENES, reached, strict=True)
        for index, count in enumerate(counts)
        if count is not None
    }
    return Entrant(
        source=source,
        suite="hurdles",
        policy=policy or source,
        key=KEY.model_copy(update=changes),
        results=results,
    )


GOOD = entrant("good", [[4] * 10, [4] * 10])
LAME = entrant("lame", [[4] * 10, [1] * 10])


def test_policies_are_ranked_with_their_scenes_and_where_they_part():
    found = side_by_side([GOOD, LAME])
    good, lame = found.policies
    assert (good.mean, lame.mean) == (1.0, 0.625)
    assert (good.completed, lame.completed) == (20, 10)
    assert (good.ranks.best, lame.ranks.best) == (1, 2)
    assert [(each.scene, each.means) for each in found.scenes] == [
        ("hurdles/high", (1.0, 0.25)),
        ("hurdles/low", (1.0, 1.0)),
    ]
    together, high = found.partings
    assert (together.scene, together.at.waypoint, together.shown) == (None, 2, True)
    assert (high.scene, high.at.waypoint, high.shown) == ("hurdles/high", 2, True)
    assert (high.at.first.failed, high.at.second.failed, high.at.second.trials) == (0, 10, 10)
    # Four over both scenes, and four in each.
    assert found.waypoints == 12


def test_success_by_task_weighs_the_scenes_of_a_task_equally():
    def with_a_gap(one):
        low = {("gaps/one", *name[1:]): at for name, at in one.results.items() if "low" in name[0]}
        gap = {name: replace(at, scene=name[0], task="gaps") for name, at in low.items()}
        key = KEY.model_copy(update={"scenes": SCENES | {"gaps/one": "33" * 32}})
        return replace(one, results={**one.results, **gap}, key=key)

    gaps, hurdles = side_by_side([with_a_gap(GOOD), with_a_gap(LAME)]).tasks
    assert (gaps.task, gaps.scenes) == ("gaps", 1)
    assert (hurdles.task, hurdles.scenes) == ("hurdles", 2)
    assert [each.mean for each in hurdles.estimates] == [1.0, 0.625]
    assert [each.mean for each in gaps.estimates] == [1.0, 1.0]
    assert hurdles.estimates[1].interval.low < 0.625 < hurdles.estimates[1].interval.high


def test_a_waypoint_that_only_alone_would_be_sure_is_suspect():
    found = side_by_side([GOOD, entrant("shaky", [[4] * 10, [4] * 5 + [2] * 5])], confidence=0.95)
    assert {(each.scene, each.shown) for each in found.partings} == {
        (None, False),
        ("hurdles/high", False),
    }


def test_parting_over_all_scenes_compares_within_scenes_only():
    # Each is as good as the other in both scenes, but for who has more trials where it is hard.
    easy, hard = [4] * 20, [0] * 20
    found = side_by_side([entrant("a", [easy, hard]), entrant("b", [easy, hard])])
    assert found.partings == ()


def test_only_starts_that_all_have_a_result_from_count():
    found = side_by_side([GOOD, entrant("short", [[4, None, 0], [4, 4]])])
    assert [(each.scene, each.starts) for each in found.scenes] == [
        ("hurdles/high", 2),
        ("hurdles/low", 2),
    ]
    assert found.starts == 4
    assert found.left_out == 16
    assert found.policies[0].mean == 1.0
    assert found.policies[1].mean == 0.75


def test_policies_of_one_name_are_told_apart():
    runs = ("reports/x-1/", "reports/x-2", "elsewhere/x-2")
    found = side_by_side([replace(GOOD, source=source) for source in runs])
    assert [each.label for each in found.policies] == [
        "good (x-1)",
        "good (x-2) #2",
        "good (x-2) #3",
    ]
    assert [each.ranks.worst for each in found.policies] == [3, 3, 3]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"seed": 2}, "its seed is 2, there 1"),
        ({"protocol": "neverwhere-2026"}, "its protocol is neverwhere-2026, there strict"),
        (
            {"suite_digest": "bb" * 32},
            r"its suite digest \(robot, episode, perturb\) is bbbbbbbb, there aaaaaaaa",
        ),
        ({"scenes": {"hurdles/low": "11" * 32}}, "it has no scene hurdles/high"),
        ({"scenes": {**SCENES, "ramps/a": "3"}}, "only it has scene ramps/a"),
        (
            {"scenes": {**SCENES, "hurdles/low": "33" * 32}},
            "the digest of its scene hurdles/low is 33333333, there 11111111",
        ),
        (
            {"simulator": {**KEY.simulator, "mujoco": "4.0.1"}},
            "its mujoco is 4.0.1, there 4.0.0",
        ),
        ({"simulator": {"mujoco": "4.0.0"}}, "its renderer is none, there cpu gsplat-1.5"),
    ],
)
def test_policies_that_met_another_task_are_not_compared_and_the_field_is_named(change, field):
    with pytest.raises(IncomparableError, match=f"b does not compare with good: {field}") as caught:
        side_by_side([GOOD, LAME, entrant("b", [[4], [4]], **change)])
    assert caught.value.exit_code == 5


def test_every_field_that_differs_is_named():
    with pytest.raises(IncomparableError, match=r"its seed is 2.*; its protocol is x"):
        side_by_side([GOOD, entrant("b", [[4], [4]], seed=2, protocol="x")])


def test_policies_that_share_too_few_starts_are_compared_on_as_many_of_their_own():
    late = entrant("late", [[None] * 10 + [4, 1], [None] * 8 + [1] * 6])
    found = side_by_side([GOOD, late])
    assert not found.shared
    assert [(each.scene, each.starts, each.means) for each in found.scenes] == [
        ("hurdles/high", 6, (1.0, 0.25)),
        ("hurdles/low", 2, (1.0, 0.625)),
    ]
    # Of `good` the first six and two; the last two in the higher scene both have a result from.
    assert found.left_out == 12 - 2
    assert side_by_side([GOOD, LAME]).shared


def test_ranks_on_starts_of_their_own_are_decided_only_by_what_the_scores_show():
    few = [entrant("a", [[4] * 10, [4] * 10]), entrant("b", [[None] * 10 + [1] * 10] * 2)]
    good, lame = side_by_side(few).policies
    assert (good.ranks.worst, lame.ranks.best) == (1, 2)
    alike = [few[0], entrant("c", [[None] * 10 + [4] * 10] * 2)]
    assert [each.ranks.worst for each in side_by_side(alike).policies] == [2, 2]


def test_a_policy_without_any_result_from_a_scene_is_not_compared():
    late = entrant("late", [[None] * 10, [4] * 10])
    with pytest.raises(IncomparableError, match="late has no result from scene hurdles/low"):
        side_by_side([GOOD, late])


def test_one_policy_is_not_compared():
    with pytest.raises(UsageError, match="nothing to compare with; name two runs or more"):
        side_by_side([GOOD])
