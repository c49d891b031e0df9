"""When states and checkpoints are written, and what a training says meanwhile."""

import os
import signal

import pytest
import torch

from nw_base.errors import PrerequisiteError
from nw_learn.config import device_of
from nw_learn.curve import Curve, read_curve
from nw_learn.folder import TrainFolder
from nw_learn.progress import Keeper, TrainingProgress


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def keeper(folder, clock, **options):
    curve = Curve(folder.path)
    curve.append(1, {"a/b": 1.0})
    return Keeper(folder, curve, keep_every=100, save_every=60.0, clock=clock, **options)


def test_states_go_by_time_and_checkpoints_by_steps(tmp_path):
    folder, clock = TrainFolder(tmp_path), Clock()
    keeping = keeper(folder, clock)
    for step in range(50, 451, 50):
        clock.now += 25.0
        keeping.after(step, lambda step=step: {"step": step})
    assert folder.load_state() == {"step": 450}
    assert [folder.read(path)["step"] for path in folder.checkpoints] == [100, 200, 300, 400]
    assert read_curve(tmp_path / "curve.parquet") == [(1, {"a/b": 1.0})]


def test_a_training_that_goes_back_forgets_later_checkpoints(tmp_path):
    folder = TrainFolder(tmp_path)
    for number in (1, 2, 3):
        folder.keep(number, {"step": 100 * number})
    keeper(folder, Clock(), first=250)
    assert [path.stem for path in folder.checkpoints] == ["0001", "0002"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_has_the_state_written_after_the_step_under_way(tmp_path, number):
    folder = TrainFolder(tmp_path)
    with keeper(folder, Clock()) as keeping:
        os.kill(os.getpid(), number)
        assert keeping.is_interrupted
        assert folder.load_state() is None
        keeping.after(7, lambda: {"step": 7})
    assert folder.load_state() == {"step": 7}


def test_a_line_every_few_seconds_says_how_far_how_fast_and_how_long_still():
    lines, clock = [], Clock()
    progress = TrainingProgress(lines.append, steps=2_000_000, first=1000, every=10.0, clock=clock)
    for step in range(1, 31):
        clock.now += 1.0
        progress.update(1000 + 5000 * step, "phase 1", {"success": 0.51234})
    assert len(lines) == 3
    assert lines[1] == "56,000 of 2.00 M steps · phase 1 · 5,000/s · 6 min left · success 0.512"


def test_what_is_done_between_steps_counts_in_what_is_left_and_not_in_the_rate():
    lines, clock = [], Clock()
    progress = TrainingProgress(lines.append, steps=3000, every=10.0, clock=clock)
    progress.leave()
    clock.now += 600.0
    progress.back(0, times=2)
    for step in range(1, 11):
        clock.now += 1.0
        progress.update(10 * step, "round 1 of 3", {})
    assert lines == ["100 of 3,000 steps · round 1 of 3 · 10/s · 25 min left"]


def test_the_minutes_of_a_budget_end_a_process():
    clock = Clock()
    progress = TrainingProgress([].append, steps=10, minutes=2.0, clock=clock)
    clock.now = 119.0
    assert not progress.is_time_up
    clock.now = 120.0
    assert progress.is_time_up


def test_auto_is_cuda_where_there_is_one(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert (device_of("auto").type, device_of("cpu").type) == ("cuda", "cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device_of("auto").type == "cpu"
    with pytest.raises(PrerequisiteError, match="there is no CUDA here"):
        device_of("cuda")
