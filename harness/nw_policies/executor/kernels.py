"""The compiled half of networks: an interpreter that runs all rows of a program in one call.

Memory is one float32 arena; a program is rows of int64, and row fields are offsets, sizes and
strides in floats. Rows are unchecked here: `program.check` has shown that each stays in the arena.

Sums have one order on every machine: products are one chain of fused multiply-adds in the order of
k for each number, and rows are summed in sixteen lanes that are folded by halves. How many rows and
columns a tile takes depends on the processor's registers and changes no bit.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from typing import Any

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import types

from nw_base.machine_code import inlined, kernel, part
from nw_base.simd.lanes import (
    F16,
    I32,
    FloatsType,
    address,
    broadcast,
    broadcast_ir,
    fused,
    intrinsic,
    joined,
    lane_list,
    sqrt,
    where,
)
from nw_base.simd.memory import elements, load_group, peek, poke, store_group
from nw_policies.executor import functions
from nw_policies.executor.functions import first_lanes, same
from nw_policies.executor.program import (
    ABS,
    ADD,
    CEIL,
    COPY,
    DIV,
    ELEMENTS,
    ELU,
    ERF,
    EXP,
    FLOOR,
    LEAKY,
    LESS,
    LOG,
    MAX,
    MIN,
    MUL,
    NEG,
    NORM,
    PACK,
    PANEL,
    PRODUCT,
    REDUCE,
    RELU,
    ROUND,
    SCALED,
    SELECT,
    SIGMOID,
    SIGN,
    SIN,
    SOFTMAX,
    SOFTPLUS,
    SQRT,
    SUB,
    TANH,
    UNARY,
)


def _columns(rows: int, panels: int, kind: Any) -> Any:
    @intrinsic
    def columns(_typing: Any, array: Any, start: Any, step: Any) -> Any:
        """Return sixteen floats of each panel, for each row again."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            loaded: list[Any] = []
            place = args[1]
            for _ in range(panels):
                pointer = address(context, builder, signature.args[0], args[0], place)
                loaded.append(builder.load(builder.bitcast(pointer, F16.as_pointer()), align=4))
                place = builder.add(place, args[2])
            return joined(builder, loaded * rows)

        return kind(array, types.intp, types.intp), generate

    return columns


def _factors(rows: int, panels: int, kind: Any) -> Any:
    @intrinsic
    def factors(_typing: Any, array: Any, start: Any, step: Any) -> Any:
        """Return one number of each row in all its lanes."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            spread: list[Any] = []
            place = args[1]
            for _ in range(rows):
                pointer = address(context, builder, signature.args[0], args[0], place)
                spread += [broadcast_ir(builder, builder.load(pointer), PANEL)] * panels
                place = builder.add(place, args[2])
            return joined(builder, spread)

        return kind(array, types.intp, types.intp), generate

    return factors


def _writing(rows: int, panels: int, kind: Any) -> Any:
    @intrinsic
    def write(
        _typing: Any, array: Any, start: Any, step: Any, width: Any, scratch: Any, value: Any
    ) -> Any:
        """Write `width` columns of each row; a panel that has fewer goes by way of `scratch`."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            array, start, step, width, scratch, value = args
            undefined = ir.Constant(value.type, ir.Undefined)

            def pointer(place: Any) -> Any:
                return address(context, builder, signature.args[0], array, place)

            for number in range(rows * panels):
                row, panel = divmod(number, panels)
                lanes = lane_list(list(range(PANEL * number, PANEL * (number + 1))))
                piece = builder.shuffle_vector(value, undefined, lanes)
                place = builder.add(start, ir.Constant(width.type, PANEL * panel))
                left = builder.sub(width, ir.Constant(width.type, PANEL * panel))
                is_full = builder.icmp_signed(">=", left, ir.Constant(width.type, PANEL))
                target = pointer(builder.select(is_full, place, scratch))
                builder.store(piece, builder.bitcast(target, F16.as_pointer()), align=4)
                with builder.if_then(builder.not_(is_full)):
                    for lane in range(PANEL - 1):
                        one = ir.Constant(width.type, lane)
                        with builder.if_then(builder.icmp_signed("<", one, left)):
                            item = builder.extract_element(piece, ir.Constant(I32, lane))
                            builder.store(item, pointer(builder.add(place, one)))
                if panel == panels - 1 and row < rows - 1:
                    start = builder.add(start, step)
            return context.get_dummy_value()

        arguments = (array, types.intp, types.intp, types.intp, types.intp, kind)
        return types.void(*arguments), generate

    return write


