"""A group of cameras that shares no points with the others is left out."""

import numpy as np

from nw_eval.twin.calibrate.mapping import tied
from nw_eval.twin.calibrate.solution import Placed, Solution
from nw_eval.twin.lens import Lens

LENS = Lens(model="SIMPLE_PINHOLE", width=64, height=48, params=(50.0, 32.0, 24.0))


def solution(*seen):
    """Cameras a, b, ... that see the points of each range."""
    count = max(each.stop for each in seen)
    placed = [
        Placed(
            name=chr(ord("a") + place),
            lens=LENS,
            T_world_camera=np.eye(4),
            seen=np.array(each, np.int32),
        )
        for place, each in enumerate(seen)
    ]
    points = np.arange(count)[:, None] + np.zeros(3)
    return Solution(
        placed=tuple(placed),
        points=points,
        colours=np.zeros((count, 3), np.uint8),
        errors=np.arange(count, dtype=np.float32),
    )


def names(found):
    return "".join(one.name for one in found.placed)


def test_cameras_in_a_chain_hang_together_though_its_ends_share_nothing():
    chain = solution(range(60), range(30, 90), range(60, 120))
    assert tied(chain) is chain


def test_a_group_that_fewer_than_twenty_five_points_tie_to_the_others_is_left_out():
    both = solution(range(40), range(30), range(16, 90), range(50, 90), range(60, 90))
    assert names(tied(both)) == "cde"


def test_points_that_only_those_left_out_saw_are_gone_and_the_others_keep_their_own():
    found = tied(solution(range(20), range(20, 60), range(30, 60)))
    assert names(found) == "bc"
    assert found.points[found.placed[1].seen, 0].tolist() == list(range(30, 60))
    assert found.errors.tolist() == list(range(20, 60))


def test_nothing_placed_is_nothing_tied():
    assert tied(Solution(placed=())).placed == ()
