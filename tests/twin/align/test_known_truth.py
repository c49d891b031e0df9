"""Of ten claims about up and scale nine are true, in places whose up and scale are known."""

import numpy as np
import pytest
from known_truth import drawn, place, sources
from rooms import capture, degrees_off, patch, scale_off, similarity, straight
from twin_parts import grid, joined

from nw_base.errors import SceneError
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions

HEIGHT = AlignOptions(camera_height=1.5)


@pytest.mark.parametrize(
    ("first", "count"), [(0, 20), pytest.param(1000, 600, marks=pytest.mark.nightly)]
)
def test_nine_of_ten_stated_angles_hold_the_true_up(first, count, tmp_path):
    off, said = np.zeros((2, count))
    for number in range(count):
        found, folder, T, _ = place(first + number, tmp_path)
        alignment = align(found, folder, options=HEIGHT)
        off[number], said[number] = degrees_off(alignment, T), alignment.up_uncertain
    assert (off <= said).mean() >= 0.9
    assert np.median(off) < 0.5
    for low, high in ((0.0, 1.0), (1.0, 2.0), (2.0, 5.0), (5.0, 181.0)):
        claims = (said >= low) & (said < high)
        # Few claims may be off by two more, as chance has it.
        wrong = (off > said)[claims].sum()
        assert wrong <= 0.1 * claims.sum() + 2, (low, high)
    assert (said < 2.0).mean() > 0.3  # What is vague everywhere says nothing.


@pytest.mark.parametrize("lies", [0, 1])
@pytest.mark.parametrize("count", [30, pytest.param(400, marks=pytest.mark.nightly)])
def test_stated_scales_hold_the_truth_also_where_a_source_lies(lies, count):
    rng = np.random.default_rng(17)
    off, said, stopped = [], [], []
    for number in range(count):
        found, _, T, true = place(5000 + number, None)
        try:
            alignment = align(found, None, options=sources(rng, found, true, lies))
        except SceneError as error:
            stopped.append(str(error))
            continue
        # Where nothing else says anything a lie cannot be told.
        if alignment.scale_uncertain is not None and len(alignment.scales) > lies:
            off.append(abs(scale_off(alignment, T)))
            said.append(alignment.scale_uncertain)
    assert all(text.count(" m a unit") >= 2 for text in stopped)  # Both are named.
    assert np.mean(np.array(off) <= said) >= 0.93
    assert np.median(off) < 0.02
    assert len(off) >= (0.3 if lies else 0.8) * count


def test_edges_of_few_photographs_that_lean_do_not_outweigh_the_mesh(tmp_path):
    """As in an office of six photographs: chairs lean by 15 degrees, floor and table are level."""
    rng = np.random.default_rng(3)
    T, poses = similarity(rng), straight(rng, 6, roll=3.0)
    points = np.concatenate(
        [
            rng.uniform((0, 0, 0), (6, 5, 2), (500, 3)),
            patch(rng, 30, (2, 2, 0.7), (2, 0, 0), (0, 1, 0)),
        ]
    )
    found = capture(points, poses, T, files=[f"{i}.png" for i in range(6)], size=(640, 480))
    lean = np.array([np.sin(np.radians(15)), 0.0, np.cos(np.radians(15))]) * 1.5
    feet = rng.uniform((1.5, 0.5, 0.1), (9, 4.5, 0.3), (25, 3))
    middles = rng.uniform((1, 0, 0), (8, 5, 2), (110, 3))
    ways = rng.normal(0, 0.8, (110, 3))
    lines = np.concatenate(
        [np.stack([feet, feet + lean], 1), np.stack([middles, middles + ways], 1)]
    )
    drawn(tmp_path, found, lines @ T[:3, :3].T + T[:3, 3])
    floor, table = ((0, 0, 0), (6, 0, 0), (0, 5, 0)), ((2, 2, 0.7), (2, 0, 0), (0, 1, 0))
    vertices, faces = joined(*(grid(*each, (1, 1)) for each in (floor, table)))
    mesh = (vertices @ T[:3, :3].T + T[:3, 3], faces)
    by_edges = align(found, tmp_path, None, HEIGHT)
    cues = {cue.name: cue for cue in by_edges.gravity}
    assert 10 < degrees_off_cue(cues["edges"], T) < 20
    alignment = align(found, tmp_path, mesh, HEIGHT)
    assert degrees_off(alignment, T) < min(1.0, alignment.up_uncertain)
    assert any("up by edges is 1" in line for line in alignment.warnings)
    assert alignment.is_to_scale


def degrees_off_cue(cue, T):
    return np.degrees(np.arccos(np.clip(T[:3, 2] @ cue.up / np.linalg.norm(T[:3, 2]), -1, 1)))


def test_a_single_cue_says_that_it_stands_alone():
    rng = np.random.default_rng(4)
    said = []
    points = patch(rng, 900, (0, 0, 0), (6, 0, 0), (0, 5, 0)) + rng.normal(0, 0.004, (900, 3))
    alignment = align(capture(points, straight(rng)), None, options=HEIGHT, say=said.append)
    assert alignment.up_uncertain > 1.5
    (line,) = [line for line in said if line.startswith("up is known to")]
    assert line.endswith("degrees (95 %): by the cameras and the floor alone")
