"""Each kernel against a scalar reference written here."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_rooms import cloud, eye_camera, room

from nw_base.machine_code import kernel
from nw_base.simd import memory
from nw_base.simd.lanes import broadcast
from nw_splat.camera import Pixels, view_vector
from nw_splat.kernels import cull, draw, math8, project
from nw_splat.kernels.blend import (
    CHANNELS,
    CURVE,
    LINE,
    PIXELS,
    SLACK_COLUMNS,
    SLACK_ROWS,
    blend,
    clear,
)
from nw_splat.kernels.project import RECORD
from nw_splat.store import memory_store, unpack

EPS2D = np.float32(0.3)
WIDTH, HEIGHT = 64, 40


_load, _store = LINE.load, LINE.store


@kernel
def _map_exp2(x, numbers, out):
    n = (
        broadcast(numbers[0]),
        broadcast(numbers[1]),
        broadcast(numbers[2]),
        broadcast(numbers[3]),
        broadcast(numbers[4]),
        broadcast(numbers[5]),
        broadcast(numbers[6]),
    )
    for i in range(0, len(x), 16):
        _store(out, i, 0, math8.exp2(_load(x, i, 0), n))


@kernel
def _map_log2(x, out):
    for i in range(0, len(x), 16):
        _store(out, i, 0, math8.log2(_load(x, i, 0)))


@kernel
def _map_taken(x, stride, offset, block, out):
    for i in range(0, len(x), 16):
        taken = math8.taken_below(_load(x, i, 0), stride, 1.0 / stride, offset, block)
        _store(out, i, 0, taken)


@kernel
def _map_halves(bits, out):
    for i in range(0, len(bits), 16):
        _store(out, i, 0, memory.load_halves(bits, i))


@pytest.mark.parametrize("by_instruction", [True, False])
def test_every_finite_half_is_widened_exactly(by_instruction, monkeypatch):
    monkeypatch.setattr(memory, "_CONVERTS_HALVES", by_instruction)
    bits = np.arange(1 << 16, dtype=np.uint16)
    bits = bits[np.isfinite(bits.view(np.float16))]
    out = np.empty(len(bits), dtype=np.float32)
    numba.njit(_map_halves.py_func)(bits, out)
    assert np.array_equal(out, bits.view(np.float16).astype(np.float32))


def test_exp2_is_within_two_roundings():
    x = np.linspace(-125, 125, 1 << 16, dtype=np.float32)
    out = np.empty_like(x)
    _map_exp2(x, np.float32(math8.EXP2), out)
    assert np.abs(out / np.exp2(x.astype(np.float64)) - 1).max() < 2e-7


def test_log2_is_within_two_roundings():
    x = np.exp2(np.linspace(-100, 100, 1 << 16)).astype(np.float32)
    out = np.empty_like(x)
    _map_log2(x, out)
    exact = np.log2(x.astype(np.float64))
    assert (np.abs(out - exact) < 2e-7 + 1e-7 * np.abs(exact)).all()


@pytest.mark.parametrize(
    "pixels", [Pixels(), Pixels(stride=16, block=2, offset=7), Pixels(stride=7, block=3, offset=1)]
)
def test_taken_below_counts_the_pixels_of_a_set(pixels):
    x = np.arange(-64, 2000, dtype=np.float32)
    out = np.empty_like(x)
    _map_taken(
        x, np.float32(pixels.stride), np.float32(pixels.offset), np.float32(pixels.block), out
    )
    indices = pixels.indices(2016)
    # Below zero the count goes on to negative numbers; they are clamped away later.
    assert np.array_equal(out[64:], np.searchsorted(indices, x[64:]))
    assert (out[:57] <= 0).all()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 3000), bits=st.integers(1, 31))
def test_radix_sort_is_a_stable_sort_on_all_bits(seed, count, bits):
    rng = np.random.default_rng(seed)
    upper = rng.integers(0, 1 << bits, count)
    keys = (upper << 32) | np.arange(count)
    scratch = np.empty_like(keys)
    expected = keys[np.argsort(upper, kind="stable")]
    histogram = np.empty(draw.HISTOGRAM, dtype=np.int64)
    in_scratch = draw.sort_keys(keys, scratch, count, (1 << bits) - 1, histogram)
    assert np.array_equal(scratch if in_scratch else keys, expected)


def test_sorting_leaves_what_is_beyond_the_boundary():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.01, 50, 500).astype(np.float32)
    depth[100:200] = depth[:100]
    keys, scratch, carried = (np.empty(500, dtype=np.int64) for _ in range(3))
    histogram = np.empty(draw.HISTOGRAM, dtype=np.int64)
    near, in_scratch, later = draw.sort_nearer(
        depth, 500, np.float32(20), keys, scratch, carried, histogram
    )
    ordered = (scratch if in_scratch else keys)[:near] & 0xFFFFFFFF
    below = np.flatnonzero(depth < 20)
    assert np.array_equal(ordered, below[np.argsort(depth[below], kind="stable")])
    assert np.array_equal(carried[:later], np.flatnonzero(depth >= 20))


def _project_all(store, camera, ray=None):
    layout = store.layout
    view = view_vector(camera, Pixels(), (0, camera.width, 0, camera.height))
    records = np.zeros((store.chunks * 256 + 8) * RECORD, dtype=np.float32)
    count = 0
    for chunk in range(store.chunks):
        count = project.project_chunk(
            layout.geometry, layout.dc, layout.sh, layout.sh_count, layout.bounds, chunk, chunk,
            view, EPS2D, True, np.float32(0), ray, None, records, count,
        )  # fmt: skip
    return view, records.reshape(-1, RECORD)[:count]


def _scalar_records(store, camera):
    """Records by the formulas, one Gaussian after the other, in float64."""
    splats = unpack(store.layout)
    view = camera.T_camera_world
    found = []
    for mean, covariance, opacity in zip(
        splats.means, splats.covariances.astype(float), splats.opacities, strict=True
    ):
        x, y, z = view[:3, :3] @ mean + view[:3, 3]
        if z < camera.near:
            continue
        low = -camera.cx / camera.fx - 0.15 * camera.width / camera.fx
        a = min(max(x / z, low), -low)
        low = -camera.cy / camera.fy - 0.15 * camera.height / camera.fy
        b = min(max(y / z, low), -low)
        J = np.array(
            [[camera.fx / z, 0, -camera.fx * a / z], [0, camera.fy / z, -camera.fy * b / z]]
        )
        M = J @ view[:3, :3]
        before = M @ covariance @ M.T
        after = before + 0.3 * np.eye(2)
        o = opacity * math.sqrt(max(np.linalg.det(before) / np.linalg.det(after), 0))
        if o < 1 / 255:
            continue
        conic = np.linalg.inv(after)
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        rx, ry = math.sqrt(2 * math.log(255 * o)) * np.sqrt(np.diag(after))
        columns = math.ceil(u - rx - 0.5), math.floor(u + rx - 0.5)
        rows = math.ceil(v - ry - 0.5), math.floor(v + ry - 0.5)
        columns = max(columns[0], 0), min(columns[1], camera.width - 1)
        rows = max(rows[0], 0), min(rows[1], camera.height - 1)
        if columns[0] <= columns[1] and rows[0] <= rows[1]:
            factor = 0.5 * math.log2(math.e)
            exponent = conic[0, 0] * factor, 2 * conic[0, 1] * factor, conic[1, 1] * factor
            found.append((u, v, *exponent, math.log2(o), z, columns, rows))
    return found


def test_projection_agrees_with_the_scalar_formulas():
    store, camera = memory_store(room(3000, degree=0)), eye_camera(1, WIDTH, HEIGHT)
    _, records = _project_all(store, camera)
    scalar = _scalar_records(store, camera)
    # The box is widened by a thousandth of a pixel, so a few specks more may be listed.
    assert len(scalar) <= len(records) <= len(scalar) + 5
    by_depth = {round(float(r[project.DEPTH]), 4): r for r in records}
    packed = records.view(np.int32)
    assert (packed[:, project.COLUMNS] >> 16).max() < WIDTH
    matched = 0
    for u, v, a, b, c, lo, z, columns, rows in scalar:
        record = by_depth.get(round(z, 4))
        if record is None or abs(record[project.U] - u) > 0.01:
            continue
        matched += 1
        assert record[project.V] == pytest.approx(v, abs=1e-3)
        assert record[[project.A, project.B, project.C]] == pytest.approx(
            (a, b, c), rel=2e-3, abs=1e-4
        )
        assert record[project.LOG_OPACITY] == pytest.approx(lo, abs=2e-3)
        box = int(record.view(np.int32)[project.COLUMNS])
        assert (box & 0xFFFF) <= columns[0] <= (box & 0xFFFF) + 1
        assert (box >> 16) - 1 <= columns[1] <= (box >> 16)
        box = int(record.view(np.int32)[project.ROWS])
        assert (box & 0xFFFF) <= rows[0] <= (box & 0xFFFF) + 1
        assert (box >> 16) - 1 <= rows[1] <= (box >> 16)
    assert matched > 0.9 * len(scalar)


@pytest.mark.parametrize("ray", [None, True], ids=["ewa", "ray"])
def test_culling_never_drops_a_chunk_that_draws(ray):
    store = memory_store(room(60_000, degree=0))
    for number in range(8):
        camera = eye_camera(number, WIDTH, HEIGHT)
        view, _ = _project_all(store, camera, ray)
        keys = np.empty(store.chunks, dtype=np.int64)
        nearest = np.empty(store.chunks, dtype=np.float32)
        visible = cull.visible_chunks(store.layout.bounds, view, EPS2D, keys, nearest)
        drawing = []
        layout = store.layout
        scratch = np.zeros((256 + 8) * RECORD, dtype=np.float32)
        for chunk in range(store.chunks):
            count = project.project_chunk(
                layout.geometry, layout.dc, layout.sh, 1, layout.bounds, chunk, chunk, view,
                EPS2D, True, np.float32(0), ray, None, scratch, 0,
            )  # fmt: skip
            if count:
                depth = scratch.reshape(-1, RECORD)[:count, project.DEPTH].min()
                drawing.append((chunk, depth))
        kept = dict(zip(keys[:visible].tolist(), nearest[:visible].tolist(), strict=True))
        assert visible < store.chunks
        for chunk, depth in drawing:
            assert kept[chunk] <= depth


@pytest.mark.parametrize("ray", [None, True], ids=["ewa", "ray"])
def test_a_chunk_is_hidden_only_when_every_block_it_touches_is_finished(ray):
    store, camera = memory_store(room(20_000, degree=0)), eye_camera(2, WIDTH, HEIGHT)
    layout = store.layout
    view, _ = _project_all(store, camera)
    stride = WIDTH // 8 + 1
    scratch = np.zeros((256 + 8) * RECORD, dtype=np.float32)
    hidden = 0
    for chunk in range(store.chunks):
        count = project.project_chunk(
            layout.geometry, layout.dc, layout.sh, 1, layout.bounds, chunk, chunk, view,
            EPS2D, True, np.float32(0), ray, None, scratch, 0,
        )  # fmt: skip
        boxes = scratch.view(np.int32).reshape(-1, RECORD)[:count]
        live = np.ones((HEIGHT // 8 + 1, stride), dtype=np.int64)
        assert not cull.is_hidden(layout.bounds, chunk, view, EPS2D, ray, live.reshape(-1), stride)
        # Only the blocks that its records touch are live: it must never count as hidden.
        live[:] = 0
        for columns, rows in boxes[:, [project.COLUMNS, project.ROWS]]:
            live[
                (rows & 0xFFFF) >> 3 : (rows >> 19) + 1,
                (columns & 0xFFFF) >> 3 : (columns >> 19) + 1,
            ] = 1
        flat = live.reshape(-1)
        assert cull.is_hidden(layout.bounds, chunk, view, EPS2D, ray, flat, stride) <= (count == 0)
        live[:] = 0
        hidden += cull.is_hidden(layout.bounds, chunk, view, EPS2D, ray, flat, stride)
    assert hidden > 10


def _blend(records, view, width, height, *, some=1 << 30):
    """Return (light, paint, live, pixels not finished, splats drawn) of records in a window.

    `some` records are blended at a time: what is finished is looked at before each of these.
    """
    stride, blocks = width + SLACK_COLUMNS, width // 8 + 1
    light = np.empty((height + SLACK_ROWS) * stride, dtype=np.float32)
    paint = np.empty(light.size * CHANNELS, dtype=np.float32)
    live = np.empty(blocks * (height // 8 + 1), dtype=np.int64)
    clear(light, paint, stride, width, height, live, blocks)
    order = np.argsort(records[:, project.DEPTH], kind="stable").astype(np.int64)
    columns, rows = (
        np.append(np.arange(side) + 0.5, np.zeros(PIXELS)).astype(np.float32)
        for side in (width, height)
    )
    drawn = 0
    for start in range(0, len(order), some):
        part = order[start : start + some]
        left, _, now = blend(
            np.ascontiguousarray(records).reshape(-1), part, len(part), columns, rows, light, paint,
            stride, live, blocks, view, np.float32(0.999), None, None, CURVE,
        )  # fmt: skip
        drawn += now
    inside = np.s_[:height, :width]
    light = light.reshape(-1, stride)[inside]
    paint = paint.reshape(-1, stride, CHANNELS)[inside]
    return light, paint, live, left, drawn


def _scalar_blend(records, width, height, most_alpha):
    """gsplat's rule, pixel by pixel, in float64."""
    order = np.argsort(records[:, project.DEPTH], kind="stable")
    T = np.ones((height, width))
    total = np.zeros((4, height, width))
    done = np.zeros((height, width), dtype=bool)
    y, x = np.mgrid[:height, :width] + 0.5
    for r in records[order].astype(np.float64):
        dx, dy = x - r[project.U], y - r[project.V]
        power = r[project.LOG_OPACITY] - (
            r[project.A] * dx * dx + r[project.B] * dx * dy + r[project.C] * dy * dy
        )
        alpha = np.minimum(np.exp2(power), most_alpha)
        hit = (power >= project.THRESHOLD) & ~done
        finish = hit & (T * (1 - alpha) <= 1e-4)
        done |= finish
        weight = np.where(hit & ~finish, alpha * T, 0)
        values = r[[project.RED, project.GREEN, project.BLUE, project.DEPTH]]
        total += weight * values[:, None, None]
        T -= weight
    return T, total, done


