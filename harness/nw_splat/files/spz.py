"""SPZ, Niantic's format: each attribute quantised to bytes, then compressed.

Versions 1 to 3 are one gzip stream: a 16-byte header, then all positions, opacities, colours,
scales, rotations and harmonics. Version 4 is a 32-byte plain header, a table of contents, and one
zstd stream for each attribute. Axes are right-up-back, those of a 3DGS PLY right-down-front: y
and z change sign on the way, and with them the quaternion's y and z and the harmonics that are
odd in y z. After nianticlabs/spz (load-spz.cc, splat-utils.h).

Flag 1 says that the splat was trained antialiased, flag 2 that records of extensions follow: behind
the stream of versions 2 and 3, between header and table in version 4. One of them names other axes,
one bounds a viewer's camera and is passed over, others are noted by number.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError, SceneError
from nw_splat.files.format import SplatFormat
from nw_splat.gaussians import (
    SH_COUNTS,
    Gaussians,
    check_count,
    logit,
    sigmoid,
    to_byte,
    transformed,
    unit_quats,
)
from nw_splat.gaussians import harmonics as harmonics_at

Bytes = NDArray[np.uint8]
SpzVersion = Literal[2, 3, 4]

_MAGIC = 0x5053474E  # "NGSP"
_COUNTS = (1, 4, 9, 16, 25)
_COLOUR = 0.15  # Wide range: harmonics may bring colours back into 0..1.
_RATIO = 100  # No honest large file expands further; more is a decompression bomb.
_SMALL = 1 << 26
_FRACTION_BITS = 12
_SQRT_HALF = 0.7071067811865476
_BROKEN = "the file is damaged; export it again"
_ANTIALIASED, _EXTENDED = 1, 2
_EXTENSION_BYTES = 1 << 20
_AXES_RECORD = 0xADBE0003  # SPZ_ADOBE_coordinate_system
_ORBIT_RECORD = 0xADBE0002  # SPZ_ADOBE_safe_orbit_camera: where viewers let one look from
_SYSTEMS = (
    "RUB", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",
    "LBU", "RBU", "LFU", "RFU", "LBD", "RBD", "LFD", "RFD",
)  # fmt: skip
"""What x, y and z point to, by the record's number; 0 says nothing. As nianticlabs' library packs
them: its header calls 9 and 10 LFD and RFD, 15 and 16 LBU and RBU, and converts the other way."""
_POINTING = {
    "R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1),
    "B": (0, 0, -1),
}  # fmt: skip
"""Directions in the axes of a 3DGS PLY: right, down, front."""

# Sign of each harmonic under (x, y, z) -> (x, -y, -z), in 3DGS order.
_SH_SIGNS = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], dtype=np.float32)
_AXES = np.array([1, -1, -1], dtype=np.float32)
_QUAT_SIGNS = np.array([1, 1, -1, -1], dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class _Header:
    version: int
    count: int
    sh_count: int
    fraction_bits: int
    flags: int
    left: str = ""
    """What no field describes, in words."""

    def sizes(self) -> tuple[int, ...]:
        """Bytes of positions, opacities, colours, scales, rotations, harmonics."""
        position = 6 if self.version == 1 else 9
        rotation = 3 if self.version < 3 else 4
        n = self.count
        return n * position, n, n * 3, n * 3, n * rotation, n * 3 * (self.sh_count - 1)


def read_spz(path: Path) -> Gaussians:
    """Read an SPZ file; harmonics of degree 4 are left out, and said in the notes.

    Raises:
        SceneError: for damage of any kind, or sizes out of proportion to the file.
        PrerequisiteError: for version 4 without the package zstandard.
    """
    raw = path.read_bytes()
    is_plain = raw[:4] == b"NGSP"
    unpack = _unpack_v4 if is_plain and raw[4:8] >= b"\4" else _unpack_stream
    header, parts, records = unpack(path, raw)
    system, notes = _system(path, records)
    if unknown := header.flags & ~(_ANTIALIASED | _EXTENDED):
        notes.append(f"flags that are not known: {unknown:#x}")
    if header.sh_count > SH_COUNTS[-1]:
        notes.append("harmonics of degree 4, which are left out")
    if header.left:
        notes.append(f"{header.left} that no field of the format describes, which are not read")
    positions, alphas, colours, scales, rotations, sh = parts
    n = header.count
    rest = (sh.reshape(n, -1, 3).astype(np.float32) - 128) / np.float32(128)
    rest = rest[:, :15]
    dc = (colours.reshape(n, 1, 3).astype(np.float32) / 255 - np.float32(0.5)) / np.float32(_COLOUR)
    harmonics = np.concatenate([dc, rest], axis=1)
    gaussians = Gaussians(
        means=_positions(positions, header) * _AXES,
        log_scales=(scales.reshape(n, 3) / 16 - 10).astype(np.float32),
        quats=_rotations(rotations.reshape(n, -1)) * _QUAT_SIGNS,
        opacity_logits=logit(alphas.astype(np.float32) / 255),
        sh=harmonics * _SH_SIGNS[: harmonics.shape[1], None],
        rasterize_mode="antialiased" if header.flags & _ANTIALIASED else "classic",
        notes=tuple(notes),
    )
    return gaussians if system == "RUB" else _turned(gaussians, system)


def _system(path: Path, records: bytes) -> tuple[str, list[str]]:
    """Return what the stored x, y and z point to, and which records are not read.

    Raises:
        SceneError: the records are damaged, or name other axes than there are.
    """
    at, system = 0, "RUB"
    notes: list[str] = []
    while at < len(records):
        if at + 8 > len(records):
            raise SceneError(f"{path}: a record of an extension is cut short", fix=_BROKEN)
        kind, size = struct.unpack_from("<II", records, at)
        at += 8 + size
        if at > len(records):
            raise SceneError(
                f"{path}: record {kind:#x} of an extension claims {size} bytes", fix=_BROKEN
            )
        if kind == _AXES_RECORD:
            (number,) = struct.unpack_from("<I", records, at - size) if size >= 4 else (-1,)
            if not 0 <= number < len(_SYSTEMS):
                raise SceneError(f"{path}: its axes are number {number}", fix="0 to 16 are known")
            system = _SYSTEMS[number]
        elif kind != _ORBIT_RECORD:
            notes.append(f"record of an extension that is not read: {kind:#x}")
    return system, notes


def _turned(gaussians: Gaussians, system: str) -> Gaussians:
    """Return Gaussians that were taken for right-up-back, but are in other axes."""
    # From the stored numbers to PLY's axes, in place of what was done.
    wanted = np.array([_POINTING[letter] for letter in system], dtype=np.float64).T
    turn = wanted @ np.diag(_AXES.astype(np.float64))
    if np.linalg.det(turn) < 0:
        # A mirror: along x first, where it is a matter of signs, and then a rotation.
        turn = turn @ np.diag([-1.0, 1.0, 1.0])
        there = np.array([[0.48, 0.6, 0.64]])
        signs = np.sign(harmonics_at(there * [[-1, 1, 1]]) * harmonics_at(there))[0]
        gaussians = replace(
            gaussians,
            means=gaussians.means * np.array([-1, 1, 1], dtype=np.float32),
            quats=gaussians.quats * np.array([1, 1, -1, -1], dtype=np.float32),
            sh=gaussians.sh * signs[: gaussians.sh.shape[1], None].astype(np.float32),
        )
    T_ply_spz = np.eye(4)
    T_ply_spz[:3, :3] = turn
    return gaussians if np.array_equal(turn, np.eye(3)) else transformed(gaussians, T_ply_spz)


def write_spz(path: Path, gaussians: Gaussians, *, version: SpzVersion = 3) -> None:
    """Write an SPZ file; positions to 1/4096 of a unit, everything else to eight or ten bits.

    Raises:
        SceneError: when a position does not fit: +-2048 units at most.
        PrerequisiteError: for version 4 without the package zstandard.
    """
    n, count = len(gaussians), gaussians.sh.shape[1]
    fixed = np.rint(gaussians.means.astype(np.float64) * _AXES * (1 << _FRACTION_BITS))
    if not (np.abs(fixed) < 1 << 23).all():
        raise SceneError(
            f"{path}: SPZ holds positions within +-2048, these reach "
            f"{np.abs(gaussians.means).max():g}",
            fix="scale the scene down or write .ply",
        )
    rest = gaussians.sh[:, 1:] * _SH_SIGNS[1:count, None]
    pack_rotation = _pack_first_three if version == 2 else _pack_smallest_three
    parts = [
        fixed.astype("<i4").reshape(-1, 1).view(np.uint8)[:, :3],
        to_byte(sigmoid(gaussians.opacity_logits) * 255),
        to_byte(gaussians.sh[:, 0] * (_COLOUR * 255) + 127.5),
        to_byte((gaussians.log_scales + 10) * 16),
        pack_rotation(unit_quats(gaussians.quats) * _QUAT_SIGNS),
        to_byte(rest * 128 + 128),
    ]
    blobs = [part.tobytes() for part in parts]
    degree = SH_COUNTS.index(count)
    flags = 0 if gaussians.rasterize_mode == "classic" else _ANTIALIASED
    fields = (_MAGIC, version, n, degree, _FRACTION_BITS, flags)
    if version < 4:
        packer = zlib.compressobj(6, zlib.DEFLATED, 31)
        head = struct.pack("<IIIBBBB", *fields, 0)
        path.write_bytes(packer.compress(head + b"".join(blobs)) + packer.flush())
        return
    zstandard = _zstandard(path)
    blobs = [blob for blob in blobs if blob]
    streams = [zstandard.ZstdCompressor(level=12).compress(blob) for blob in blobs]
    head = struct.pack("<IIIBBBBI12x", *fields, len(streams), 32)
    table = [struct.pack("<QQ", len(s), len(b)) for s, b in zip(streams, blobs, strict=True)]
    path.write_bytes(head + b"".join(table) + b"".join(streams))


# --- containers --------------------------------------------------------------------------------


def _check_header(path: Path, raw: bytes, *, versions: range) -> _Header:
    if len(raw) < 16:
        raise SceneError(f"{path}: SPZ header of {len(raw)} bytes", fix=_BROKEN)
    magic, version, count, degree, bits, flags = struct.unpack_from("<IIIBBB", raw)
    if magic != _MAGIC or version not in versions:
        raise SceneError(
            f"{path}: SPZ magic {magic:#x}, version {version}", fix="versions 1 to 4 are read"
        )
    if degree >= len(_COUNTS) or bits > 23 or count == 0:
        raise SceneError(
            f"{path}: the SPZ header has degree {degree}, {bits} fraction bits, {count} Gaussians",
            fix=_BROKEN,
        )
    spare = raw[15:16] if version < 4 else raw[20:32]  # Zeros, as the format says.
    return _Header(
        version=version,
        count=count,
        sh_count=_COUNTS[degree],
        fraction_bits=bits,
        flags=flags,
        left="bits of its header" if any(spare) else "",
    )


def _check_proportion(path: Path, header: _Header, needed: int, size: int) -> None:
    if needed > max(_SMALL, _RATIO * size):
        raise SceneError(
            f"{path}: {size} bytes claim to expand to {needed}", fix="the file is damaged or forged"
        )
    check_count(path, header.count)


def _split(path: Path, body: bytes, header: _Header) -> list[Bytes]:
    sizes = header.sizes()
    if len(body) != sum(sizes):
        raise SceneError(
            f"{path}: {len(body)} bytes for {header.count} Gaussians, {sum(sizes)} are needed",
            fix=_BROKEN,
        )
    edges = np.cumsum((0, *sizes))
    whole = np.frombuffer(body, np.uint8)
    return [whole[a:b] for a, b in pairwise(edges)]


def _unpack_stream(path: Path, raw: bytes) -> tuple[_Header, list[Bytes], bytes]:
    """Return the parts of versions 1 to 3, gzipped or, as some tools keep them, plain."""
    behind = b""
    try:
        is_plain = raw[:4] == b"NGSP"
        head = raw[:16] if is_plain else zlib.decompressobj(31).decompress(raw, 16)
        header = _check_header(path, head, versions=range(1, 4))
        needed = sum(header.sizes()) + 16
        _check_proportion(path, header, needed, len(raw))
        # One byte more than needed tells a longer stream apart without holding it.
        more = _EXTENSION_BYTES if header.flags & _EXTENDED else 1
        if is_plain:
            body = raw[: needed + more]
        else:
            stream = zlib.decompressobj(31)
            body = stream.decompress(raw, needed + more)
            behind = stream.unused_data
    except zlib.error as error:
        raise SceneError(f"{path}: gzip: {error}", fix=_BROKEN) from error
    records = body[needed:] if header.flags & _EXTENDED else b""
    if behind:
        header = replace(header, left=f"{len(behind)} bytes behind its stream")
    return header, _split(path, body[16 : len(body) - len(records)], header), records


def _unpack_v4(path: Path, raw: bytes) -> tuple[_Header, list[Bytes], bytes]:
    header = _check_header(path, raw, versions=range(4, 5))
    if len(raw) < 32:
        raise SceneError(f"{path}: SPZ header of {len(raw)} bytes", fix=_BROKEN)
    streams, table = raw[15], struct.unpack_from("<I", raw, 16)[0]
    expected = [size for size in header.sizes() if size]
    if streams != len(expected) or table < 32 or table + 16 * streams > len(raw):
        raise SceneError(
            f"{path}: {streams} streams listed at {table}, {len(expected)} are needed", fix=_BROKEN
        )
    _check_proportion(path, header, sum(expected), len(raw))
    zstandard = _zstandard(path)
    offset = table + 16 * streams
    body: list[bytes] = []
    for i, needed in enumerate(expected):
        packed, unpacked = struct.unpack_from("<QQ", raw, table + 16 * i)
        if unpacked != needed or offset + packed > len(raw):
            raise SceneError(
                f"{path}: stream {i} says {packed} bytes to {unpacked}, {needed} are needed",
                fix=_BROKEN,
            )
        try:
            with zstandard.ZstdDecompressor().stream_reader(
                raw[offset : offset + packed]
            ) as reader:
                body.append(reader.read(needed + 1))
        except (zstandard.ZstdError, MemoryError) as error:
            raise SceneError(f"{path}: stream {i}: {error}", fix=_BROKEN) from error
        offset += packed
    records = raw[32:table] if header.flags & _EXTENDED else b""
    unread = len(raw) - offset + (0 if header.flags & _EXTENDED else table - 32)
    if unread:
        header = replace(header, left=f"{unread} bytes")
    return header, _split(path, b"".join(body), header), records


def _zstandard(path: Path) -> Any:
    try:
        import zstandard
    except ImportError as error:
        raise PrerequisiteError(
            f"{path}: SPZ version 4 needs the package zstandard", fix="pip install zstandard"
        ) from error
    return zstandard


# --- attributes --------------------------------------------------------------------------------


def _positions(data: Bytes, header: _Header) -> NDArray[np.float32]:
    if header.version == 1:
        return data.view("<f2").astype(np.float32).reshape(-1, 3)
    words = np.zeros((len(data) // 3, 4), dtype=np.uint8)
    words[:, 1:] = data.reshape(-1, 3)
    fixed = words.view("<i4")[:, 0] >> 8  # Arithmetic: bit 23 is the sign.
    return (fixed / float(1 << header.fraction_bits)).astype(np.float32).reshape(-1, 3)


def _rotations(data: Bytes) -> NDArray[np.float32]:
    """(n, 4) w x y z from three or four bytes each."""
    unpack: Callable[[Bytes], NDArray[np.float32]]
    unpack = _unpack_first_three if data.shape[1] == 3 else _unpack_smallest_three
    return np.roll(unpack(data), 1, axis=1)


def _unpack_first_three(data: Bytes) -> NDArray[np.float32]:
    xyz = data.astype(np.float32) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz * xyz).sum(axis=1, keepdims=True)))
    return np.concatenate([xyz, w], axis=1)


def _pack_first_three(quats: NDArray[np.float64]) -> Bytes:
    xyz = quats[:, 1:] * np.where(quats[:, :1] < 0, -1, 1)
    return to_byte(xyz * 127.5 + 127.5)


def _unpack_smallest_three(data: Bytes) -> NDArray[np.float32]:
    """X y z w: two bits say which is largest; the others are nine bits and a sign, last first."""
    word = np.ascontiguousarray(data).view("<u4")[:, 0].copy()
    largest = word >> np.uint32(30)
    quats = np.zeros((len(word), 4), dtype=np.float32)
    for component in (3, 2, 1, 0):
        stored = largest != component
        value = (word & np.uint32(511)) * np.float32(_SQRT_HALF / 511)
        value = np.where(word & np.uint32(512), -value, value)
        quats[:, component] = np.where(stored, value, 0)
        word = np.where(stored, word >> np.uint32(10), word)
    rest = np.sqrt(np.maximum(0, 1 - (quats * quats).sum(axis=1)))
    quats[np.arange(len(quats)), largest] = rest
    return quats


def _pack_smallest_three(quats: NDArray[np.float64]) -> Bytes:
    q = np.roll(quats, -1, axis=1)
    largest = np.abs(q).argmax(axis=1)
    q = q * np.where(q[np.arange(len(q)), largest] < 0, -1, 1)[:, None]
    word = largest.astype(np.uint32)
    magnitude = np.minimum(np.abs(q) * (511 / _SQRT_HALF) + 0.5, 511).astype(np.uint32)
    for component in range(4):
        bits = magnitude[:, component] | (q[:, component] < 0).astype(np.uint32) << np.uint32(9)
        word = np.where(largest != component, word << np.uint32(10) | bits, word)
    return word.astype("<u4").reshape(-1, 1).view(np.uint8)


def _is_gzipped(path: Path, mark: bytes) -> bool:
    """Return whether a gzip stream is an SPZ: by what it begins with; if damaged, by its name."""
    if mark[:2] != b"\x1f\x8b":
        return False
    try:
        with path.open("rb") as file:
            return zlib.decompressobj(31).decompress(file.read(1 << 16), 4) == b"NGSP"
    except zlib.error:
        return path.suffix.lower() == ".spz"


SPZ = SplatFormat(
    name="spz",
    description="Niantic's, versions 1 to 4",
    read=read_spz,
    write=write_spz,
    sniff=lambda path, mark: mark[:4] == b"NGSP" or _is_gzipped(path, mark),
)
