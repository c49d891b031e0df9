"""An independent renderer in plain torch, with gsplat 1.5's semantics and no cleverness.

It shares no code and no layout with the engine: activations, covariances, projection and harmonics
are computed from the Gaussians by matrix algebra, and pixels are composited tile by tile with
cumulative products. `dtype` chooses float32 (what gsplat does) or float64 (the truth).

With `ray`, the Mahalanobis distance is minimised along each pixel's half ray in three dimensions:
in the space that makes a Gaussian a unit sphere it is that of a point from a line.
"""

import math

import torch

ALPHA_MIN, T_MIN, NEAR = 1 / 255, 1e-4, 0.01
STEEPEST = 30.0  # x / z, 88 degrees


def basis(d, count):
    """Real spherical harmonics of unit directions (n, 3) as polynomials: (n, count)."""
    x, y, z = d.unbind(-1)
    n1 = math.sqrt(3 / (4 * math.pi))
    n2 = math.sqrt(15 / (4 * math.pi))
    n3 = math.sqrt(35 / (32 * math.pi))
    n4 = math.sqrt(21 / (32 * math.pi))
    rows = [torch.full_like(x, 0.5 / math.sqrt(math.pi)), -n1 * y, n1 * z, -n1 * x]
    rows += [
        n2 * x * y,
        -n2 * y * z,
        math.sqrt(5 / (16 * math.pi)) * (3 * z * z - 1),
        -n2 * x * z,
        0.5 * n2 * (x * x - y * y),
    ]
    rows += [
        -n3 * y * (3 * x * x - y * y),
        math.sqrt(105 / (4 * math.pi)) * x * y * z,
        -n4 * y * (5 * z * z - 1),
        math.sqrt(7 / (16 * math.pi)) * z * (5 * z * z - 3),
        -n4 * x * (5 * z * z - 1),
        math.sqrt(105 / (16 * math.pi)) * z * (x * x - y * y),
        -n3 * x * (x * x - 3 * y * y),
    ]
    return torch.stack(rows[:count], dim=-1)


def rotations(q):
    """(n, 4) w x y z of any length to (n, 3, 3)."""
    w, x, y, z = torch.nn.functional.normalize(q, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(
    gaussians, camera, *, antialiased, dtype, min_compensation=0.0, eps2d=0.3, near=NEAR, ray=False
):
    """Return the splats that touch the image, as a dict of tensors over them."""

    def tensor(array):
        return torch.as_tensor(array.copy()).to(dtype)

    means, quats = tensor(gaussians.means), tensor(gaussians.quats)
    view = tensor(camera.T_camera_world)
    linear, offset = view[:3, :3], view[:3, 3]
    width, height, fx, fy = camera.width, camera.height, camera.fx, camera.fy
    point = means @ linear.T + offset
    z = point[:, 2]
    safe = torch.where(z >= near, z, torch.ones_like(z))
    half = rotations(quats) * torch.exp(tensor(gaussians.log_scales))[:, None, :]
    half = linear @ half
    covariance = half @ half.transpose(1, 2)
    low_x, low_y = -camera.cx / fx - 0.15 * width / fx, -camera.cy / fy - 0.15 * height / fy
    high_x = (width - camera.cx) / fx + 0.15 * width / fx
    high_y = (height - camera.cy) / fy + 0.15 * height / fy
    if ray:
        low_x, high_x, low_y, high_y = -math.inf, math.inf, -math.inf, math.inf
    tx = safe * torch.clamp(point[:, 0] / safe, low_x, high_x)
    ty = safe * torch.clamp(point[:, 1] / safe, low_y, high_y)
    jacobian = torch.zeros(len(z), 2, 3, dtype=dtype)
    jacobian[:, 0, 0], jacobian[:, 0, 2] = fx / safe, -fx * tx / safe**2
    jacobian[:, 1, 1], jacobian[:, 1, 2] = fy / safe, -fy * ty / safe**2
    flat = jacobian @ covariance @ jacobian.transpose(1, 2)
    before = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] ** 2
    xx, yy, xy = flat[:, 0, 0] + eps2d, flat[:, 1, 1] + eps2d, flat[:, 0, 1]
    after = xx * yy - xy**2
    opacity = torch.sigmoid(tensor(gaussians.opacity_logits))
    if antialiased:
        opacity = opacity * torch.sqrt(torch.clamp(before / after, min=min_compensation**2))
    u = fx * point[:, 0] / safe + camera.cx
    v = fy * point[:, 1] / safe + camera.cy
    reach = torch.sqrt(2 * torch.log(torch.clamp(opacity * 255, min=1.0))).clamp(max=3.33)
    rx, ry = torch.ceil(reach * xx.sqrt()), torch.ceil(reach * yy.sqrt())
    seen = (z >= near) & (after > 0) & (opacity >= ALPHA_MIN)
    if ray:
        rx, ry = torch.full_like(u, math.inf), torch.full_like(u, math.inf)
        seen &= torch.hypot(point[:, 0], point[:, 1]) < STEEPEST * z
    seen &= (u + rx > 0) & (u - rx < width) & (v + ry > 0) & (v - ry < height)
    rows = torch.nonzero(seen)[:, 0]
    rows = rows[torch.argsort(z[rows].float(), stable=True)]
    covariance = covariance.clone()
    covariance[:, 0, 0] += eps2d * (safe / fx) ** 2
    covariance[:, 1, 1] += eps2d * (safe / fy) ** 2
    spheres = torch.linalg.inv(torch.linalg.cholesky(covariance[rows])) if ray else None
    eye = tensor(camera.T_world_camera)[:3, 3]
    direction = torch.nn.functional.normalize(means[rows] - eye, dim=-1)
    sh = tensor(gaussians.sh)[rows]
    colour = (basis(direction, sh.shape[1])[:, :, None] * sh).sum(dim=1) + 0.5
    return {
        "u": u[rows], "v": v[rows], "rx": rx[rows], "ry": ry[rows], "z": z[rows],
        "a": (yy / after)[rows], "b": (-xy / after)[rows], "c": (xx / after)[rows],
        "opacity": opacity[rows],
        "spheres": spheres, "point": point[rows],
        "colour": torch.clamp(colour, min=0.0),
    }  # fmt: skip


