"""Gaussians to begin with: at points, and of the sky; how far points are from others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_splat.gaussians import SH0, SH_COUNTS, Gaussians
from nw_twin.gaussians.images import Photo, extent_of
from nw_twin.gaussians.kernels.rows import (
    NEIGHBOURS,
    least_square_distances,
    mean_square_distances,
)

LEAST_SQUARE = 1e-7
"""Least mean squared distance, so that points in one place get a size."""
FLAT = 0.1
"""Thickness of a Gaussian that lies in a surface, as a share of its size along it."""

SKY_AWAY = 20.0
"""Radius of the sky, in sizes of the capture: a walk of 50 metres has it 550 metres away, before
the far plane of viewers, and photographs of it differ by 3 degrees at most."""
_HORIZON = math.radians(5.0)
"""How far below the horizon the sky reaches: ground beyond the mesh ends there."""
_LEAST_SKY = 0.01
"""Share of the pixels that must be sky for a scene to have one: meshes have small holes."""
_BLUR = math.radians(20.0)
"""Over which the sky's colours are spread to where no photograph shows it."""
_LOW = 0.02
"""Sine of an elevation below which all counts alike there: far trees are low, the sky is above."""
_OPAQUE = 0.9
_AGREE, _ALIKE = 2, 0.1
"""Photographs that must show a direction of the sky, at least, and how far their colours there may
differ, as a standard deviation: a room behind a table shows each photograph something else, by 0.12
and more; exposures differ by half of that."""

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]


def gaussians_at(
    points: NDArray[np.floating],
    colours: NDArray[np.floating],
    normals: NDArray[np.floating] | None = None,
    *,
    sh_degree: int = 1,
    opacity: float = 0.1,
    size: float = 1.0,
) -> Gaussians:
    """Return Gaussians at points: round ones, as the 3DGS paper begins, or flat ones.

    Round Gaussians of a floor stand out of it. From above that does not show, so no photograph
    mends it, but a robot that looks along the floor sees fog in front of all edges.

    Args:
        points: (N, 3), such as points on a mesh.
        colours: (N, 3), 0 to 1.
        normals: (N, 3) unit vectors of the surface that the Gaussians lie in; None = round ones.
        sh_degree: 0 to 3; harmonics above the constant are 0.
        opacity: of each; MCMC begins with 0.5.
        size: standard deviation as a share of the root mean squared distance to the three nearest
            neighbours; MCMC begins with 0.1.

    Raises:
        SceneError: fewer than four points, or some are not finite.
    """
    if len(points) <= NEIGHBOURS or points.shape[1:] != (3,) or colours.shape != points.shape:
        raise SceneError(
            f"{points.shape} points with {colours.shape} colours",
            fix=f"give at least {NEIGHBOURS + 1} points (N, 3) and as many colours",
        )
    if not (np.isfinite(points).all() and np.isfinite(colours).all()):
        raise SceneError("points or colours are not finite", fix="remove those points")
    order = np.argsort(points[:, 0], kind="stable")
    squares = np.empty(len(points))
    mean_square_distances(np.ascontiguousarray(points[order], dtype=np.float64), squares)
    distance = np.empty_like(squares)
    distance[order] = np.sqrt(np.maximum(squares, LEAST_SQUARE))
    n = len(points)
    log_scales = np.repeat(np.log(size * distance)[:, None], 3, axis=1)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (n, 1))
    if normals is not None:
        log_scales[:, 2] += math.log(FLAT)
        quats = _upright_to(normals)
    sh = np.zeros((n, SH_COUNTS[sh_degree], 3), dtype=np.float32)
    sh[:, 0] = (colours - 0.5) / SH0
    return Gaussians(
        means=points.astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        quats=quats.astype(np.float32),
        opacity_logits=np.full(n, math.log(opacity / (1.0 - opacity)), dtype=np.float32),
        sh=sh,
    )


