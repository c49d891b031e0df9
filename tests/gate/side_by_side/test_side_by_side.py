"""Policies are compared on the starts that all of them met, or not at all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_eval.reporting.side_by_side import comparison_page
from nw_gate.results.baseline import BaselineKey, Start
from nw_gate.results.real import read_real_results
from nw_gate.scores import specs_of
from nw_gate.side_by_side import Entrant, measured, score_of, side_by_side

SCENES = {"hurdles/low": "11" * 32, "hurdles/high": "22" * 32}
KEY = BaselineKey(
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


def test_a_scene_with_nothing_in_the_way_is_not_a_course_of_hurdles():
    """Rows call its task so, as its trials are named by that."""

    def with_a_room(entrant):
        name = next(iter(entrant.results))
        room = ("flat/carpet_room", *name[1:])
        start = replace(entrant.results[name], scene=room[0], task="hurdles")
        key = entrant.key.model_copy(update={"scenes": {**entrant.key.scenes, room[0]: "aa"}})
        return replace(entrant, results={**entrant.results, room: start}, key=key)

    tasks = side_by_side([with_a_room(GOOD), with_a_room(LAME)]).tasks
    assert [(each.task, each.scenes) for each in tasks] == [("flat", 1), ("hurdles", 2)]


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
            r"its suite digest \(.*perturb, pictures, plug-ins\) is bbbbbbbb, there aaaaaaaa",
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


def test_a_run_that_stopped_early_is_compared_in_the_scenes_that_it_met():
    late = entrant("late", [[None] * 10, [1] * 10])
    found = side_by_side([GOOD, late])
    assert [(each.scene, each.means) for each in found.scenes] == [("hurdles/high", (1.0, 0.25))]
    assert found.unmet == ("hurdles/low",)
    assert [each.mean for each in found.policies] == [1.0, 0.25]
    few = entrant("few", [[None] * 10, [None] * 9 + [1]])
    assert [each.mean for each in side_by_side([GOOD, few]).policies] == [1.0, 0.25]
    other = entrant("other", [[4] * 10, [None] * 10])
    with pytest.raises(IncomparableError, match="late and other have results from no scene in com"):
        side_by_side([late, other])


def test_one_policy_is_not_compared():
    with pytest.raises(UsageError, match="nothing to compare with; name two runs or more"):
        side_by_side([GOOD])


def with_power(one, low, high, names=("mean_power",)):
    """Give the trials of a policy a mean power in each of the two scenes; None has none."""
    power = {"hurdles/low": low, "hurdles/high": high}
    results = {
        name: replace(
            start,
            scores=() if power[name[0]] is None else (("mean_power", power[name[0]]),),
        )
        for name, start in one.results.items()
    }
    return replace(one, results=results, scores=specs_of(names))


def test_scores_that_all_were_measured_by_are_compared_in_their_unit():
    first = with_power(GOOD, 100.0, 140.0, names=("mean_power", "foot_slip"))
    second = with_power(LAME, 80.0, None)
    (found,) = side_by_side([first, second]).scores
    assert found.spec.name == "mean_power"
    one, other = found.estimates
    assert one.mean == pytest.approx(120.0)
    assert other.mean == pytest.approx((80.0 + 1000.0) / 2), "undefined counts as declared"
    assert one.interval.low <= 120.0 <= one.interval.high
    page = comparison_page(side_by_side([first, second]))
    assert "## Scores" in page
    assert "120" in page.partition("## Scores")[2]
    assert "## Scores" not in comparison_page(side_by_side([GOOD, LAME]))


def test_a_robots_table_may_have_a_score_in_its_unit(tmp_path):
    entrants = [with_power(GOOD, 100.0, 140.0), with_power(LAME, 80.0, 90.0)]
    real = tmp_path / "real.csv"
    real.write_text(
        "policy,scene,trials,mean_power\n"
        "good,hurdles/low,10,110\ngood,hurdles/high,10,150\nlame,hurdles/low,10,60\n"
    )
    spec = score_of("mean_power", entrants)
    good, lame = measured(read_real_results(real, spec), entrants, spec)
    assert spec.unscaled(good.real) == pytest.approx(130.0)
    assert spec.unscaled(good.simulated) == pytest.approx(120.0)
    assert spec.unscaled(lame.real) == pytest.approx(60.0)
    assert spec.unscaled(lame.simulated) == pytest.approx(80.0)


def test_a_score_that_a_run_lacks_and_a_number_that_is_none_are_named(tmp_path):
    entrants = [with_power(GOOD, 100.0, 140.0), LAME]
    with pytest.raises(UsageError, match="lame has no score 'mean_power'"):
        score_of("mean_power", entrants)
    real = tmp_path / "real.csv"
    real.write_text("policy,scene,trials,mean_power\ngood,hurdles/low,10,much\n")
    spec = specs_of(["mean_power"])["mean_power"]
    with pytest.raises(UsageError, match="mean_power 'much' is not a number"):
        read_real_results(real, spec)
    with pytest.raises(UsageError, match="lacks the column foot_slip"):
        read_real_results(real, specs_of(["foot_slip"])["foot_slip"])
