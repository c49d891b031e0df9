"""The curve: the same after a resume as without one, drawn, and shown to TensorBoard."""

import math

import pytest
from PIL import Image

from nw_base.errors import StoreError
from nw_learn.curve import Curve, read_curve


def grown(folder, steps, upto=None):
    curve = Curve(folder, upto=upto)
    for step in steps:
        values = {"loss/value": 1.0 / step, "loss/policy": -float(step)}
        curve.append(step, values | ({"success/hurdles": 0.5} if step > 20 else {}))
    curve.flush()
    return curve


def test_rows_beyond_the_state_are_dropped_so_that_the_curve_is_an_uninterrupted_ones(tmp_path):
    grown(tmp_path / "whole", [10, 20, 30, 40])
    grown(tmp_path / "cut", [10, 20, 30])
    grown(tmp_path / "cut", [30, 40], upto=20)
    whole, cut = (tmp_path / name / "curve.parquet" for name in ("whole", "cut"))
    assert cut.read_bytes() == whole.read_bytes()
    assert read_curve(cut)[0] == (10, {"loss/value": 0.1, "loss/policy": -10.0})
    assert read_curve(cut)[2][1]["success/hurdles"] == 0.5


def test_what_is_no_number_is_left_out(tmp_path):
    curve = Curve(tmp_path)
    curve.append(1, {"a/b": math.nan, "a/c": 2.0, "a/d": math.inf})
    assert curve.rows == ((1, {"a/c": 2.0}),)


def test_a_damaged_curve_is_an_error_on_one_line(tmp_path):
    grown(tmp_path, [10])
    data = bytearray((tmp_path / "curve.parquet").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "curve.parquet").write_bytes(data)
    with pytest.raises(StoreError, match=r"curve\.parquet is damaged"):
        Curve(tmp_path, upto=10)


def test_the_picture_has_a_panel_for_each_group(tmp_path):
    grown(tmp_path / "two", [10, 20, 30])
    curve = Curve(tmp_path / "one")
    curve.append(1, {"loss/value": 1.0})
    curve.flush()
    two, one = (Image.open(tmp_path / name / "curve.png").size for name in ("two", "one"))
    assert two == (2 * one[0], one[1])


def test_tensorboard_reads_what_each_process_wrote(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.plugin_event_accumulator import EventAccumulator

    grown(tmp_path, [10, 20, 30])
    grown(tmp_path, [30, 40], upto=20)
    assert len(list((tmp_path / "tensorboard").iterdir())) == 2
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [event.step for event in events.Tensors("loss/policy")] == [10, 20, 30, 40]


def test_where_there_is_no_tensorboard_that_is_said_once(tmp_path, monkeypatch):
    monkeypatch.setattr("nw_learn.curve.find_spec", lambda _: None)
    lines = []
    curve = Curve(tmp_path, say=lines.append)
    curve.append(1, {"a/b": 1.0})
    curve.flush()
    curve.flush()
    assert len(lines) == 1
    assert "nw-eval[tensorboard]" in lines[0]
    assert not (tmp_path / "tensorboard").exists()