def _records_in_front(size, *, opacity=2):
    """Return (view, records) of a cloud before a camera, by the logarithm of its splats' size."""
    gaussians = cloud(3000, degree=0, spread=(2, 2, 1), centre=(0, 0, 4))
    gaussians.log_scales[:] += np.float32(size + 2.5)
    gaussians.opacity_logits[:] += opacity
    camera = eye_camera(1, WIDTH, HEIGHT)
    camera = type(camera)(
        width=WIDTH, height=HEIGHT, fx=40, fy=40, cx=32, cy=20, T_world_camera=np.eye(4)
    )
    return _project_all(memory_store(gaussians), camera)


@pytest.mark.parametrize("size", [-2.0, -1.2, -0.5])
def test_leaving_out_what_lies_behind_finished_pixels_changes_no_bit(size):
    view, records = _records_in_front(size, opacity=6)
    whole = _blend(records, view, WIDTH, HEIGHT)
    parts = _blend(records, view, WIDTH, HEIGHT, some=50)
    for once, looked_at in zip(whole[:2], parts[:2], strict=True):
        assert np.array_equal(once.view(np.int32), looked_at.view(np.int32))
    assert whole[3] < WIDTH * HEIGHT, "some are finished"
    assert parts[4] < whole[4], "and what is behind them is left out"


