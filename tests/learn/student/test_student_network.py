"""The network that is trained, beside the ACT that the adapter `act` runs."""

import numpy as np
import onnxruntime
import pytest
import torch
from student_parts import small_config

from nw_learn.student.network import StudentNetwork, encoder_of, graph_of
from nw_policies.chunks import ChunkQueue

BODY = 20
SEES = {"width": 16, "height": 16, "frames": 2}


@pytest.fixture
def config():
    return small_config(sees=SEES)


@pytest.fixture
def network(config):
    torch.manual_seed(0)
    made = StudentNetwork(config.network, config.sees, proprio=BODY)
    moments = made.act.normalize
    for moment in (moments.proprio, moments.action):
        moment.mean.normal_()
        moment.std.uniform_(0.5, 2.0)
    made.mean_image.uniform_()
    return made.eval()


def test_many_at_a_time_are_what_the_adapter_answers_one_by_one(config, network):
    images = torch.rand(3, 6, 16, 16)
    body = torch.randn(5, BODY)
    image_of = torch.tensor([0, 0, 1, 2, 2])
    with torch.inference_mode():
        chunks = network.actions(network(body, images, image_of))
        alone = [
            network.act(row[None], (images - network.mean_image)[image][None])
            for row, image in zip(body, image_of, strict=True)
        ]
    assert chunks.shape == (5, config.network.chunk, 12)
    torch.testing.assert_close(chunks, torch.stack(alone), rtol=1e-4, atol=1e-5)


def session_of(graph):
    return onnxruntime.InferenceSession(graph)


@pytest.mark.parametrize("m", [0.0, 0.2, -0.7])
def test_the_graph_blends_predictions_as_the_adapter_act_does(network, m):
    sizes = small_config().network.model_dump() | {"ensemble": m}
    config = small_config(network=sizes, sees=SEES)
    session, encoder = (session_of(made(network, config)) for made in (graph_of, encoder_of))
    queue = ChunkQueue(ensemble=m)
    sums = np.zeros((1, config.network.chunk, 13), np.float32)
    draw = np.random.default_rng(5)
    for _ in range(7):
        body = draw.normal(size=(1, BODY)).astype(np.float32)
        image = draw.integers(0, 256, (1, 6, 16, 16), np.uint8)
        (given,) = encoder.run(None, {"rgb": image})
        feeds = {"proprio": body, "seen": given, "sums_in": sums}
        action, sums = session.run(None, feeds)
        with torch.inference_mode():
            seen = torch.from_numpy(image) / 255.0 - network.mean_image
            queue.add(network.act(torch.from_numpy(body), seen).numpy().astype(np.float64))
        np.testing.assert_allclose(action[0], queue.take(), rtol=1e-3, atol=1e-4)


def test_a_network_with_the_mean_image_for_good_is_one_that_sees_nothing_else(config, network):
    seeing, encoder = (session_of(made(network, config)) for made in (graph_of, encoder_of))
    frozen = session_of(graph_of(network, config, is_blind=True))
    network.mean_image.copy_((network.mean_image * 255.0).round() / 255.0)
    body = np.random.default_rng(6).normal(size=(1, BODY)).astype(np.float32)
    feeds = {"proprio": body, "sums_in": np.zeros((1, config.network.chunk, 13), np.float32)}
    mean = (network.mean_image * 255.0).round().to(torch.uint8)[None].numpy()
    same, other = (
        seeing.run(["action"], feeds | {"seen": encoder.run(None, {"rgb": image})[0]})[0]
        for image in (mean, 255 - mean)
    )
    ours = frozen.run(["action"], feeds)[0]
    np.testing.assert_allclose(ours, same, atol=2e-2)
    assert np.abs(ours - other).max() > 10.0 * np.abs(ours - same).max()