def squared_distances(directions, spheres, points):
    """Least squared Mahalanobis distances of half rays (p, 3) to Gaussians: (p, n)."""
    ray = torch.einsum("nij,pj->pni", spheres, directions)
    centre = torch.einsum("nij,nj->ni", spheres, points)
    along = (ray * centre).sum(dim=-1) / (ray * ray).sum(dim=-1)
    nearest = torch.clamp(along, min=0.0)[..., None] * ray
    return ((nearest - centre) ** 2).sum(dim=-1)


def render(
    gaussians,
    camera,
    *,
    antialiased=True,
    dtype=torch.float32,
    background=(1.0, 1.0, 1.0),
    max_alpha=0.999,
    min_compensation=0.0,
    tile=16,
    eps2d=0.3,
    near=NEAR,
    ray=False,
):
    """Return (rgb (H, W, 3), depth (H, W), alpha (H, W)) as numpy arrays."""
    s = project(
        gaussians, camera, antialiased=antialiased, dtype=dtype, min_compensation=min_compensation,
        eps2d=eps2d, near=near, ray=ray,
    )  # fmt: skip
    values = torch.cat([s["colour"], s["z"][:, None]], dim=1)
    out = torch.zeros(camera.height, camera.width, 4, dtype=dtype)
    alpha_out = torch.zeros(camera.height, camera.width, dtype=dtype)
    for y0 in range(0, camera.height, tile):
        in_rows = torch.nonzero((s["v"] + s["ry"] > y0) & (s["v"] - s["ry"] < y0 + tile))[:, 0]
        left, right = (s["u"] - s["rx"])[in_rows], (s["u"] + s["rx"])[in_rows]
        for x0 in range(0, camera.width, tile):
            y1, x1 = min(camera.height, y0 + tile), min(camera.width, x0 + tile)
            listed = in_rows[(right > x0) & (left < x0 + tile)]
            py, px = torch.meshgrid(
                torch.arange(y0, y1, dtype=dtype) + 0.5,
                torch.arange(x0, x1, dtype=dtype) + 0.5,
                indexing="ij",
            )
            px, py = px.reshape(-1, 1), py.reshape(-1, 1)
            T = torch.ones(len(px), dtype=dtype)
            total = torch.zeros(len(px), 4, dtype=dtype)
            going = torch.ones(len(px), dtype=torch.bool)
            for start in range(0, len(listed), 256):
                j = listed[start : start + 256]
                if ray:
                    x, y = (px - camera.cx) / camera.fx, (py - camera.cy) / camera.fy
                    to = torch.cat([x, y, torch.ones_like(x)], dim=1)
                    sigma = 0.5 * squared_distances(to, s["spheres"][j], s["point"][j])
                else:
                    dx, dy = s["u"][j] - px, s["v"][j] - py
                    sigma = 0.5 * (s["a"][j] * dx * dx + s["c"][j] * dy * dy) + s["b"][j] * dx * dy
                alpha = torch.clamp(s["opacity"][j] * torch.exp(-sigma), max=max_alpha)
                alpha = torch.where((alpha >= ALPHA_MIN) & (sigma >= 0), alpha, 0.0)
                alpha = alpha * going[:, None]
                passed = T[:, None] * torch.cumprod(1 - alpha, dim=1) > T_MIN
                alpha = alpha * passed
                after = T[:, None] * torch.cumprod(1 - alpha, dim=1)
                before = torch.cat([T[:, None], after[:, :-1]], dim=1)
                total += (alpha * before) @ values[j]
                T, going = after[:, -1], going & passed[:, -1]
                if not going.any():
                    break
            out[y0:y1, x0:x1] = total.reshape(y1 - y0, x1 - x0, 4)
            alpha_out[y0:y1, x0:x1] = (1 - T).reshape(y1 - y0, x1 - x0)
    rgb = out[..., :3] + (1 - alpha_out)[..., None] * torch.tensor(background, dtype=dtype)
    depth = out[..., 3] / torch.clamp(alpha_out, min=1e-10)
    return rgb.numpy(), depth.numpy(), alpha_out.numpy()
