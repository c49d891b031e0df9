"""The differentiable renderer and its loss once more, in plain torch, for torch to differentiate.

It shares no code with the engine: footprints by matrix algebra, pixels tile by tile by cumulative
products, structural similarity by torch's own convolution. With `ray`, the Mahalanobis distance is
that of a half ray from the centre, in the space that makes each Gaussian a unit sphere. `dtype` is
that of the parameters: float64 for the truth, float32 to race against.
"""

import torch
from splat_reference import ALPHA_MIN, NEAR, STEEPEST, T_MIN, basis, rotations, squared_distances

NAMES = ("means", "log_scales", "quats", "opacity_logits", "sh")


def parameters(gaussians, dtype=torch.float64):
    """Return leaves of the graph by name."""
    return {
        name: torch.tensor(getattr(gaussians, name), dtype=dtype, requires_grad=True)
        for name in NAMES
    }


def project(p, camera, *, antialiased=True, degree=3, ray=False):
    """Return the splats that touch the image as a dict of tensors, nearest first."""
    dtype = p["means"].dtype
    view = torch.tensor(camera.T_camera_world, dtype=dtype)
    eye = torch.tensor(camera.T_world_camera[:3, 3].copy(), dtype=dtype)
    linear = view[:3, :3]
    offset = p["means"] - eye
    point = offset @ linear.T
    z = point[:, 2]
    fx, fy, width, height = camera.fx, camera.fy, camera.width, camera.height
    is_ahead = z >= NEAR
    if ray:
        is_ahead &= torch.hypot(point[:, 0], point[:, 1]) < STEEPEST * z
    kept = is_ahead.nonzero()[:, 0]
    point, z = point[kept], z[kept]
    slope_x, slope_y = point[:, 0] / z, point[:, 1] / z
    bound = 0.15 * width / fx, 0.15 * height / fy
    sx, sy = slope_x, slope_y
    if not ray:
        sx = slope_x.clamp(-camera.cx / fx - bound[0], (width - camera.cx) / fx + bound[0])
        sy = slope_y.clamp(-camera.cy / fy - bound[1], (height - camera.cy) / fy + bound[1])
    nil = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([fx / z, nil, -fx * sx / z], -1),
            torch.stack([nil, fy / z, -fy * sy / z], -1),
        ],
        dim=1,
    )
    half = rotations(p["quats"][kept]) * torch.exp(p["log_scales"][kept])[:, None, :]
    half = linear @ half
    solid = half @ half.transpose(1, 2)
    blur = torch.stack([0.3 * (z / fx) ** 2, 0.3 * (z / fy) ** 2, nil], -1)
    spheres = torch.linalg.inv(torch.linalg.cholesky(solid + torch.diag_embed(blur)))
    half = jacobian @ half
    flat = half @ half.transpose(1, 2)
    before = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] ** 2
    xx, yy, xy = flat[:, 0, 0] + 0.3, flat[:, 1, 1] + 0.3, flat[:, 0, 1]
    after = xx * yy - xy**2
    opacity = torch.sigmoid(p["opacity_logits"][kept])
    if antialiased:
        opacity = opacity * torch.sqrt((before / after).clamp(min=1e-30))
    u, v = fx * slope_x + camera.cx, fy * slope_y + camera.cy
    reach = torch.sqrt(2 * torch.log((opacity.detach() * 255).clamp(min=1.0))) + 1e-3
    rx, ry = reach * xx.detach().sqrt() + 1, reach * yy.detach().sqrt() + 1
    if ray:
        rx, ry = torch.full_like(rx, torch.inf), torch.full_like(ry, torch.inf)
    seen = (opacity >= ALPHA_MIN) & (u + rx > 0) & (u - rx < width)
    seen &= (v + ry > 0) & (v - ry < height)
    rows = seen.nonzero()[:, 0]
    rows = rows[torch.argsort(z[rows].float(), stable=True)]
    sh = p["sh"][kept[rows]][:, : (degree + 1) ** 2]
    direction = torch.nn.functional.normalize(offset[kept[rows]], dim=-1)
    colour = ((basis(direction, sh.shape[1])[:, :, None] * sh).sum(dim=1) + 0.5).clamp(min=0.0)
    return {
        "u": u[rows], "v": v[rows], "rx": rx[rows], "ry": ry[rows],
        "a": (yy / after)[rows], "b": (-xy / after)[rows], "c": (xx / after)[rows],
        "opacity": opacity[rows], "spheres": spheres[rows] if ray else None, "point": point[rows],
        "values": torch.cat([colour, 1 / z[rows][:, None]], dim=1),
    }  # fmt: skip


