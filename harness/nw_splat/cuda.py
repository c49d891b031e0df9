"""The CUDA backend: gsplat, given the same compiled Gaussians as the CPU renderer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from nw_base.errors import PrerequisiteError, UsageError
from nw_splat.camera import Camera, Pixels, PresetName, Rows, get_preset
from nw_splat.image import Image
from nw_splat.store import Store, unpack

_TILE = 16


class CudaRenderer:
    """Renders with gsplat on a CUDA device; the contract is CpuRenderer's.

    Covariances, opacities and harmonics come from the store, so both backends draw the same
    numbers. A pixel set is cut from the full image: on a GPU the rest of it costs little.

    Args:
        store: what to render.
        preset: which gsplat; it must be the one installed, since they do not render alike.
        antialiased: compensate opacity for the blur of small splats; None: unless the store is
            marked classic.
        background: colour behind everything.
        device: torch device.

    Raises:
        PrerequisiteError: when gsplat, its version or a device is missing.
    """

    def __init__(
        self,
        store: Store,
        *,
        preset: PresetName = "gsplat-1.5",
        antialiased: bool | None = None,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        device: str = "cuda",
    ) -> None:
        torch, self._rasterize, version = _load()
        if preset.removeprefix("gsplat-") != ".".join(version.split(".")[:2]):
            wanted = preset.removeprefix("gsplat-")
            raise PrerequisiteError(
                f"preset {preset} needs gsplat {wanted}, installed is {version}",
                fix=f"pip install 'gsplat=={wanted}.*' or choose its preset",
            )
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise PrerequisiteError(
                "torch finds no CUDA device", fix="use --render cpu, or a machine with one"
            )
        self.store = store
        self._torch, self._device = torch, device
        classic = store.rasterize_mode == "classic"
        self._antialiased = not classic if antialiased is None else antialiased
        self._preset = get_preset(preset)
        self._background = np.asarray(background, dtype=np.float32)
        self._sh_degree = {1: 0, 4: 1, 9: 2, 16: 3}[store.sh_count]
        splats = unpack(store.layout)
        self._means = torch.as_tensor(splats.means, device=device)
        self._covariances = torch.as_tensor(splats.covariances, device=device)
        self._opacities = torch.as_tensor(splats.opacities, device=device)
        self._sh = torch.as_tensor(splats.sh, device=device)

    def render(
        self,
        camera: Camera,
        pixels: Pixels = Pixels(),  # noqa: B008 (frozen)
        rows: Rows | None = None,
    ) -> Image:
        """Return the image of a camera, or a pixel set of it; the caller owns the arrays.

        Raises:
            UsageError: when the pixel set selects no pixel of the image, or the camera's lens
                distorts.
        """
        image = self.render_batch([camera], pixels)[0]
        return image if rows is None else image.rows(*rows)

    def render_batch(self, cameras: Sequence[Camera], pixels: Pixels = Pixels()) -> list[Image]:  # noqa: B008
        """Return the images of cameras of one size, drawn in one call.

        An image has the same bits in any batch and at any place in it: gsplat sorts by camera
        first, and each pixel sums its own splats in their order.

        Args:
            cameras: at least one; all with the same size and the same near and far planes.
            pixels: the part of each image to return.

        Raises:
            UsageError: as `render`; or cameras of several sizes or planes.
        """
        kinds = {(each.width, each.height, each.near, each.far) for each in cameras}
        if len(kinds) != 1:
            raise UsageError(
                f"a batch of {len(cameras)} cameras has {len(kinds)} sizes and planes",
                fix="draw cameras of each kind by themselves",
            )
        width, height, near, far = kinds.pop()
        if pixels.count(width) == 0 or pixels.count(height) == 0:
            raise UsageError(f"{pixels} selects no pixel of {width}x{height}")
        torch = self._torch
        if any(each.distortion is not None for each in cameras):
            raise UsageError(
                "--render cuda cannot draw through a lens with distortion", fix="use --render cpu"
            )
        views = np.stack([each.T_camera_world for each in cameras]).astype(np.float32)
        K = np.array(
            [[[each.fx, 0, each.cx], [0, each.fy, each.cy], [0, 0, 1]] for each in cameras],
            dtype=np.float32,
        )
        with torch.no_grad():
            colours, alphas, _ = self._rasterize(
                means=self._means,
                quats=None,
                scales=None,
                covars=self._covariances,
                opacities=self._opacities,
                colors=self._sh,
                sh_degree=self._sh_degree,
                viewmats=torch.as_tensor(views, device=self._device),
                Ks=torch.as_tensor(K, device=self._device),
                width=width,
                height=height,
                near_plane=near,
                far_plane=far,
                eps2d=self._preset.eps2d,
                radius_clip=0.0,
                packed=False,
                tile_size=_TILE,
                render_mode="RGB+ED",
                rasterize_mode="antialiased" if self._antialiased else "classic",
            )
        values = colours.float().cpu().numpy()
        alpha = alphas[..., 0].float().cpu().numpy()
        # The background is added here: versions differ in how many channels they want of it.
        rgb = values[..., :3] + (1.0 - alpha)[..., None] * self._background
        return [
            Image(
                rgb=np.ascontiguousarray(pixels.crop(rgb[n]), dtype=np.float32),
                depth=np.ascontiguousarray(pixels.crop(values[n, ..., 3])),
                alpha=np.ascontiguousarray(pixels.crop(alpha[n])),
            )
            for n in range(len(cameras))
        ]


def _load() -> tuple[Any, Callable[..., Any], str]:
    """Return torch, gsplat's rasterization and gsplat's version."""
    try:
        import torch

        gsplat: Any = import_module("gsplat")
    except ImportError as error:
        raise PrerequisiteError(
            f"the cuda renderer needs the package {error.name}", fix="pip install 'nw-eval[cuda]'"
        ) from error
    return torch, gsplat.rasterization, gsplat.__version__
