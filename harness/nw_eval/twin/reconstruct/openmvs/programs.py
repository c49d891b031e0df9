"""OpenMVS's programs, run one after the other."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from nw_eval.errors import PrerequisiteError, SceneError
from nw_eval.twin.capture import Capture
from nw_eval.twin.reconstruct.mesh_file import ColourMesh, read_colour_mesh
from nw_eval.twin.reconstruct.openmvs.colmap_model import write_colmap_model

PROGRAMS = ("InterfaceCOLMAP", "DensifyPointCloud", "ReconstructMesh")
_LAST = 4096
"""Bytes of a log in which its last line is looked for."""


def openmvs_mesh(
    capture: Capture, folder: Path, work: Path, say: Callable[[str], None], threads: int = 2
) -> ColourMesh:
    """Return OpenMVS's mesh of a capture; it has no colours.

    Args:
        capture: as read from its folder.
        folder: of the capture.
        work: a folder that the programs work in, beside their logs `<program>.log`.
        say: is told which program runs.
        threads: that the programs may use.

    Raises:
        PrerequisiteError: a program is not on PATH.
        SceneError: a program fails or leaves no mesh; a picture cannot be read.
        StoreError: a file cannot be written.
    """
    paths = {name: shutil.which(name) for name in PROGRAMS}
    missing = [name for name, path in paths.items() if path is None]
    if missing:
        raise PrerequisiteError(
            f"not on PATH: {', '.join(missing)}",
            fix="install OpenMVS, or reconstruct with the engine sweep",
        )
    work = work.resolve()
    write_colmap_model(capture, folder, work / "colmap")
    shared = ["-w", str(work), "--max-threads", str(threads)]
    images = str(work / "colmap" / "images")
    arguments = {
        "InterfaceCOLMAP": [
            "-w", str(work), "-i", str(work / "colmap"), "-o", "scene.mvs",
            "--image-folder", images,
        ],
        "DensifyPointCloud": [*shared, "-i", "scene.mvs", "-o", "dense.mvs"],
        "ReconstructMesh": [*shared, "-i", "dense.mvs", "-o", "mesh.mvs"],
    }  # fmt: skip
    mesh = work / "mesh.ply"
    mesh.unlink(missing_ok=True)  # What an earlier run left is no result of this one.
    for name, path in paths.items():
        say(f"runs {name}")
        _run(str(path), arguments[name], work, name)
    if not mesh.is_file():
        raise SceneError(
            f"{PROGRAMS[-1]} ended well and wrote no {mesh.name}",
            fix=f"read {work / PROGRAMS[-1]}.log",
        )
    return read_colour_mesh(mesh)


def _run(program: str, arguments: list[str], work: Path, name: str) -> None:
    log = work / f"{name}.log"
    with log.open("wb") as file:
        try:
            done = subprocess.run(  # noqa: S603  # A list of arguments, no shell.
                [program, *arguments],
                cwd=work,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                check=False,
            )
        except OSError as error:
            raise SceneError(
                f"{program} cannot be run: {error.strerror}", fix="install OpenMVS again"
            ) from None
    if done.returncode != 0:
        lines = log.read_bytes()[-_LAST:].decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "nothing")
        raise SceneError(
            f"{name} failed with {done.returncode}; it said last: {last}", fix=f"read {log}"
        )