def _composite(s, j, px, py, camera):
    """Return (n, 4) sums of weight * value of the splats j at n pixels, and the light that is left.

    256 splats at a time, until no pixel takes more.
    """
    T = torch.ones(len(px), dtype=px.dtype)
    going = torch.ones(len(px), dtype=torch.bool)
    total = torch.zeros(len(px), 4, dtype=px.dtype)
    for part in j.split(256) if len(j) else ():
        dx, dy = s["u"][part] - px, s["v"][part] - py
        if s["spheres"] is None:
            sigma = 0.5 * (s["a"][part] * dx * dx + s["c"][part] * dy * dy) + s["b"][part] * dx * dy
        else:
            x, y = (px - camera.cx) / camera.fx, (py - camera.cy) / camera.fy
            to = torch.cat([x, y, torch.ones_like(x)], dim=1)
            sigma = 0.5 * squared_distances(to, s["spheres"][part], s["point"][part])
        alpha = (s["opacity"][part] * torch.exp(-sigma)).clamp(max=0.999)
        alpha = torch.where((alpha >= ALPHA_MIN) & going[:, None], alpha, 0.0)
        passed = T.detach()[:, None] * torch.cumprod(1 - alpha.detach(), dim=1) > T_MIN
        alpha = alpha * passed
        after = T[:, None] * torch.cumprod(1 - alpha, dim=1)
        before = torch.cat([T[:, None], after[:, :-1]], dim=1)
        total = total + (alpha * before) @ s["values"][part]
        T, going = after[:, -1], going & passed[:, -1]
        if not going.any():
            break
    return total, T


def render(p, camera, *, background=(1.0, 1.0, 1.0), tile=16, **options):
    """Return (rgb (3, H, W), alpha (H, W), inverse depth (H, W)) as part of the graph."""
    s = project(p, camera, **options)
    dtype = p["means"].dtype
    width, height = camera.width, camera.height
    rows = []
    for y0 in range(0, height, tile):
        y1 = min(y0 + tile, height)
        row = []
        for x0 in range(0, width, tile):
            x1 = min(x0 + tile, width)
            touches = (s["u"] + s["rx"] > x0) & (s["u"] - s["rx"] < x1)
            touches &= (s["v"] + s["ry"] > y0) & (s["v"] - s["ry"] < y1)
            py, px = torch.meshgrid(
                torch.arange(y0, y1, dtype=dtype) + 0.5,
                torch.arange(x0, x1, dtype=dtype) + 0.5,
                indexing="ij",
            )
            j = touches.nonzero()[:, 0]
            total, light = _composite(s, j, px.reshape(-1, 1), py.reshape(-1, 1), camera)
            part = torch.cat([total, light[:, None]], dim=1)
            row.append(part.T.reshape(5, y1 - y0, x1 - x0))
        rows.append(torch.cat(row, dim=2))
    image = torch.cat(rows, dim=1)
    light = image[4]
    return (
        image[:3] + light * torch.tensor(background, dtype=dtype)[:, None, None],
        1 - light,
        image[3],
    )


def ssim(x, y):
    """Mean structural similarity of two (3, H, W) images: 11x11, sigma 1.5, zeros beyond edges."""
    offsets = torch.arange(11, dtype=x.dtype) - 5
    weights = torch.exp(-(offsets**2) / (2 * 1.5**2))
    weights = weights / weights.sum()
    window = (weights[:, None] * weights[None, :])[None, None]

    def mean(image):
        return torch.nn.functional.conv2d(image[:, None], window, padding=5)[:, 0]

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    top = (2 * mx * my + c1) * (2 * xy + c2)
    return (top / ((mx**2 + my**2 + c1) * (xx + yy + c2))).mean()


def loss(rgb, inverse, photo, *, depth=None, confidence=None, ssim_weight=0.2, depth_weight=0.0):
    """(1 - w) L1 + w (1 - SSIM) + w_d mean(confidence |inverse depth - depth|)."""
    total = (1 - ssim_weight) * (rgb - photo).abs().mean() + ssim_weight * (1 - ssim(rgb, photo))
    if depth is not None:
        total = total + depth_weight * (confidence * (inverse - depth).abs()).mean()
    return total
