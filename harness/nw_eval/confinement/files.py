"""What each kind of untrusted file may do; `docs/concepts/security.md` shows this table.

A confined process is behind the fence of the operating system, with limits of time and memory.
Numbers stand where they are held to: `rules.py`, `rollout/confined/access.py`, `policies/safety`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Where = Literal["a confined process", "the main process", "both", "an open process"]


@dataclass(frozen=True, kw_only=True)
class UntrustedFile:
    """A kind of file that may come from a third party."""

    kind: str
    read_by: str
    where: Where
    may: str
    """What it can make this program do."""
    refused: str
    """What is refused before it is read, or while it is."""


_ARCHIVE = "pickles with anything but tensors, sizes over the limits, zip bombs"

FILES: tuple[UntrustedFile, ...] = (
    UntrustedFile(
        kind="ONNX checkpoint",
        read_by="onnxruntime",
        where="a confined process",
        may="arithmetic",
        refused="external data, custom operators, nested functions and sizes over the limits",
    ),
    UntrustedFile(
        kind="TorchScript checkpoint",
        read_by="torch.jit",
        where="a confined process",
        may="compute anything in its own sandboxed process",
        refused=f"without a sandbox, unless `--allow-code`; {_ARCHIVE}",
    ),
    UntrustedFile(
        kind="torch.export checkpoint",
        read_by="a reader of our own, which calls torch's operators",
        where="a confined process",
        may="compute anything in its own sandboxed process",
        refused=f"without a sandbox, unless `--allow-code`; {_ARCHIVE}",
    ),
    UntrustedFile(
        kind="state dict, safetensors, zip of Stable-Baselines3, parameters of brax (a pickle) and "
        "flax (msgpack)",
        read_by="readers of our own, msgpack",
        where="a confined process",
        may="fill the networks that we know",
        refused=_ARCHIVE,
    ),
    UntrustedFile(
        kind="any of these checkpoints, for the digest of what it computes "
        "([how](baseline.md#one-candidate-many-files))",
        read_by="readers of our own, zipfile, json, pickletools",
        where="the main process",
        may="give a digest",
        refused="nothing is run or unpickled; what cannot be read, or is over the limits, counts "
        "with its SHA-256",
    ),
    UntrustedFile(
        kind="Python code of a policy",
        read_by="Python, this one or the card's `python`",
        where="a confined process",
        may="compute anything in its own sandboxed process",
        refused="all of it, without `--allow-code`",
    ),
    UntrustedFile(
        kind="Python code of a card's sensors and wrappers",
        read_by="Python",
        where="an open process",
        may="whatever you may",
        refused="all of it, without `--allow-code`",
    ),
    UntrustedFile(
        kind="policy card, suite",
        read_by="ruamel.yaml, pydantic",
        where="the main process",
        may="choose among what we offer",
        refused="tags, aliases that grow, unknown keys, paths that leave its folder",
    ),
    UntrustedFile(
        kind="YAML and JSON beside a checkpoint, for `policies init`",
        read_by="ruamel.yaml",
        where="a confined process",
        may="say what the drafted card says",
        refused="nothing of a tag is run; files over 1 MiB, aliases that grow and what is no "
        "number are left out",
    ),
    UntrustedFile(
        kind="YAML of a LEAPP bundle, and the state that it begins with, for `policies init`",
        read_by="ruamel.yaml, a reader of our own",
        where="both",
        may="say which file of its folder is the policy, and what the drafted card says",
        refused="paths that leave its folder, files over 1 MiB, more than 17 nodes",
    ),
    UntrustedFile(
        kind="folder of an Orbax checkpoint, for `policies fold`",
        read_by="TensorStore",
        where="a confined process",
        may="give arrays by their names",
        refused="files outside of its folder, other types than numbers, sizes over the limits",
    ),
    UntrustedFile(
        kind="`VecNormalize` of Stable-Baselines3 (a pickle), for `policies init`",
        read_by="a reader of our own",
        where="a confined process",
        may="say the numbers of a normaliser",
        refused="calls that arrays do not need, files over 4 MiB",
    ),
    UntrustedFile(
        kind="scene: YAML, XML, meshes",
        read_by="readers of our own, trimesh",
        where="the main process",
        may="shape a scene",
        refused="paths that leave its folder, numbers out of bounds, sizes over the limits",
    ),
    UntrustedFile(
        kind="scan, for `scenes import`: mesh with textures, elevation map (PNG, GeoTIFF)",
        read_by="readers of our own, Pillow",
        where="the main process",
        may="shape and colour a scene",
        refused="textures outside of its folder, pictures but JPEG, PNG, WebP and TIFF, sizes over "
        "the limits",
    ),
    UntrustedFile(
        kind="robot: YAML, MJCF or URDF, meshes",
        read_by="readers of our own, trimesh; MuJoCo's compiler gets one text without paths",
        where="both",
        may="be a body that physics simulates",
        refused="elements that are not a body's, paths that leave its folder, sizes over the "
        "limits",
    ),
    UntrustedFile(
        kind="splat: PLY, SPZ, SOG, SPLAT, gsplat PT",
        read_by="NumPy; Pillow for SOG; torch with `weights_only` for PT",
        where="the main process",
        may="colour a scene",
        refused="counts that the file does not hold, pickles with anything but tensors",
    ),
    UntrustedFile(
        kind="log of a trial (MCAP)",
        read_by="mcap, zstandard; its trial runs again, a report reads walks and pictures, and "
        "`verify` compares messages, in confined processes",
        where="both",
        may="name a built-in scene or a folder, and a policy's card, which is then untrusted",
        refused="code, servers and renderers that its reader did not name",
    ),
    UntrustedFile(
        kind="folder of a run, for `report --site` and the index of runs",
        read_by="readers of our own, pyarrow, the reader of logs in confined processes",
        where="the main process",
        may="name files of its own folder, as rows say them",
        refused="links, devices and pipes among what is read, over 16 GiB, rows and logs that are "
        "not those of the run's end",
    ),
    UntrustedFile(
        kind="repository of a hub, zip of a published scene, archive of MuJoCo Menagerie",
        read_by="readers of our own, zipfile; the package `mujoco-menagerie` with tarfile",
        where="the main process",
        may="be files in a folder of the cache",
        refused="names that leave it, links, counts and sizes over the limits, bytes of another "
        "digest",
    ),
    UntrustedFile(
        kind="rows: journal, Parquet, run.json, digests.json",
        read_by="json, pyarrow, pydantic",
        where="the main process",
        may="be judged",
        refused="rows whose checksum does not fit",
    ),
    UntrustedFile(
        kind="answers of a policy's server",
        read_by="msgpack: the greeting in the main process, all later messages in confined ones",
        where="both",
        may="be actions, words of an error",
        refused="messages over the limits, other types",
    ),
)

_HEAD = ("file", "read by", "where", "may", "refused")


def table() -> str:
    """Return the kinds of files as a Markdown table."""
    rows = [_HEAD, tuple("---" for _ in _HEAD)]
    rows += [(file.kind, file.read_by, file.where, file.may, file.refused) for file in FILES]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
