"""The steps in which a student learns: batches, their loss, the optimiser, and random images.

Images of a training differ at random from those that were rendered, as those of any day, any lens,
any sensor do. Each image of a batch gets its own draw, which all images of its stack share. Draws
come from one generator of the training's, on the CPU, so that they are the same whatever the
device.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.learn.folder import read_state
from nw_eval.learn.student.network import StudentNetwork, as_numbers

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from nw_eval.learn.student.config import Randomise, StudentConfig
    from nw_eval.learn.student.dataset import Dataset, Minibatch

_LARGEST_GRADIENT = 1.0

_COLOURS = 3
_LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in brightness (ITU-R 601)."""
_BLURRED = 0.5
"""Share of images that are blurred at all."""


class Learner:
    """A network that learns to answer as the teacher does; L1 loss on normalised chunks.

    What is drawn in a step follows from the seed, the round and the step: nothing of earlier steps
    but weights and the optimiser's moments decides it.

    Args:
        config: of the training.
        proprio: numbers of the body.
        device: where it learns.
    """

    def __init__(self, config: StudentConfig, *, proprio: int, device: torch.device) -> None:
        self._config = config
        self._device = device
        # Layers draw from torch's one generator, whose state is the caller's again afterwards.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(_number(config.seed, 0))
            self.network = StudentNetwork(config.network, config.sees, proprio=proprio)
        self.network.to(device)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(),
            lr=config.learns.learning_rate,
            weight_decay=config.learns.weight_decay,
        )

    def begin(self, path: Path) -> None:
        """Take the network of another training, its moments of what goes in and out included.

        Raises:
            StoreError: the file is damaged, or of another network.
        """
        try:
            self.network.load_state_dict(read_state(path)["network"])
        except (KeyError, TypeError, AttributeError, RuntimeError) as error:
            reason = clean(" ".join(str(error).split()), at_most=200)
            raise StoreError(
                f"start: {path} is of another network: {reason}",
                fix="give `sees` and `network` of the training that it is of",
            ) from None

    def normalise(self, moments: Mapping[str, np.ndarray]) -> None:
        """Take the dataset's moments for good: the first round's."""
        act, numbers = self.network.act, {k: torch.from_numpy(v) for k, v in moments.items()}
        act.normalize.proprio.mean.copy_(numbers["body_mean"])
        act.normalize.proprio.std.copy_(numbers["body_std"])
        act.normalize.action.mean.copy_(numbers["label_mean"])
        act.normalize.action.std.copy_(numbers["label_std"])
        self.network.mean_image.copy_(numbers["image"])

    def step(self, dataset: Dataset, *, number: int, step: int, done: float) -> dict[str, float]:
        """Learn from one batch; return `samples` it had and the mean `loss` over them.

        Args:
            dataset: all trajectories so far.
            number: of the round.
            step: of the round, from 0.
            done: share of the round that is over, 0 to 1.
        """
        config = self._config
        seeds = np.random.SeedSequence(config.seed, spawn_key=(number, step)).generate_state(2)
        batch = dataset.draw(np.random.default_rng(int(seeds[0])), config.learns.batch_images)
        generator = torch.Generator().manual_seed(int(seeds[1]))
        images = self._images(batch, Randomiser(config.randomise, generator))
        body, image_of, labels, is_there = (
            torch.from_numpy(array).to(self._device)
            for array in (batch.body, batch.image_of, batch.labels, batch.is_there)
        )
        moments = self.network.act.normalize.action
        wanted = (labels - moments.mean) / moments.std
        self.network.train()
        error = (self.network(body, images, image_of) - wanted).abs().mean(2)
        loss = (error * is_there).sum() / is_there.sum()
        for group in self._optimiser.param_groups:
            group["lr"] = config.learns.rate(number, done=done)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
        self._optimiser.step()
        return {"samples": len(body), "loss": float(loss.detach())}

    def state(self) -> dict[str, Any]:
        """Return weights and the optimiser's moments."""
        return {"network": self.network.state_dict(), "optimiser": self._optimiser.state_dict()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go back to a `state`."""
        self.network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])

    def _images(self, batch: Minibatch, random: Randomiser) -> Tensor:
        """Return what the network sees of a batch, changed at random."""
        sees = self._config.sees
        view = random.view(self._config.learns.batch_images, (sees.height, sees.width))
        seen: list[Tensor] = []
        for name, images in batch.images.items():
            numbers = as_numbers(torch.from_numpy(images).to(self._device))
            moved = resampled(numbers, view)
            seen.append(random.colours(moved) if name == "rgb" else random.depths(moved))
        return torch.cat(seen, dim=1)


def _number(seed: int, *key: int) -> int:
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint64)[0])


class Randomiser:
    """Changes images of a training.

    Args:
        amounts: from the config.
        generator: on the CPU.
    """

    def __init__(self, amounts: Randomise, generator: torch.Generator) -> None:
        self._amounts = amounts
        self._generator = generator

    def view(self, count: int, size: tuple[int, int]) -> Tensor:
        """Return where the pixels of images come from, (count, rows, columns, 2) for `resampled`.

        The camera is rolled, and a rectangle of its image is stretched over all of it.
        """
        rows, columns = size
        angle = self._spread(count) * math.radians(self._amounts.rotation)
        zoom = 1.0 - self._uniform(count) * self._amounts.crop
        shift = self._spread(count, 2) * (1.0 - zoom)[:, None]
        cos, sin = zoom * angle.cos(), zoom * angle.sin()
        ratio = rows / columns  # Coordinates run from -1 to 1 along both sides.
        affine = torch.stack(
            [cos, -sin * ratio, shift[:, 0], sin / ratio, cos, shift[:, 1]], dim=1
        ).reshape(count, 2, 3)
        shape = [count, 1, rows, columns]
        return functional.affine_grid(affine, shape, align_corners=False)

    def colours(self, images: Tensor) -> Tensor:
        """Return other colours, (M, 3 * frames, rows, columns), 0 to 1."""
        count = len(images)
        luma = torch.tensor(_LUMA).expand(_COLOURS, _COLOURS)
        saturation, contrast, brightness = (self._gain(count, 1, 1) for _ in range(3))
        mixed = luma + saturation * (torch.eye(_COLOURS) - luma)
        tint = 1.0 + 0.5 * (self._gain(count, _COLOURS, 1) - 1.0)
        # All of it is one matrix for each image, and contrast a shift by what the mean loses.
        matrix = (tint * brightness * contrast * mixed).to(images)
        frames = images.unflatten(1, (-1, _COLOURS)).flatten(3)
        middle = frames.mean(dim=(1, 2, 3)).cpu()[:, None, None]
        shift = (tint * brightness * (1.0 - contrast) * middle).to(images)
        changed = torch.matmul(matrix[:, None], frames) + shift[:, None]
        return self._blurred(changed.reshape(images.shape)).clamp_(0.0, 1.0)

    def depths(self, images: Tensor) -> Tensor:
        """Return noisy depths with pixels dropped, (M, frames, rows, columns), 1 = nothing."""
        count = len(images)
        noise = torch.randn(images.shape, generator=self._generator)
        size = (count, 1, 1, 1)
        deviation = self._amounts.depth_noise * self._uniform(*size)
        share = self._amounts.dropped * self._uniform(*size)
        is_dropped = self._uniform(*images.shape) < share
        noisy = images * (1.0 + (deviation * noise).to(images))
        return noisy.masked_fill(is_dropped.to(images.device), 1.0).clamp(0.0, 1.0)

    def _blurred(self, images: Tensor) -> Tensor:
        """Return images of which some are blurred, by a Gaussian of three pixels each way."""
        sigma = (self._amounts.blur * self._uniform(len(images))).clamp(min=1e-3)
        chosen = (self._uniform(len(images)) < _BLURRED).nonzero()[:, 0]
        beside = torch.exp(-0.5 / sigma[chosen] ** 2)
        middle = 1.0 / (1.0 + 2.0 * beside)
        own, others = (x.to(images)[:, None, None, None] for x in (middle, middle * beside))
        chosen = chosen.to(images.device)
        some = images[chosen]
        for axis in (2, 3):
            size = some.shape[axis]
            around, some = others * some, own * some
            some.narrow(axis, 1, size - 1).add_(around.narrow(axis, 0, size - 1))
            some.narrow(axis, 0, size - 1).add_(around.narrow(axis, 1, size - 1))
            for edge in (0, size - 1):  # They go on.
                some.narrow(axis, edge, 1).add_(around.narrow(axis, edge, 1))
        return images.index_copy(0, chosen, some)

    def _gain(self, *size: int) -> Tensor:
        """Return factors around 1."""
        return 1.0 + self._amounts.colour * self._spread(*size)

    def _uniform(self, *size: int) -> Tensor:
        """Return numbers from 0 to 1."""
        return torch.rand(size, generator=self._generator)

    def _spread(self, *size: int) -> Tensor:
        """Return numbers from -1 to 1."""
        return 2.0 * self._uniform(*size) - 1.0


def resampled(images: Tensor, view: Tensor) -> Tensor:
    """Return images as another camera would have them: between pixels, and edges go on."""
    return functional.grid_sample(
        images, view.to(images), mode="bilinear", padding_mode="border", align_corners=False
    )