def _tile(rows: int, panels: int) -> Any:
    """Return the function that multiplies some rows with some panels of weights.

    Sixteen lanes for each row and panel hold the sums; LLVM spreads them over registers.
    """
    kind = FloatsType(PANEL * rows * panels)
    columns, factors = _columns(rows, panels, kind), _factors(rows, panels, kind)
    write = _writing(rows, panels, kind)

    @part
    def multiply(
        a: Any, x: Any, xs: Any, n1: Any, s1: Any, n2: Any, s2: Any, n3: Any, w: Any, ws: Any,
        b: Any, y: Any, ys: Any, width: Any, has_relu: Any, scratch: Any,
    ) -> None:  # fmt: skip
        sums = columns(a, b, PANEL)
        for i in range(n1):
            for j in range(n2):
                place = x + i * s1 + j * s2
                for k in range(n3):
                    sums = fused(factors(a, place + k, xs), columns(a, w, ws), sums)
                    w += PANEL
        if has_relu:
            sums = where(sums < 0.0, 0.0, sums)
        write(a, y, ys, width, scratch, sums)

    return multiply


# Eight chains under way at a time hide the latency of the multiply-add, in registers of sixteen
# lanes where there are thirty-two of them; elsewhere as many registers hold half the numbers.
TALL = 8 if get_host_cpu_features().get("avx512f") else 4


def _band(rows: int) -> Any:
    """Return the function that multiplies some rows with all panels, several at a time."""
    width = max(TALL // rows, 1)
    wide, narrow = _tile(rows, width), _tile(rows, 1)

    @part
    def multiply(
        a: Any, x: Any, xs: Any, n1: Any, s1: Any, n2: Any, s2: Any, n3: Any, w: Any, panel: Any,
        b: Any, y: Any, ys: Any, columns: Any, relu: Any, scratch: Any,
    ) -> None:  # fmt: skip
        p, panels = 0, (columns + PANEL - 1) // PANEL
        while p + width <= panels:
            wide(
                a, x, xs, n1, s1, n2, s2, n3, w + p * panel, panel, b + p * PANEL, y + p * PANEL,
                ys, columns - p * PANEL, relu, scratch,
            )  # fmt: skip
            p += width
        while p < panels:
            narrow(
                a, x, xs, n1, s1, n2, s2, n3, w + p * panel, panel, b + p * PANEL, y + p * PANEL,
                ys, columns - p * PANEL, relu, scratch,
            )  # fmt: skip
            p += 1

    return multiply


_tall, _four, _two, _one = _band(TALL), _band(4), _band(2), _band(1)


@part
def _product(a: Any, q: Any, i: Any, scratch: Any) -> None:
    """Y = relu(x W + b) in panels of columns; rows of x may be windows of an image."""
    x, xs, n1, s1, n2, s2, n3 = q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5], q[i, 6], q[i, 7]
    w, b, columns, y, ys, rows, relu = (
        q[i, 8], q[i, 9], q[i, 10], q[i, 11], q[i, 12], q[i, 13], q[i, 14],
    )  # fmt: skip
    panel = n1 * n2 * n3 * PANEL
    for _ in range(q[i, 15]):
        row = 0
        while row + TALL <= rows:
            xr, yr = x + row * xs, y + row * ys
            _tall(a, xr, xs, n1, s1, n2, s2, n3, w, panel, b, yr, ys, columns, relu, scratch)
            row += TALL
        while row + 4 <= rows:
            xr, yr = x + row * xs, y + row * ys
            _four(a, xr, xs, n1, s1, n2, s2, n3, w, panel, b, yr, ys, columns, relu, scratch)
            row += 4
        if row + 2 <= rows:
            xr, yr = x + row * xs, y + row * ys
            _two(a, xr, xs, n1, s1, n2, s2, n3, w, panel, b, yr, ys, columns, relu, scratch)
            row += 2
        if row < rows:
            xr, yr = x + row * xs, y + row * ys
            _one(a, xr, xs, n1, s1, n2, s2, n3, w, panel, b, yr, ys, columns, relu, scratch)
        x += q[i, 16]
        y += q[i, 17]
        w += q[i, 18]