@pytest.mark.parametrize("size", [-3.5, -2.0, -0.5])
def test_blending_agrees_with_the_scalar_rule_for_splats_of_every_width(size):
    view, records = _records_in_front(size)
    light, paint, live, left, drawn = _blend(records, view, WIDTH, HEIGHT)
    T, total, done = _scalar_blend(records, WIDTH, HEIGHT, 0.999)
    assert drawn > 50
    assert np.abs(np.abs(light) - T).max() < 4e-3
    assert np.abs(paint.transpose(2, 0, 1) - total)[:3].max() < 4e-3
    assert np.median(np.abs(np.abs(light) - T)) < 1e-6
    # A pixel may finish one splat sooner or later by rounding, but hardly any does.
    assert ((light < 0) != done).mean() < 0.01
    assert live.sum() == left == (light > 0).sum()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([-3.5, -2.5, -1.5]),
    wider=st.sampled_from([4, 8, 16, 40]),
)
def test_the_shape_that_a_splat_is_drawn_with_changes_no_bit(seed, size, wider):
    gaussians = cloud(400, degree=0, seed=seed, spread=(2, 2, 1), centre=(0, 0, 4))
    gaussians.log_scales[:] += np.float32(size + 2.5)
    gaussians.opacity_logits[:] += 2
    camera = eye_camera(1, WIDTH, HEIGHT)
    camera = type(camera)(
        width=WIDTH, height=HEIGHT, fx=40, fy=40, cx=32, cy=20, T_world_camera=np.eye(4)
    )
    view, records = _project_all(memory_store(gaussians), camera)
    light, paint, *_ = _blend(records, view, WIDTH, HEIGHT)
    # A larger box has no more pixels of the splat, but asks for another shape.
    boxes = records.view(np.int32)
    for place, side in ((project.COLUMNS, WIDTH), (project.ROWS, HEIGHT)):
        first, last = boxes[:, place] & 0xFFFF, boxes[:, place] >> 16
        boxes[:, place] = first | np.minimum(np.maximum(last, first + wider), side - 1) << 16
    other_light, other_paint, *_ = _blend(records, view, WIDTH, HEIGHT)
    assert np.array_equal(light, other_light)
    assert np.array_equal(paint, other_paint)
