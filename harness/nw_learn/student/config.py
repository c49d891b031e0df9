"""The config of a student: what it sees, which network it is, how it is taught."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated

from pydantic import Field, model_validator

from nw_base.digest import digest_of
from nw_learn.config import ConfigModel, TrainingConfig
from nw_policies.cards.model import Rate
from nw_sim.rendering import PUBLISHED, Rendering

NOTHING = "nothing"
"""`start` of a network whose weights are drawn."""

_LAST_RATE = 0.01
"""Of the learning rate, at the end of a round."""
_WARM_UP = 0.02
"""Share of a round in which the learning rate rises from zero."""

Width = Annotated[int, Field(ge=8, le=1024)]


class Sees(ConfigModel):
    """What the student is given; the teacher sees what its own card says."""

    rgb: bool = True
    """Images of the scene's splat."""
    depth: bool = False
    """Depth images of its geometry, up to `depth_clip`."""
    cones: bool = True
    """Whether a traffic cone stands on each waypoint of the images."""
    direction: bool = True
    """Whether the angle to the next waypoint is told."""
    width: int = Field(default=80, ge=16, le=320)
    """Columns of an image, pixels."""
    height: int = Field(default=45, ge=16, le=180)
    """Rows of an image, pixels."""
    rate: Rate = 10
    """Images a second, Hz."""
    frames: int = Field(default=3, ge=1, le=8)
    """Images at a time: the newest and those before it."""
    depth_clip: float = Field(default=4.0, gt=0.0)
    """Farther is not told apart, m."""

    @model_validator(mode="after")
    def _something(self) -> Sees:
        if not (self.rgb or self.depth):
            raise ValueError("a student without rgb and depth sees nothing; set one of them true")
        return self

    @property
    def cameras(self) -> tuple[str, ...]:
        """The observations that are images, in the network's order."""
        return tuple(name for name in ("rgb", "depth") if getattr(self, name))


class NetworkSizes(ConfigModel):
    """Action chunking with transformers (arXiv 2304.13705), small: no latent variable.

    Arms can wait for an average of what was meant a second ago, legs cannot: chunks are a tenth of
    a second long, and their newest prediction counts most.
    """

    chunk: int = Field(default=5, ge=1, le=100)
    """Actions of a prediction: those of this step and the next ones."""
    ensemble: Annotated[float, Field(ge=-10.0, le=10.0)] = -0.7
    """m of temporal ensembling, weights exp(-m i) with the oldest prediction first: below 0 the
    newest counts most."""
    width: Width = 160
    heads: int = Field(default=4, ge=1, le=64)
    feedforward: Width = 320
    encoder_layers: int = Field(default=1, ge=1, le=12)
    decoder_layers: int = Field(default=1, ge=1, le=12)
    convolutions: list[Width] = Field(default=[16, 32, 32, 64, 64], min_length=1, max_length=8)
    """Channels of the image encoder; each layer halves the image."""

    @model_validator(mode="after")
    def _shared(self) -> NetworkSizes:
        if self.width % (4 * self.heads) and (self.width % self.heads or self.width % 4):
            message = f"{self.heads} heads cannot share a width of {self.width}"
            raise ValueError(f"{message}; give a width that 4 and the heads divide")
        return self


class Randomise(ConfigModel):
    """How images of the training differ from those that were rendered; 0 = not at all."""

    rotation: float = Field(default=4.0, ge=0.0, le=45.0)
    """Largest roll of the camera, degrees."""
    crop: float = Field(default=0.06, ge=0.0, lt=0.5)
    """Largest share of a side that is cut away, and the rest stretched over it."""
    blur: float = Field(default=0.8, ge=0.0, le=5.0)
    """Largest standard deviation of a Gaussian blur of colours, pixels."""
    colour: float = Field(default=0.3, ge=0.0, lt=1.0)
    """Largest change of brightness, contrast, saturation and each colour's gain, as a share."""
    depth_noise: float = Field(default=0.02, ge=0.0, le=1.0)
    """Largest standard deviation of depth, as a share of itself."""
    dropped: float = Field(default=0.05, ge=0.0, lt=1.0)
    """Largest share of depth pixels that read as nothing."""


class Learns(ConfigModel):
    """How the network follows the teacher's actions."""

    batch_images: int = Field(default=48, ge=1, le=4096)
    """Images of a step, each with all control steps that it is the newest image of."""
    learning_rate: float = Field(default=3e-3, gt=0.0, le=1.0)
    """Of AdamW at the start of a round; a cosine brings it to a hundredth at the round's end."""
    later_rounds: float = Field(default=1.0, gt=0.0, le=1.0)
    """The learning rate of each round as a share of that of the round before."""
    weight_decay: float = Field(default=1e-4, ge=0.0)

    def rate(self, number: int, *, done: float) -> float:
        """Return the learning rate in a round, from 1, of which a share is `done`, 0 to 1."""
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))
        share = min(done / _WARM_UP, 1.0) * (_LAST_RATE + (1.0 - _LAST_RATE) * cosine)
        return self.learning_rate * self.later_rounds ** (number - 1) * share


class StudentConfig(TrainingConfig):
    """DAgger (arXiv 1011.0686): the student drives, the teacher says what it would have done."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,55}$")]
    """Name of the policy that comes out: a-z, 0-9, '.', '_' and '-'."""
    teacher: str = "go1-parkour"
    """The policy that is asked, named as for `nw-eval run --policy`."""
    start: Annotated[str, Field(min_length=1)] = NOTHING
    """What the network begins as: `nothing`, or the .pt file of a student's training of the same
    network. It drives in the first round as a student does in the second one."""
    scenes: list[str] = Field(default=["split:train"], min_length=1)
    """Where trajectories are driven: names, globs and folders as in suites. Evaluation scenes are
    left out."""
    rounds: int = Field(default=4, ge=1, le=100)
    """Rounds of collecting and learning, each of an equal share of the budget. The teacher drives
    in the first one, unless there is a network to `start` with."""
    trajectories: int = Field(default=1000, ge=1, le=100_000)
    """Trajectories of a round, spread evenly over the scenes."""
    teacher_share: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of trajectories that the teacher drives in the first round in which a student drives;
    beta of the paper, which is raised to the number of the round."""
    duration: float = Field(default=20.0, gt=0.0, le=600.0)
    """Simulated time after which a trajectory ends, s."""
    dataset_gib: float = Field(default=8.0, gt=0.0)
    """Largest size of all trajectories, in memory and on disk, GiB; collecting ends there."""
    sees: Sees = Sees()
    render: Rendering = PUBLISHED
    """How its images of splats are drawn, as `render` of a suite."""
    network: NetworkSizes = NetworkSizes()
    randomise: Randomise = Randomise()
    learns: Learns = Learns()

    def taught_share(self, number: int) -> float:
        """Return the share of trajectories that the teacher drives in a round, from 1."""
        return self.teacher_share ** (number - (self.start == NOTHING))

    @property
    def digest(self) -> str:
        """Hex sha256 of what decides the curve as far as it goes.

        More rounds may follow, each with as large a share of the budget: they change nothing of
        those before them.
        """
        without = {"device", "rounds", "budget"} | ({"start"} if self.start == NOTHING else set())
        fields = self.model_dump(mode="json", by_alias=True, exclude=without)
        if self.learns.later_rounds == 1.0:  # Trainings from before there was such a key go on.
            del fields["learns"]["later_rounds"]
        if self.render == PUBLISHED:
            del fields["render"]
        return digest_of(fields | {"samples": str(Fraction(self.budget.steps, self.rounds))})