@part
def _pack(a: Any, q: Any, i: Any) -> None:
    """Lay a computed matrix (depth, columns) of any strides out as panels of weights."""
    source, deep, across, depth, columns, target = (
        q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5], q[i, 6],
    )  # fmt: skip
    for _ in range(q[i, 7]):
        for p in range((columns + PANEL - 1) // PANEL):
            for k in range(depth):
                for j in range(PANEL):
                    n = p * PANEL + j
                    value = peek(a, source + k * deep + n * across) if n < columns else peek(a, 0)
                    poke(a, target + (p * depth + k) * PANEL + j, value)
        source += q[i, 8]
        target += q[i, 9]


@inlined
def _write(a: Any, place: Any, value: Any, count: Any, scratch: Any) -> None:
    """Write at most sixteen lanes."""
    if count >= PANEL:
        store_group(a, place, value)
    else:
        store_group(a, scratch, value)
        for k in range(count):
            poke(a, place + k, peek(a, scratch + k))


@inlined
def _lanes_at(a: Any, place: Any, stride: Any) -> Any:
    """Return sixteen floats in a row, or one in all lanes where the stride is 0."""
    return load_group(a, place) if stride == 1 else broadcast(peek(a, place))


@inlined
def _combined(f: Any, u: Any, v: Any) -> Any:
    if f == ADD:
        z = u + v
    elif f == SUB:
        z = u - v
    elif f == MUL:
        z = u * v
    elif f == DIV:
        z = u / v
    elif f == MAX:
        z = where(same(v, v), where(u < v, v, u), v)
    elif f == MIN:
        z = where(same(v, v), where(u > v, v, u), v)
    elif f == LESS:
        z = where(u < v, broadcast(1.0), 0.0)
    else:
        z = where(same(u, v), broadcast(1.0), 0.0)
    return z


@part
def _gather_lanes(a: Any, place: Any, stride: Any, count: Any, room: Any) -> None:
    """Bring at most sixteen floats of any stride together."""
    for k in range(min(count, PANEL)):
        poke(a, room + k, peek(a, place + k * stride))


@part
def _elements(a: Any, q: Any, i: Any, scratch: Any) -> None:
    """D = f(x, y) over four dimensions with strides; sixteen lanes of the last at a time."""
    f, n = q[i, 1], q[i, 5]
    sx, sy, sd = q[i, 9], q[i, 13], q[i, 17]
    for i0 in range(q[i, 2]):
        for i1 in range(q[i, 3]):
            for i2 in range(q[i, 4]):
                x = q[i, 18] + i0 * q[i, 6] + i1 * q[i, 7] + i2 * q[i, 8]
                y = q[i, 19] + i0 * q[i, 10] + i1 * q[i, 11] + i2 * q[i, 12]
                d = q[i, 20] + i0 * q[i, 14] + i1 * q[i, 15] + i2 * q[i, 16]
                for j in range(0, n, PANEL):
                    px, py = x + j * sx, y + j * sy
                    tx, ty = sx, sy
                    if not 0 <= sx <= 1:
                        _gather_lanes(a, px, sx, n - j, scratch)
                        px, tx = scratch, 1
                    if not 0 <= sy <= 1:
                        _gather_lanes(a, py, sy, n - j, scratch + PANEL)
                        py, ty = scratch + PANEL, 1
                    z = _combined(f, _lanes_at(a, px, tx), _lanes_at(a, py, ty))
                    if sd == 1:
                        _write(a, d + j, z, n - j, scratch)
                    else:
                        store_group(a, scratch, z)
                        for k in range(min(n - j, PANEL)):
                            poke(a, d + (j + k) * sd, peek(a, scratch + k))


@part
def _scaled(a: Any, q: Any, i: Any, scratch: Any) -> None:
    """D = g(f(x, number), y) as `_elements`, along the last dimension without gaps in x and D."""
    f, n, sy = q[i, 1], q[i, 5], q[i, 13]
    first, number = q[i, 21], broadcast(peek(a, q[i, 22]))
    for i0 in range(q[i, 2]):
        for i1 in range(q[i, 3]):
            for i2 in range(q[i, 4]):
                x = q[i, 18] + i0 * q[i, 6] + i1 * q[i, 7] + i2 * q[i, 8]
                y = q[i, 19] + i0 * q[i, 10] + i1 * q[i, 11] + i2 * q[i, 12]
                d = q[i, 20] + i0 * q[i, 14] + i1 * q[i, 15] + i2 * q[i, 16]
                for j in range(0, n, PANEL):
                    z = _combined(first, load_group(a, x + j), number)
                    z = _combined(f, z, _lanes_at(a, y + j * sy, sy))
                    _write(a, d + j, z, n - j, scratch)


@part
def _select(a: Any, q: Any, i: Any) -> None:
    """D = x where the condition is not 0, else y, over four dimensions."""
    for i0 in range(q[i, 2]):
        for i1 in range(q[i, 3]):
            for i2 in range(q[i, 4]):
                c = q[i, 22] + i0 * q[i, 6] + i1 * q[i, 7] + i2 * q[i, 8]
                x = q[i, 23] + i0 * q[i, 10] + i1 * q[i, 11] + i2 * q[i, 12]
                y = q[i, 24] + i0 * q[i, 14] + i1 * q[i, 15] + i2 * q[i, 16]
                d = q[i, 25] + i0 * q[i, 18] + i1 * q[i, 19] + i2 * q[i, 20]
                for j in range(q[i, 5]):
                    if peek(a, c + j * q[i, 9]) != 0.0:
                        value = peek(a, x + j * q[i, 13])
                    else:
                        value = peek(a, y + j * q[i, 17])
                    poke(a, d + j * q[i, 21], value)


@part
def _unary(  # noqa: C901, PLR0912 - one branch for each function.
    a: Any, q: Any, i: Any, scratch: Any
) -> None:
    """Apply a function to floats in a row; ELU and leaky ReLU have a parameter."""
    f, x, d, n = q[i, 1], q[i, 2], q[i, 3], q[i, 4]
    for j in range(0, n, PANEL):
        u = load_group(a, x + j)
        if f == RELU:
            z = where(u < 0.0, 0.0, u)
        elif f == LEAKY:
            z = where(u < 0.0, u * peek(a, q[i, 5]), u)
        elif f == ELU:
            z = where(u < 0.0, functions.expm1_16(u) * peek(a, q[i, 5]), u)
        elif f == TANH:
            z = functions.tanh16(u)
        elif f == SIGMOID:
            z = functions.sigmoid16(u)
        elif f == EXP:
            z = functions.exp16(u)
        elif f == LOG:
            z = functions.log16(u)
        elif f == SQRT:
            z = sqrt(u)
        elif f == NEG:
            z = 0.0 - u
        elif f == ABS:
            z = functions.magnitude(u)
        elif f == ERF:
            z = functions.erf16(u)
        elif f == SOFTPLUS:
            z = functions.softplus16(u)
        elif f == FLOOR:
            z = functions.floor16(u)
        elif f == CEIL:
            z = 0.0 - functions.floor16(0.0 - u)
        elif f == ROUND:
            z = functions.round16(u)
        elif f == SIGN:
            z = where(u > 0.0, 1.0, where(u < 0.0, -1.0, u))
        elif f == SIN:
            z = functions.sin16(u)
        else:
            z = functions.cos16(u)
        _write(a, d + j, z, n - j, scratch)


@part
def _copy(a: Any, q: Any, i: Any) -> None:
    """D = x over four dimensions with strides."""
    n, sx, sd = q[i, 5], q[i, 9], q[i, 13]
    for i0 in range(q[i, 2]):
        for i1 in range(q[i, 3]):
            for i2 in range(q[i, 4]):
                x = q[i, 14] + i0 * q[i, 6] + i1 * q[i, 7] + i2 * q[i, 8]
                d = q[i, 15] + i0 * q[i, 10] + i1 * q[i, 11] + i2 * q[i, 12]
                j = 0
                if sx == 1 and sd == 1:
                    while j + PANEL <= n:
                        store_group(a, d + j, load_group(a, x + j))
                        j += PANEL
                while j < n:
                    poke(a, d + j * sd, peek(a, x + j * sx))
                    j += 1


@inlined
def _row_sum(a: Any, x: Any, n: Any, zero: Any) -> Any:
    total = zero
    for j in range(0, n, PANEL):
        total = total + where(first_lanes(n - j), load_group(a, x + j), zero)
    return functions.fold_sum(total)


@part
def _norm(a: Any, q: Any, i: Any, scratch: Any) -> None:
    """Normalise rows: mean, then the mean of squared deviations; then scale and shift."""
    x, rows, n, gamma, beta, numbers, y = (
        q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5], q[i, 6], q[i, 7],
    )  # fmt: skip
    eps, count = peek(a, numbers), peek(a, numbers + 1)
    zero = broadcast(0.0)
    for _ in range(rows):
        mean = broadcast(_row_sum(a, x, n, zero) / count)
        total = zero
        for j in range(0, n, PANEL):
            away = where(first_lanes(n - j), load_group(a, x + j) - mean, zero)
            total = fused(away, away, total)
        scale = 1.0 / sqrt(broadcast(functions.fold_sum(total) / count) + eps)
        for j in range(0, n, PANEL):
            z = (load_group(a, x + j) - mean) * scale
            z = fused(z, load_group(a, gamma + j), load_group(a, beta + j))
            _write(a, y + j, z, n - j, scratch)
        x += n
        y += n


