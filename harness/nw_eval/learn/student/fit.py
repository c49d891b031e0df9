"""The steps in which a student learns: batches, their loss, the optimiser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.learn.program.folder import read_state
from nw_eval.learn.student.export import as_numbers
from nw_eval.learn.student.network import StudentNetwork
from nw_eval.learn.student.randomise import Randomiser, resampled

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

    from nw_eval.learn.student.config import StudentConfig
    from nw_eval.learn.student.data.dataset import Dataset, Minibatch

_LARGEST_GRADIENT = 1.0


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
