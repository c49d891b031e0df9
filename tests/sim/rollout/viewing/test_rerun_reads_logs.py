"""Rerun's own loader opens a log: place, robot, trail, path, waypoints, pictures, numbers."""

from collections import defaultdict

import numpy as np
import pytest

from nw_eval.viewing.shown import shown_in_log
from nw_sim.rollout.mcap.drawn import cloud_points
from nw_sim.rollout.mcap.reader import LogReader

chunk = pytest.importorskip("rerun.chunk", reason="needs the extra rerun")


@pytest.fixture(scope="module")
def entities(walked_log):
    """Return what Rerun makes of a log: by entity and component, the values of all times."""
    found = defaultdict(dict)
    for part in chunk.McapReader(walked_log).stream():
        batch = part.to_record_batch()
        for name in batch.schema.names:
            if ":" in name:
                values = found[part.entity_path].setdefault(name, [])
                values.extend(batch.column(name).to_pylist())
    return dict(found)


def test_place_trail_waypoints_and_path_are_points_in_the_world(entities, messages):
    for name in ("/points/place", "/points/trail", "/points/waypoints", "/robot/path"):
        entity = entities[name]
        assert entity["CoordinateFrame:frame"][0] == ["world"]
        points, colours = cloud_points(messages[name][0][1])
        np.testing.assert_array_equal(entity["Points3D:positions"][0], points)
        assert len(entity["Points3D:colors"][0]) == len(colours)
        assert len(entity["Points3D:positions"]) == len(messages[name])


def test_the_robot_s_parts_are_in_frames_that_move(entities, messages):
    assert entities["/points/robot/trunk"]["CoordinateFrame:frame"][0] == ["trunk"]
    moves = entities["/tf"]
    frames = [frame for [frame] in moves["Transform3D:child_frame"]]
    first = frames.index("trunk")
    assert moves["Transform3D:parent_frame"][first] == ["world"]
    at = messages["/tf"][0][1].transforms[first].translation
    [found] = moves["Transform3D:translation"][first]
    assert found == pytest.approx([at.x, at.y, at.z], abs=1e-6)
    assert frames.count("trunk") == len(messages["/tf"]) > 50


def test_pictures_have_their_camera(entities, messages):
    pictures = entities["/camera/ego"]["EncodedImage:blob"]
    assert [bytes(blob) for [blob] in pictures] == [m.data for _, m in messages["/camera/ego"]]
    assert entities["/camera/ego"]["CoordinateFrame:frame"][0] == ["camera/ego_image_plane"]
    camera = entities["/camera/ego/calib"]
    assert camera["Pinhole:resolution"][0] == [[160.0, 90.0]]
    assert camera["Pinhole:parent_frame"][0] == ["camera/ego"]


def test_events_are_lines_of_text(entities, messages):
    assert entities["/log"]["TextLog:text"] == [[m.message] for _, m in messages["/log"]]


def test_every_line_of_the_layout_finds_its_numbers_in_what_rerun_read(walked_log, messages):
    log = LogReader(walked_log)
    columns = defaultdict(list)
    for part in chunk.McapReader(walked_log).stream():
        batch = part.to_record_batch()
        for name in batch.schema.names:
            if name.endswith(":message"):
                columns[part.entity_path].append(batch.column(name))
    lines = [line for plot in shown_in_log(log).plots for line in plot.lines]
    assert {line.topic for line in lines} == {
        "/robot/command",
        "/robot/twist",
        "/nw/policy",
        "/observation/proprio",
    }
    for line in lines:
        selector = chunk.Selector(f".{line.field}")
        found = [row for rows in columns[line.topic] for row in selector.execute_per_row(rows)]
        assert len(found) == len(messages[line.topic])
    named = dict(zip(log.elements()["/observation/proprio"], range(99), strict=False))
    for line in lines:
        if line.topic == "/observation/proprio":
            selector = chunk.Selector(f".{line.field}")
            rows = [row for part in columns[line.topic] for row in selector.execute_per_row(part)]
            found = [value.as_py()[0] for value in rows]
            place = named[line.label]
            assert found == [float(v[place]) for _, v in log.observations("proprio")]