@part
def _softmax(a: Any, q: Any, i: Any, scratch: Any) -> None:
    """Softmax of rows; with `log` its logarithm."""
    x, rows, n, y, is_log = q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5]
    zero = broadcast(0.0)
    lowest = zero - 1.0 / zero
    for _ in range(rows):
        top = lowest
        for j in range(0, n, PANEL):
            u = where(first_lanes(n - j), load_group(a, x + j), lowest)
            top = where(u > top, u, top)
        most = broadcast(functions.fold_max(top))
        total = zero
        for j in range(0, n, PANEL):
            z = load_group(a, x + j) - most
            e = functions.exp16(z)
            total = total + where(first_lanes(n - j), e, zero)
            _write(a, y + j, z if is_log else e, n - j, scratch)
        whole = broadcast(functions.fold_sum(total))
        less = functions.log16(whole)
        for j in range(0, n, PANEL):
            u = load_group(a, y + j)
            _write(a, y + j, u - less if is_log else u / whole, n - j, scratch)
        x += n
        y += n


@part
def _reduce(a: Any, q: Any, i: Any) -> None:
    """One number of each row of floats: sum, product, maximum or minimum."""
    f, x, rows, n, y = q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5]
    zero = broadcast(0.0)
    for r in range(rows):
        if f == ADD:
            value = _row_sum(a, x, n, zero)
        elif f == MUL:
            total = zero + 1.0
            for j in range(0, n, PANEL):
                total = total * where(first_lanes(n - j), load_group(a, x + j), 1.0)
            value = functions.fold_product(total)
        else:
            first = broadcast(peek(a, x))
            total = first
            for j in range(0, n, PANEL):
                u = where(first_lanes(n - j), load_group(a, x + j), first)
                total = where(u > total, u, total) if f == MAX else where(u < total, u, total)
            value = functions.fold_max(total) if f == MAX else functions.fold_min(total)
        poke(a, y + r, value)
        x += n


