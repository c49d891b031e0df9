"""Videos of replays: decoded again, they have the trial's length, both views and its words."""

import sys

import numpy as np
import pytest

from nw_base.errors import PrerequisiteError, StoreError, UsageError
from nw_eval import api
from nw_sim.rollout.record import attachments
from nw_sim.rollout.replaying import film as filming
from nw_sim.rollout.replaying.film import FRAME, VIEW, Film, Words, composed
from nw_sim.rollout.replaying.takeover import replay, take_over
from nw_sim.rollout.trial import run_trial

av = pytest.importorskip("av")

BLUE, ORANGE = (74, 144, 226), (245, 140, 40)


def decoded(path):
    """Return a video's stream facts and its pictures."""
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        facts = stream.codec_context.name, float(stream.average_rate)
        return facts, [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]


def band(picture):
    """Return the colour of the band under the views, which says who drives."""
    return picture[VIEW[1] + 3, FRAME[0] // 2].astype(int)


@pytest.fixture(autouse=True)
def _drawn_small(monkeypatch):
    """Pictures from outside take half a second each at their true size."""
    real = filming.Spectator.beside
    small = {"width": 128, "height": 72}
    monkeypatch.setattr(filming.Spectator, "beside", lambda *where, **_: real(*where, **small))


@pytest.fixture
def recorded(make_job, library, seeing, tmp_path):
    bundle = library.bundle(seeing, None)
    path = tmp_path / "trial.mcap"
    job = make_job(
        policy=seeing,
        duration=0.32,
        mcap=path,
        policy_name=bundle.name,
        attachments=attachments(bundle.card_text, ""),
    )
    run_trial(job, library=library)
    return path


def test_a_video_runs_in_real_time_and_changes_no_bit(recorded, library, tmp_path):
    path = tmp_path / "trial.mp4"
    replayed = replay(recorded, library=library, film=Film(path))
    assert replayed.is_identical
    (codec, rate), pictures = decoded(path)
    assert (codec, rate) == ("h264", filming.RATE)
    # 16 control steps at 50 Hz are 8 pictures; the last one, and its end, stand for 1.5 s.
    assert len(pictures) == 8 + 1 + round(1.5 * filming.RATE)
    assert {picture.shape for picture in pictures} == {(FRAME[1], FRAME[0], 3)}
    views = [picture[: VIEW[1]].astype(int) for picture in pictures]
    left, right = views[0][:, : VIEW[0]], views[0][:, VIEW[0] :]
    assert min(left.std(), right.std()) > 5  # Neither is blank.
    assert np.abs(views[7] - views[1]).mean() > 0.1
    assert np.abs(views[-1] - views[-2]).mean() < 1.0


def test_the_moment_of_a_take_over_is_seen(recorded, library, tmp_path):
    path = tmp_path / "trial.mp4"
    taken = take_over(recorded, start=0.16, policy="stand", library=library, film=Film(path))
    assert taken.result.steps == 16
    _, pictures = decoded(path)
    for number, picture in enumerate(pictures):
        np.testing.assert_allclose(band(picture), ORANGE if number >= 4 else BLUE, atol=30)
    edges = [picture[60, 2].astype(int) for picture in pictures]
    assert np.abs(edges[4] - ORANGE).max() < 30 < np.abs(edges[3] - ORANGE).max()


def test_a_picture_that_fails_costs_the_video_and_says_so(recorded, library, tmp_path, monkeypatch):
    def burst(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr(filming, "composed", burst)
    with pytest.raises(
        StoreError, match=r"the video could not be made: ZeroDivisionError.*--video"
    ):
        replay(recorded, library=library, film=Film(tmp_path / "trial.mp4"))


def test_names_of_strangers_do_no_harm_in_a_picture():
    words = Words(
        time=1.0,
        waypoints="1 of 2 waypoints",
        driver="\x1b[31m" + "ü" * 5000,
        has_taken_over=False,
        own="what it sees",
        news="\u202e::error",
    )
    view = np.zeros((*VIEW[::-1], 3), np.uint8)
    assert composed(view, view[:40, :30], words).shape == (FRAME[1], FRAME[0], 3)


def test_without_pyav_the_command_that_installs_it_is_named(recorded, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(PrerequisiteError, match=r"pip install 'nw-eval\[video\]'"):
        api.replay(recorded, video=tmp_path / "trial.mp4")


def test_a_video_that_is_no_mp4_is_refused_before_anything_runs(recorded, tmp_path):
    with pytest.raises(UsageError, match=r"trial.avi is no .mp4"):
        api.take_over(recorded, start=0.1, video=tmp_path / "trial.avi")


@pytest.mark.nightly
def test_a_confined_process_films(tmp_path):
    report = api.run(
        api.Request(suite="smoke", scenes=("hurdles/one_low_carpet",), trials=1),
        out=tmp_path / "run",
    )
    log = tmp_path / "run" / report.rows[0].mcap_path
    whole = report.rows[0].sim_s
    replayed = api.replay(log, start=whole - 0.4, video=tmp_path / "end.mp4")
    assert replayed.is_identical
    _, pictures = decoded(tmp_path / "end.mp4")
    assert 40 < len(pictures) < 70
