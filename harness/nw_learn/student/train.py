"""DAgger: rounds of driving and learning, which go on where they were ended.

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

from nw_base.clean import clean
from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_learn.config import device_of, load_config, one_thread
from nw_learn.curve import Curve
from nw_learn.folder import TrainFolder, read_state
from nw_learn.progress import Keeper, Trained, TrainingProgress
from nw_learn.student.card import (
    BODY,
    ENCODER_FILE,
    NETWORK_FILE,
    check_teacher,
    student_card,
)
from nw_learn.student.config import NOTHING, StudentConfig
from nw_learn.student.driving import Driving, Round, make_ready, plan_round, training_scenes
from nw_learn.student.network import StudentNetwork, as_numbers, write_policy
from nw_learn.student.trajectory import Dataset
from nw_policies import load_bundle
from nw_policies.cards.load import card_of
from nw_sim.rollout.confined.vetting import vet_bundle
from nw_sim.sensors import check_card

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from nw_learn.student.config import Randomise
    from nw_learn.student.trajectory import Minibatch
    from nw_policies import Bundle

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


_ROW_EVERY = 50
"""Steps of the optimiser from one row of the curve to the next."""
_SMOOTH = 0.98
"""Share of the loss before in the smoothed one that the curve shows."""
_GIB = 2**30


def train_student(
    config: Path, out: Path, *, say: Callable[[str], None], workers: int | None = None
) -> Trained:
    """Train a student.

    Args:
        config: the file of a `StudentConfig`.
        out: the folder to make.
        say: takes lines of progress.
        workers: processes that drive (default: one for each core).

    Raises:
        UsageError: the config has problems, or a training is in the folder already.
        NwEvalError: as `StudentTraining` and its `run`.
    """
    settings = load_config(config, StudentConfig)
    folder = TrainFolder.begin(out, config)
    return StudentTraining(settings, folder, say=say, workers=workers).run()


def resume_student(
    folder: Path, *, say: Callable[[str], None], workers: int | None = None
) -> Trained:
    """Go on with a training where its last state is; its curve is an uninterrupted one's.

    Raises:
        UsageError: no training is in the folder.
        NwEvalError: as `StudentTraining` and its `run`.
    """
    there = TrainFolder.resume(folder)
    settings = load_config(there.config, StudentConfig)
    return StudentTraining(settings, there, say=say, workers=workers).run()


class StudentTraining:
    """A training, from its first round or from where it was ended.

    Args:
        config: checked.
        folder: of the training, with its state if it goes on.
        say: takes a line for people.
        workers: processes that drive (default: one for each core).

    Raises:
        PolicyError: the teacher cannot be used.
        SceneError, UsageError: the scenes cannot, or the teacher does not act at 50 Hz.
        PrerequisiteError: there is no such device, or nothing to export a network with.
        IncomparableError: the folder's state is of another config or teacher.
    """

    def __init__(
        self,
        config: StudentConfig,
        folder: TrainFolder,
        *,
        say: Callable[[str], None],
        workers: int | None = None,
    ) -> None:
        one_thread()
        self._config, self._folder, self._say, self._workers = config, folder, say, workers
        teacher = load_bundle(config.teacher)
        check_teacher(teacher.card)
        self._teacher = vet_bundle(teacher, teacher.card.robot)
        self._scenes = training_scenes(config.scenes)
        self._learner = Learner(
            config, proprio=body_size(config, teacher), device=device_of(config.device)
        )
        self._round, self._step, self._samples = 1, 0, 0
        self._loss = 0.0
        self._dataset = Dataset(
            cameras=config.sees.cameras, frames=config.sees.frames, chunk=config.network.chunk
        )
        if (state := folder.load_state()) is None:
            if config.start != NOTHING:
                self._learner.begin(self._start())
            self._write_policies(0)
        else:
            self._restore(state)
        untrained = load_bundle(self.policy(0))
        make_ready(self._scenes, vet_bundle(untrained, untrained.card.robot).card, say)
        self._curve = Curve(
            folder.path,
            upto=None if state is None else self._samples,
            counts="samples",
            say=say,
        )

    def _start(self) -> Path:
        """Return the file of the network to begin with.

        Raises:
            UsageError: there is none.
        """
        path = self._config.base / self._config.start
        if not path.is_file():
            raise UsageError(f"start: no file {path}", fix="name a .pt file of a training")
        return path

    def policy(self, number: int) -> Path:
        """Return the folder of the policy that a round has left; 0 = untrained."""
        return self._folder.path / "policies" / f"round-{number}"

    def run(self) -> Trained:
        """Train until the budget is used up, the minutes are over or a signal comes.

        Raises:
            StoreError: a file cannot be written, or a trajectory is damaged.
            TrialError: no workers can be had.
        """
        budget = self._config.budget
        self._progress = TrainingProgress(
            self._say,
            steps=budget.steps,
            first=self._samples,
            minutes=budget.minutes,
            what="samples",
        )
        keep = self._config.keep_every
        with Keeper(self._folder, self._curve, keep_every=keep, first=self._samples) as keeper:
            self._keeper = keeper
            for number in range(1, self._config.rounds + 1):
                trajectories = self._planned(number)
                is_over = number < self._round
                self._progress.leave()
                if not (is_over or self._drive(trajectories)):
                    break
                figures = self._take(trajectories)
                if is_over:
                    continue
                self._progress.back(self._samples, times=self._config.rounds - number)
                if not self._learn(figures):
                    break
                self._write_policies(number)
                self._round, self._step = number + 1, 0
                keeper.after(self._samples, self.state, is_last=True)
            is_done = self._round > self._config.rounds
            if not is_done:
                keeper.after(self._samples, self.state, is_last=True)
            return self._ended(is_done=is_done)

    def state(self) -> dict[str, Any]:
        """Return everything to go on with; trajectories are files of their own."""
        return {
            "config": self._config.digest,
            "teacher": self._teacher.digest,
            "round": self._round,
            "step": self._step,
            "samples": self._samples,
            "loss": self._loss,
            **self._learner.state(),
        }

    def _ended(self, *, is_done: bool) -> Trained:
        return Trained(
            program="student",
            folder=self._folder.path,
            policy=self.policy(self._round - 1),
            step=self._samples,
            is_done=is_done,
            is_interrupted=self._keeper.is_interrupted,
        )

    def _restore(self, state: dict[str, Any]) -> None:
        for name, ours in (("config", self._config.digest), ("teacher", self._teacher.digest)):
            if state.get(name) != ours:
                raise IncomparableError(
                    f"{self._folder.path} is of another {name}: {str(state.get(name))[:8]}, here "
                    f"it is {ours[:8]}",
                    fix="train in a new folder, or restore what it started with",
                )
        try:
            self._round, self._step = int(state["round"]), int(state["step"])
            self._samples, self._loss = int(state["samples"]), float(state["loss"])
            self._learner.restore(state)
        except (KeyError, TypeError, AttributeError, ValueError, RuntimeError) as error:
            raise StoreError(
                f"{self._folder.state} is not a state of this training: {error!r}",
                fix="train in a new folder",
            ) from None

    def _planned(self, number: int) -> Round:
        return plan_round(
            number,
            self._config,
            self._scenes,
            self._folder.path / "trajectories" / f"round-{number}",
            student=load_bundle(self.policy(number - 1)),
            teacher=self._teacher,
        )

    def _drive(self, trajectories: Round) -> bool:
        """Drive what is missing of a round; return whether that is done."""
        most = int(self._config.dataset_gib * _GIB) - self._dataset.nbytes
        driving = Driving(trajectories, say=self._say, most=most, workers=self._workers)
        return driving.run(lambda: self._is_ending)

    def _take(self, trajectories: Round) -> dict[str, float]:
        """Take a round's trajectories into the dataset; return what they came to."""
        most = int(self._config.dataset_gib * _GIB)
        successes: dict[str, list[float]] = {}
        for job, one in trajectories.read():
            if self._dataset.nbytes >= most:
                self._say(
                    f"the dataset has {self._config.dataset_gib:g} GiB: the remaining samples "
                    "are left out"
                )
                break
            self._dataset.add(one)
            for group in ("all", job.trial.task):
                successes.setdefault(group, []).append(one.success)
        figures = {f"driving/{group}": sum(all_) / len(all_) for group, all_ in successes.items()}
        return figures | {
            "trajectories/so far": float(len(self._dataset.trajectories)),
            "control steps/so far": float(self._dataset.steps),
        }

    def _learn(self, figures: dict[str, float]) -> bool:
        """Learn until the round's share of the budget is used up; return whether it is."""
        config, number, learner = self._config, self._round, self._learner
        first, last = (config.budget.steps * n // config.rounds for n in (number - 1, number))
        if number == 1 and self._step == 0 and config.start == NOTHING:
            learner.normalise(self._dataset.moments())
        success = figures.get("driving/all", 0.0)
        while self._samples < last:
            if self._is_ending:
                return False
            done = max(self._samples - first, 0) / max(last - first, 1)
            result = learner.step(self._dataset, number=number, step=self._step, done=done)
            self._step += 1
            self._samples += int(result["samples"])
            loss = result["loss"]
            self._loss = loss if self._step == 1 else _SMOOTH * self._loss + (1 - _SMOOTH) * loss
            if self._step == 1 or self._step % _ROW_EVERY == 0 or self._samples >= last:
                row = {"learning/loss": self._loss, "round/number": float(number)}
                self._curve.append(self._samples, row | (figures if self._step == 1 else {}))
            self._progress.update(
                self._samples,
                f"round {number} of {config.rounds}",
                {"loss": self._loss, "driving": success},
            )
            self._keeper.after(self._samples, self.state)
        return True

    @property
    def _is_ending(self) -> bool:
        return self._keeper.is_interrupted or self._progress.is_time_up

    def _write_policies(self, number: int) -> None:
        """Write the student as it is, and with the mean image for good."""
        network, teacher = self._learner.network, self._teacher.card
        for is_blind in (False, True):
            folder = self.policy(number)
            folder = folder.with_name(f"{folder.name}-frozen") if is_blind else folder
            write_policy(folder, network, self._config, teacher, is_blind=is_blind)


def body_size(config: StudentConfig, teacher: Bundle) -> int:
    """Return how many numbers of its body a student is told."""
    digests = {NETWORK_FILE: "0" * 64, ENCODER_FILE: "0" * 64}
    card = card_of(student_card(config.name, config.sees, teacher.card, sha256=digests))
    sizes = {spec.name: spec.shape[0] for spec in check_card(card)}
    return sum(sizes[name] for name in BODY)
