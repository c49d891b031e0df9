"""What differs between two baselines, and with what it may be charged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.cli.verbs.baseline import change_page, whose_doing
from nw_gate.results.baseline import baseline_change, baseline_mean

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_gate.results.baseline import BaselineResults, Start

HERE, THERE = {"cpu": "znver4"}, {"cpu": "haswell"}


def with_starts(baseline: BaselineResults, change: Callable[[Start], Start]) -> BaselineResults:
    panels = [replace(panel, starts=tuple(map(change, panel.starts))) for panel in baseline.panels]
    return replace(baseline, panels=tuple(panels))


def with_key(baseline: BaselineResults, **changes: Any) -> BaselineResults:
    key = baseline.manifest.key.model_copy(update=changes)
    return replace(baseline, manifest=baseline.manifest.model_copy(update={"key": key}))


def with_checkpoint(baseline: BaselineResults) -> BaselineResults:
    policy = baseline.manifest.policy.model_copy(update={"checkpoint_digest": "ee" * 32})
    return replace(baseline, manifest=baseline.manifest.model_copy(update={"policy": policy}))


def falls_at_three(start: Start) -> Start:
    """In the first scene start 3 falls now, and start 2 goes another way to the same end."""
    if start.scene != "hurdles/place_00" or start.seed_index < 2:
        return start
    if start.seed_index == 2:
        return replace(start, trajectory="f" * 16)
    return replace(start, trajectory="e" * 16, success=0.5, completed=False, outcome="fell")


def test_a_baseline_does_not_differ_from_itself(make_baseline):
    change = baseline_change(make_baseline(), make_baseline())
    assert change.fields == change.machine == ()
    assert all(scene.then == scene.now and not scene.moved for scene in change.scenes)
    assert whose_doing(change) == "No trial changed."


def test_scenes_say_which_starts_went_another_way_and_which_ended_otherwise(make_baseline):
    change = baseline_change(make_baseline(), with_starts(make_baseline(), falls_at_three))
    first, second = change.scenes
    assert (first.then, first.now) == (0.875, 0.75)
    assert (first.moved, first.flipped, first.starts) == (2, (3,), 4)
    assert (second.moved, second.flipped) == (0, ())
    assert baseline_mean(change.then) == 0.875
    assert baseline_mean(change.now) == 0.8125
    page = change_page(change)
    assert "hurdles/place_00  0.875  0.750  -0.125  2 of 4          states 3" in page
    assert "mean              0.875  0.812  -0.062" in page


def test_what_a_policy_that_failed_by_itself_reached_is_no_success(make_baseline):
    def fails(start: Start) -> Start:
        return replace(start, outcome="policy_failed", success=0.5, completed=False)

    assert baseline_mean(with_starts(make_baseline(), fails)) == 0.0


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        ({"seed": 6}, ["suite seed  20261 -> 6"]),
        ({"protocol": "neverwhere-2026"}, ["suite protocol  strict -> neverwhere-2026"]),
        ({"suite_digest": "ab" * 32}, [f"suite digest  {'aa' * 8} -> {'ab' * 8}"]),
        (
            {"simulator": {"mujoco": "4.1.0", "rays": "nw-eval rays 1"}},
            [
                "simulator mujoco    4.0.0 -> 4.1.0",
                "simulator rays      none -> nw-eval rays 1",
                "simulator renderer  cpu gsplat-1.5 -> none",
            ],
        ),
        (
            {"scenes": {"hurdles/place_00": "9" * 64}},
            [
                f"scene hurdles/place_00  {'0' * 16} -> {'9' * 16}",
                f"scene hurdles/place_01  {'0' * 16} -> none",
            ],
        ),
    ],
)
def test_each_field_of_the_key_that_differs_is_a_line(make_baseline, changes, lines):
    page = change_page(baseline_change(make_baseline(), with_key(make_baseline(), **changes)))
    assert page.splitlines()[: len(lines)] == lines


def test_a_change_of_the_simulator_is_never_charged_to_a_checkpoint(make_baseline):
    moved = with_starts(make_baseline(), falls_at_three)
    simulator = with_key(moved, simulator={"mujoco": "4.1.0", "renderer": "cpu gsplat-1.5"})
    assert "the changes come from the simulator, not a checkpoint" in whose_doing(
        baseline_change(make_baseline(), simulator)
    )
    assert "Only the policy differs" in whose_doing(
        baseline_change(make_baseline(), with_checkpoint(moved))
    )
    assert "cannot be attributed to one of them" in whose_doing(
        baseline_change(make_baseline(), with_checkpoint(simulator))
    )


def test_panels_of_the_class_of_machine_that_both_have_are_compared(make_baseline):
    both = make_baseline(machines=(HERE, THERE))
    moved = with_starts(make_baseline(machines=(THERE,)), falls_at_three)
    mixed = replace(both, panels=(both.panels[0], moved.panels[0]))
    assert not any(scene.moved for scene in baseline_change(mixed, moved).scenes)
    change = baseline_change(make_baseline(machines=(HERE,)), moved)
    assert [field.then for field in change.machine] == ["znver4"]
    assert "the changes come from the machine, not a checkpoint" in whose_doing(change)


def test_another_number_of_starts_is_a_change_of_the_suite(make_baseline):
    change = baseline_change(make_baseline(starts=4), make_baseline(starts=6))
    (field,) = change.fields
    assert (field.part, field.name, field.then, field.now) == ("suite", "starts", "4", "6")
    assert change.scenes[0].starts == 4
