"""Real scenes that may be fetched: `real:NAME`, one file of a public repository each.

nw-eval ships none of them. A file is fetched from where its makers published it, compared with the
SHA-256 that is kept here, and made into a scene folder of the cache.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import FetchError, SceneError, StoreError, nearest
from nw_base.files.inside import bounded_bytes
from nw_scenes.elevation_file import elevation_mesh, read_elevation
from nw_scenes.hub import listener
from nw_scenes.hub.reference import Fetched, Reference, digest_of, kept, put_in_place

REAL = "real:"

_SILENCE = 30.0  # s


@dataclass(frozen=True, kw_only=True)
class RealScan:
    """An elevation map that somebody published.

    Attributes:
        title: one line for people.
        repository: where it is published.
        commit: of the repository, 40 hexadecimal digits.
        path: of the file in it.
        sha256: of the file.
        bytes: of the file.
        licence: of the repository: an SPDX identifier, and whose.
        cell: width of a pixel, m.
        black, white: heights of black and white, m; the ground under the start is at 0.
        scene: the rest of its scene.yaml: task, course and spawn.
    """

    title: str
    repository: str
    commit: str
    path: str
    sha256: str
    bytes: int
    licence: str
    cell: float
    black: float
    white: float
    scene: str

    @property
    def address(self) -> str:
        """Where the file lies."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{self.path}"


_STAIRS_START = 41 / 255 * 1.25
"""Height of the ground in the map where the robot starts, m."""

REAL_SCANS: Mapping[str, RealScan] = MappingProxyType(
    {
        "stairs": RealScan(
            title="Three steps of real stairs, an elevation map of 4 cm a cell",
            repository="leggedrobotics/elevation_mapping_cupy",
            commit="20a8a26b67a995b43eb44c23568854d1fed82a52",
            path="plane_segmentation/convex_plane_decomposition_ros/data/real_stairs_125cm.png",
            sha256="24c033cd0216645a5aed88c118c04d62843c8b32146a1261f3347aff75618384",
            bytes=4211,
            licence="MIT, ETH Zurich, Takahiro Miki",
            cell=0.04,
            black=-_STAIRS_START,
            white=1.25 - _STAIRS_START,
            scene="""\
task: stairs
trail: [[2.5, 1.3, 0.1863], [1.2, 1.3, 0.5588]]
spawn: {position: [4.4, 1.3, 0], yaw: 3.1416, x_jitter: 0.05, y_jitter: 0.1, yaw_jitter: 0.1}
waypoint_noise: [0.0, 0.1]
""",
        ),
    }
)


def scan_of(reference: str) -> RealScan:
    """Return what `real:NAME` names.

    Raises:
        SceneError: nothing.
    """
    name = reference.removeprefix(REAL)
    if name not in REAL_SCANS:
        raise SceneError(
            f"no real scene is called {clean(name, at_most=60)!r}", fix=nearest(name, REAL_SCANS)
        )
    return REAL_SCANS[name]


def _place_of(reference: str, scan: RealScan) -> Reference:
    name = reference.removeprefix(REAL)
    return Reference(
        text=reference,
        kind="scene",
        repository=f"real-places/{name}",
        revision=scan.commit,
        label=name,
    )


def kept_scan(reference: str) -> Fetched:
    """Return a real scene that was fetched before; nothing but `scenes fetch` uses the network.

    Raises:
        SceneError: there is no such scene, or it has not been fetched.
    """
    scan = scan_of(reference)
    fetched = kept(_place_of(reference, scan), scan.commit)
    if fetched is None:
        raise SceneError(f"{reference} is not here", fix=f"nw-eval scenes fetch {reference}")
    return fetched


def fetched_scan(
    reference: str, scan: RealScan, *, file: Path | None = None, address: str | None = None
) -> Fetched:
    """Return a real scene as a scene folder in the cache, fetched if it is not there.

    Args:
        reference: `real:NAME`.
        scan: what that is.
        file: the file itself, fetched on another machine; None = it is fetched from its address.
        address: where it is fetched from; None = where its makers published it.

    Raises:
        FetchError: it cannot be fetched.
        SceneError: what came, or `file`, is not the file that is known.
        StoreError: it cannot be kept.
    """
    name, place = reference.removeprefix(REAL), _place_of(reference, scan)
    fetched = kept(place, scan.commit)
    if fetched is not None:
        if file is not None:
            _check_known(reference, scan, sha256(_given(file, scan)).hexdigest(), str(file))
        return fetched
    origin = scan.address if address is None else address

    def fill(folder: Path) -> list[str]:
        source = folder / "map.png"
        source.write_bytes(
            _downloaded(reference, scan, origin) if file is None else _given(file, scan)
        )
        _check_known(reference, scan, digest_of(source), str(file or origin))
        elevation = read_elevation(source, cell=scan.cell, white=scan.white, black=scan.black)
        vertices, faces = elevation_mesh(elevation)
        (folder / "collision.ply").write_bytes(_ply(vertices, faces))
        (folder / "scene.yaml").write_text(
            f"# {scan.path}\n# of {scan.repository}, commit {scan.commit}.\n"
            f"nw-scene: 1\nname: real/{name}\ntitle: {scan.title}\nlicence: {scan.licence}\n"
            f"collision: collision.ply\n{scan.scene}",
            encoding="utf-8",
        )
        return ["map.png", "collision.ply", "scene.yaml"]

    try:
        return put_in_place(place, scan.commit, f"https://{urlsplit(scan.address).netloc}", fill)
    except OSError as error:
        raise StoreError(
            f"{reference} cannot be kept: {error.strerror or error}",
            fix="free space, or set NW_EVAL_CACHE to a folder that can be written",
        ) from error


def _check_known(reference: str, scan: RealScan, digest: str, origin: str) -> None:
    """Refuse another file than the one that is known.

    Raises:
        SceneError: its digest is another one.
    """
    if digest != scan.sha256:
        raise SceneError(
            f"{reference}: {origin} is not the file that is known: its SHA-256 is {digest}, not "
            f"{scan.sha256}",
            fix="fetch it again, or give the file of commit " + scan.commit[:12],
        )


def _given(file: Path, scan: RealScan) -> bytes:
    try:
        return bounded_bytes(file, scan.bytes)
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{file}: {reason}", fix=f"give {scan.path}") from None


def _downloaded(reference: str, scan: RealScan, address: str) -> bytes:
    host = urlsplit(address).netloc
    listener().message(f"fetching {reference}: {scan.bytes} bytes from {host}, {scan.licence}")
    request = Request(address, headers={"User-Agent": "nw-eval"})  # noqa: S310 - of the table.
    try:
        with urlopen(request, timeout=_SILENCE) as answer:  # noqa: S310
            return answer.read(scan.bytes + 1)
    except (URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise FetchError(
            f"{reference}: cannot fetch {address}: {clean(str(reason), at_most=200)}",
            fix="check the network and proxy; or fetch the file elsewhere, and name it: "
            f"nw-eval scenes fetch {reference} --file {Path(scan.path).name}",
        ) from None


def _ply(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bytes:
    """Return a PLY file of triangles."""
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    return head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()