def _upright_to(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return unit quaternions (N, 4), wxyz, of the shortest turns of the z axis to (N, 3)."""
    # A surface has two sides: the one that looks up is never the opposite of the z axis.
    x, y, z = (normals * np.where(normals[:, 2:] < 0.0, -1.0, 1.0)).astype(np.float64).T
    quats = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def distances(points: NDArray[np.floating], others: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return (N,) how far the nearest of `others` (M, 3), M > 0, is from each of (N, 3)."""
    squares = np.empty(len(points))
    places, candidates = (np.ascontiguousarray(each, np.float64) for each in (points, others))
    least_square_distances(places, candidates, squares)
    return np.sqrt(squares)


class _Dome:
    """Directions from a little below the horizon to the zenith, in cells of about one size.

    Args:
        up: (3,) unit vector.
        count: cells, about.

    Attributes:
        directions: (N, 3) unit vectors of the cells' middles.
    """

    def __init__(self, up: Values, count: int) -> None:
        side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        side /= np.linalg.norm(side)
        self._axes = np.stack([side, np.cross(up, side), up])
        height = math.pi / 2.0 + _HORIZON
        edge = math.sqrt(2.0 * math.pi * (1.0 + math.sin(_HORIZON)) / count)
        self._rows = math.ceil(height / edge)
        middles = (np.arange(self._rows) + 0.5) * height / self._rows - _HORIZON
        self._counts = np.maximum(1, np.round(2.0 * math.pi * np.cos(middles) / edge)).astype(int)
        self._firsts = np.cumsum(self._counts) - self._counts
        row = np.repeat(np.arange(self._rows), self._counts)
        turn = (np.arange(len(row)) - self._firsts[row] + 0.5) / self._counts[row] * 2.0 * math.pi
        flat = np.cos(middles[row])
        own = [flat * np.cos(turn), flat * np.sin(turn), np.sin(middles[row])]
        self.directions = np.einsum("in,ij->nj", np.stack(own), self._axes)

    def cells(self, rays: Values) -> NDArray[np.int64]:
        """Return the number of the cell of each unit vector (..., 3), N where it has none."""
        x, y, z = np.einsum("ij,...j->i...", self._axes, rays)
        share = (np.arcsin(np.clip(z, -1.0, 1.0)) + _HORIZON) / (math.pi / 2.0 + _HORIZON)
        row = np.clip((share * self._rows).astype(np.int64), 0, self._rows - 1)
        turn = np.arctan2(y, x) / (2.0 * math.pi) % 1.0
        cell = self._firsts[row] + np.minimum(turn * self._counts[row], self._counts[row] - 1)
        return np.where(share < 0.0, len(self.directions), cell.astype(np.int64))


def with_sky(
    photos: Sequence[Photo], free: Sequence[Mask], up: Values, *, most: int
) -> tuple[tuple[Photo, ...], Gaussians | None, float]:
    """Find the sky, and return photographs that know of it and Gaussians that show it.

    A direction is sky where most of the photographs that look there have nothing in the way, and
    show the same colour: what is nearer differs. Then their pixels without anything in the way are
    infinitely far, as far as they have depths at all, which keeps what shows them from hanging in
    the air. Where no photograph shows the sky, it has the colours of the sky beside.

    Args:
        photos: of a scene.
        free: of each photograph, (H, W) where neither its depth nor a mesh is known.
        up: (3,) unit vector.
        most: Gaussians of the sky, about.

    Returns:
        The photographs, a dome of Gaussians `SKY_AWAY` around them, None where there is no sky, and
        the share of the pixels that are sky.
    """
    dome = _Dome(up, most)
    n = len(dome.directions)
    seen, open_to, total, squares = np.zeros((n, 1)), np.zeros((n, 1)), np.zeros((n, 3)), 0.0
    cells: list[NDArray[np.int64]] = []
    for photo, nothing in zip(photos, free, strict=True):
        cell = dome.cells(photo.rays())
        shown = cell if photo.mask is None else np.where(photo.mask, cell, n)
        cells.append(np.where(nothing, cell, n))  # What has something in the way is no sky.
        there = np.where(nothing, shown, n).ravel()
        pixels = np.bincount(shown.ravel(), minlength=n + 1)[:n, None]
        inside = np.bincount(there, minlength=n + 1)[:n, None]
        bands = photo.rgb.reshape(-1, 3).T / 255.0
        sums = [np.bincount(there, band, minlength=n + 1)[:n] for band in bands]
        colour = np.stack(sums, axis=1) / np.maximum(inside, 1)
        mostly = 2 * inside > pixels
        seen += pixels > 0
        open_to += mostly
        total += colour * mostly
        squares += colour**2 * mostly
    colours = total / np.maximum(open_to, 1)
    differ = np.sqrt(np.maximum(squares / np.maximum(open_to, 1) - colours**2, 0.0).mean(axis=1))
    many = (open_to >= _AGREE) & (2 * open_to > seen)
    is_sky = np.append(many[:, 0] & (differ <= _ALIKE), False)
    masks = [is_sky[cell] for cell in cells]
    share = sum(int(mask.sum()) for mask in masks) / sum(mask.size for mask in masks)
    if share < _LEAST_SKY:
        return tuple(photos), None, 0.0
    known = is_sky[:n]
    apart = 1.0 - np.einsum("ik,jk->ij", dome.directions, dome.directions[known])
    apart -= apart.min(axis=1, keepdims=True)
    height = np.maximum(np.einsum("ik,k->i", dome.directions[known], up), _LOW)
    near = np.exp(-2.0 * apart / _BLUR**2) * height**2
    beside = np.einsum("ij,jk->ik", near, colours[known]) / near.sum(axis=1, keepdims=True)
    colours = np.where(known[:, None], colours, beside)
    eyes = np.array([photo.camera.T_world_camera[:3, 3] for photo in photos])
    places = eyes.mean(axis=0) + SKY_AWAY * extent_of(photos) * dome.directions
    sky = gaussians_at(places, colours, dome.directions, opacity=_OPAQUE)
    return tuple(map(_far, photos, masks)), sky, share


def _far(photo: Photo, sky: Mask) -> Photo:
    """Return a photograph that knows its sky to be infinitely far, if it has depths."""
    if photo.inverse_depth is None:
        return photo
    sure = np.ones_like(photo.inverse_depth) if photo.confidence is None else photo.confidence
    return replace(
        photo,
        inverse_depth=np.where(sky, np.float32(0.0), photo.inverse_depth),
        confidence=np.where(sky, np.float32(1.0), sure),
    )
