"""Image encoders of ACT: ResNet-18 or 34 without its head, or a plain stack of convolutions.

Which of them a state dict holds is read from its names: `conv1`, `bn1`, `layer1.0.conv1`, ... are
torchvision's ResNet; `0`, `2`, `4`, ... are convolutions of stride 2, each followed by a ReLU.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

Shapes = Mapping[str, tuple[int, ...]]


def backbone_for(shapes: Shapes) -> nn.Module:
    """Return the encoder whose state dict has these shapes."""
    return ResNet(shapes) if "conv1.weight" in shapes else ConvStack(shapes)


def output_channels(shapes: Shapes) -> int:
    """Return the number of feature maps that an encoder ends with: its last convolution's."""
    kernels = [
        shape for name, shape in shapes.items() if len(shape) == 4 and "downsample" not in name
    ]
    return kernels[-1][0] if kernels else 0


class ConvStack(nn.Sequential):
    """Convolutions of stride 2 with ReLU; each halves the image, rounding up."""

    def __init__(self, shapes: Shapes) -> None:
        layers: list[nn.Module] = []
        for name, shape in shapes.items():
            if name.endswith(".weight") and len(shape) == 4:
                outputs, inputs, kernel, _ = shape
                layers += [
                    nn.Conv2d(inputs, outputs, kernel, stride=2, padding=kernel // 2),
                    nn.ReLU(),
                ]
        super().__init__(*layers)


class FrozenNorm(nn.Module):
    """Batch norm with fixed statistics."""

    weight: Tensor
    bias: Tensor
    running_mean: Tensor
    running_var: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.empty(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Normalise (n, channels, rows, columns)."""
        return functional.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias)


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.bn1 = FrozenNorm(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = FrozenNorm(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False), FrozenNorm(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, outputs, rows / stride, columns / stride)."""
        short = x if self.downsample is None else self.downsample(x)
        return functional.relu(
            self.bn2(self.conv2(functional.relu(self.bn1(self.conv1(x))))) + short
        )


class ResNet(nn.Module):
    """ResNet of basic blocks up to its last feature map."""

    def __init__(self, shapes: Shapes) -> None:
        super().__init__()
        channels, inputs, _, _ = shapes["conv1.weight"]
        self.conv1 = nn.Conv2d(inputs, channels, 7, stride=2, padding=3, bias=False)
        self.bn1 = FrozenNorm(channels)
        for stage in range(1, 5):
            blocks: list[nn.Module] = []
            outputs = 64 * 2 ** (stage - 1)
            for block in range(_count(shapes, f"layer{stage}.")):
                stride = 2 if stage > 1 and block == 0 else 1
                blocks.append(BasicBlock(channels, outputs, stride))
                channels = outputs
            self.add_module(f"layer{stage}", nn.Sequential(*blocks))

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, 512, rows / 32, columns / 32)."""
        x = functional.max_pool2d(functional.relu(self.bn1(self.conv1(x))), 3, stride=2, padding=1)
        for stage in range(1, 5):
            x = getattr(self, f"layer{stage}")(x)
        return x


def _count(names: Iterable[str], prefix: str) -> int:
    """Return how many numbered parts follow a prefix: `layer1.0`, `layer1.1` are two."""
    return len({name[len(prefix) :].split(".")[0] for name in names if name.startswith(prefix)})
