"""Networks beside a checkpoint that may feed it: named in comments, or read as encoders of images.

A deploy configuration says that a policy sees an image, whose numbers are those of an encoder: the
graph beside it that takes one image and gives as many numbers as are left.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_STORED, BadZipFile, ZipFile

from nw_base.errors import PolicyError
from nw_base.files.inside import bounded_bytes, what_is
from nw_policies.bundle import SIZE_LIMIT
from nw_policies.drafting.checkpoint import CheckpointFacts, inspect_checkpoint
from nw_policies.drafting.inputs import image_lines
from nw_policies.drafting.notation import RATE_LINE, key, number, plain, quoted
from nw_policies.drafting.vectors import ObservationDraft, term_of
from nw_policies.safety import file_kind

_ZEROS = re.compile(r"\s*- \{term: constant, value: 0, width: (\d+)\}")
_IMAGE_AXES = 3
"""Axes that an image has at least, beside that of a batch."""


def with_encoders(
    by_input: Mapping[str, list[ObservationDraft]], facts: CheckpointFacts, beside: Sequence[str]
) -> tuple[dict[str, list[ObservationDraft]], list[str]]:
    """Return observations in which an encoder's image stands for zeros; and lines of `networks`.

    Args:
        by_input: the observations that make each input.
        facts: of the checkpoint, with what files beside it say.
        beside: paths of graphs that may feed it.
    """
    found = {name: list(parts) for name, parts in by_input.items()}
    lines: list[str] = []
    for path in beside if any(map(_zeros, (p for ps in found.values() for p in ps))) else ():
        try:
            encoder = inspect_checkpoint(Path(path))
        except PolicyError:
            continue  # It is no network that a card can name.
        if len(encoder.inputs) != 1 or len(encoder.inputs[0].shape) <= _IMAGE_AXES:
            continue
        gives = [array.shape[-1] for array in encoder.outputs if array.shape]
        for parts in found.values():
            for place, part in enumerate(parts):
                if len(gives) == 1 and _zeros(part) == gives[0]:
                    name = _network_name(Path(path))
                    parts[place] = _image(name, encoder, facts)
                    lines += _network(name, encoder)
    return found, [*(["networks:"] if lines else []), *lines, *([""] if lines else [])]


def _zeros(part: ObservationDraft) -> int | None:
    """Return how many zeros an observation is; None for one that has other terms."""
    terms = [line for line in part.lines if line.lstrip().startswith("- ")]
    match = _ZEROS.match(terms[0]) if len(terms) == 1 else None
    return int(match[1]) if match else None


def _network_name(path: Path) -> str:
    """Return what a card may call a network: a name begins with a letter."""
    return re.sub(r"^[^A-Za-z]+", "", key(path.stem)) or "network"


def _network(name: str, encoder: CheckpointFacts) -> list[str]:
    file = quoted(plain(encoder.path.name))
    return [
        f"  {name}:",
        f"    adapter: {encoder.adapter}",
        f"    checkpoint: {{file: {file}, sha256: {encoder.sha256}}}",
        f"    inputs: [{name}_image]",
    ]


def _image(name: str, encoder: CheckpointFacts, facts: CheckpointFacts) -> ObservationDraft:
    """Return the image that an encoder takes, at the rate that its term says."""
    known = facts.exporter
    terms = known.observation_terms if known else ()
    every = next((term.every for term in terms if term.every and not term_of(term)), None)
    lines = list(image_lines(encoder.inputs[0]))
    if known and known.rate and every and RATE_LINE in lines:
        source = known.sources.get("observation_terms", "")
        rate = f"rate: {number(known.rate / every)}  # every {every} actions, {source}"
        lines[lines.index(RATE_LINE)] = rate
    return ObservationDraft(name=f"{name}_image", lines=tuple(lines), fed=name)


_ADAPTERS = {
    ".jit": "torchscript",
    ".onnx": "onnx",
    ".pt": "torchscript",
    ".pt2": "torch-export",
    ".pth": "torchscript",
}
_MOST = 8
"""Files that are named; a folder of saved steps of a training holds thousands."""
_SAMPLE = 48
"""Bytes that two files share where they hold the same weights."""


def files_beside(checkpoint: Path) -> str:
    """Return the lines under which other files would feed a checkpoint; empty if there are none.

    Nothing of them is run.
    """
    paths = may_feed(checkpoint)
    if not paths:
        return ""
    lines = [
        "",
        "# If a file beside it feeds it, say so, and name it in `inputs` as an observation:",
        "# networks:",
    ]
    for path in paths:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        lines += [
            f"#   {_network_name(path)}:",
            f"#     adapter: {_ADAPTERS[path.suffix]}",
            f"#     checkpoint: {{file: {quoted(plain(path.name))}, sha256: {digest}}}",
            "#     inputs: []  # of the names under `observations`",
        ]
    return "\n".join(lines) + "\n"


def may_feed(checkpoint: Path) -> list[Path]:
    """Return other networks beside a checkpoint; none where there are too many to be meant."""
    paths = [path for path in sorted(checkpoint.parent.glob("*")) if _may_feed(path, checkpoint)]
    if not paths or len(paths) > _MOST:
        return []
    try:
        own = bounded_bytes(checkpoint, SIZE_LIMIT)
    except (OSError, ValueError):  # As whoever opens it says.
        return []
    return [path for path in paths if _is_another(path, own)]


def _is_another(path: Path, own: bytes) -> bool:
    """Whether a file may run, and has not the weights of the checkpoint.

    Two exports of one policy, and the training's own file, hold the same numbers.
    """
    data = path.read_bytes()
    try:
        if file_kind(data, str(path)) in {"state-dict", "pickle", "safetensors"}:
            return False
    except PolicyError:
        return False
    numbers = _numbers(own)
    samples = (numbers[len(numbers) * n // 32 :][:_SAMPLE] for n in range(1, 32))
    return not any(len(set(sample)) > _SAMPLE // 4 and sample in data for sample in samples)


def _numbers(own: bytes) -> bytes:
    """Return the largest tensor of an archive of torch, whose code other files share; else all."""
    try:
        with ZipFile(BytesIO(own)) as archive:
            plain = [each for each in archive.infolist() if each.compress_type == ZIP_STORED]
            tensors = [each for each in plain if re.search(r"/data/\d+$", each.filename)]
            return archive.read(max(tensors, key=lambda each: each.file_size))
    except (BadZipFile, ValueError, OSError, RuntimeError, NotImplementedError):
        return own


def _may_feed(path: Path, checkpoint: Path) -> bool:
    try:
        return (
            path.suffix in _ADAPTERS
            and not path.is_symlink()
            and what_is(path) == "file"
            and not path.samefile(checkpoint)
            and path.stat().st_size <= SIZE_LIMIT
        )
    except OSError:  # It is gone, or not ours to read.
        return False