@part
def _pool(a: Any, q: Any, i: Any) -> None:
    """Largest number, or sum, of windows of an image of channels, rows and columns."""
    f, channels, rows, columns, high, wide = (
        q[i, 1], q[i, 2], q[i, 3], q[i, 4], q[i, 5], q[i, 6],
    )  # fmt: skip
    for c in range(channels):
        for r in range(rows):
            for k in range(columns):
                x = q[i, 15] + c * q[i, 7] + r * q[i, 8] + k * q[i, 9]
                value = peek(a, x)
                for s in range(high):
                    for t in range(wide):
                        other = peek(a, x + s * q[i, 10] + t * q[i, 11])
                        if f == MAX:
                            value = max(value, other)
                        elif s + t > 0:
                            value = value + other
                poke(a, q[i, 16] + c * q[i, 12] + r * q[i, 13] + k * q[i, 14], value)


@kernel
def run(  # noqa: C901 - one branch for each operation.
    arena: Any, program: Any, scratch: Any
) -> None:
    """Run the rows of a program.

    Args:
        arena: (n,) float32.
        program: (rows, WIDTH) int64, checked against the arena.
        scratch: offset of 48 floats that no row uses.
    """
    a = elements(arena)
    for i in range(program.shape[0]):
        operation = program[i, 0]
        if operation == PRODUCT:
            _product(a, program, i, scratch)
        elif operation == ELEMENTS:
            _elements(a, program, i, scratch)
        elif operation == UNARY:
            _unary(a, program, i, scratch)
        elif operation == COPY:
            _copy(a, program, i)
        elif operation == NORM:
            _norm(a, program, i, scratch)
        elif operation == SOFTMAX:
            _softmax(a, program, i, scratch)
        elif operation == PACK:
            _pack(a, program, i)
        elif operation == REDUCE:
            _reduce(a, program, i)
        elif operation == SELECT:
            _select(a, program, i)
        elif operation == SCALED:
            _scaled(a, program, i, scratch)
        else:
            _pool(a, program, i)
