"""TensorBoard's own reader finds what was written."""

from io import BytesIO

import pytest
from PIL import Image

from nw_eval.reporting.trackers.tracked import track

reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")


def events(folder):
    """Numbers and texts by key, as TensorBoard reads them."""
    found = reader.EventAccumulator(str(folder))
    found.Reload()
    numbers, texts = {}, {}
    for key in found.Tags()["tensors"]:
        (event,) = found.Tensors(key)
        if found.SummaryMetadata(key).plugin_data.plugin_name == "images":
            continue
        if event.tensor_proto.string_val:
            texts[key] = event.tensor_proto.string_val[0].decode()
        else:
            numbers[key] = event.tensor_proto.float_val[0]
    return numbers, texts


def test_the_run_folder_has_verdict_scores_and_report(tracked, tmp_path):
    track("tensorboard", tracked(reached=3))
    numbers, texts = events(tmp_path)
    assert numbers["nw-eval/hurdles/all/success"] == 0.75
    assert numbers["nw-eval/hurdles/success/b"] == 0.75
    assert texts["nw-eval/hurdles/verdict"] == "`INCONCLUSIVE`"
    assert texts["nw-eval/hurdles/report"] == "# A report\n"


def test_a_second_time_replaces_the_first_and_the_same_run_gives_the_same_bytes(tracked, tmp_path):
    track("tensorboard", tracked(reached=3))
    (file,) = tmp_path.glob("*tfevents*")
    first = file.read_bytes()
    track("tensorboard", tracked(reached=1))
    assert events(tmp_path)[0]["nw-eval/hurdles/all/success"] == 0.25
    track("tensorboard", tracked(reached=3))
    assert list(tmp_path.glob("*tfevents*")) == [file]
    assert file.read_bytes() == first


def test_strangers_names_are_keys_of_their_own_and_their_words_are_code(hostile, tmp_path):
    track("tensorboard", hostile)
    numbers, texts = events(tmp_path)
    assert numbers == pytest.approx(dict(hostile.numbers))
    policy = texts["nw-eval/hurdles/policy"]
    assert policy == r"`[p](http://evil) <b>'x' \x1b[31m`"


def test_clips_of_the_worst_trials_move(tracked, tmp_path):
    track("tensorboard", tracked())
    found = reader.EventAccumulator(str(tmp_path))
    found.Reload()
    (key,) = (key for key in found.Tags()["tensors"] if "/clips/" in key)
    (event,) = found.Tensors(key)
    *size, picture = event.tensor_proto.string_val
    assert size == [b"16", b"9"]
    with Image.open(BytesIO(picture)) as shown:
        assert (shown.format, shown.n_frames) == ("GIF", 2)
    assert found.SummaryMetadata(key).summary_description == "`it 'fell' <b>here</b>`"
