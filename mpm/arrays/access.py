"""How kernels read and write the arrays: vectors of lanes, which run on vector registers, and strides of the box.

A value of a kernel here is either a number or a Taichi vector with one entry per particle of a block; with
`real_matrix_scalarize=False` the latter is one vector value to LLVM, which computes all lanes at once. Such code has no
branches: both sides are computed, and `ti.select` takes one of them lane by lane.

Taichi 1.7.4 cannot negate or cast such vectors, nor take their absolute value: write `0.0 - a` and `a = a - b`, not
`-a` and `a -= b`, and leave casts to single lanes.

On a GPU a block is one particle and a vector of lanes is a number: the same code, without this file's vectors.
"""

import taichi as ti

from mpm.arrays.layout import INDEX_LIMIT, PADDING, Offset

TINY = 1.0e-30  # keeps a quotient finite if its denominator is zero and its numerator is smaller still


@ti.func
def maximum(a, b):
    """The larger of two, lane by lane; one instruction, where `ti.max`, which handles NaN, takes four."""
    return ti.select(a > b, a, b)


@ti.func
def minimum(a, b):
    """The smaller of two, lane by lane."""
    return ti.select(a < b, a, b)


@ti.func
def clamp(a, low, high):
    """`a` clamped to [low, high], lane by lane."""
    return minimum(maximum(a, low), high)


@ti.func
def magnitude(a):
    """|a|, lane by lane."""
    return maximum(a, 0.0 - a)


@ti.func
def dot(a: ti.template(), b: ti.template()):
    """The product of two vectors that are lists of their components, lane by lane."""
    value = a[0] * b[0]
    for k in ti.static(range(1, len(a))):
        value = value + a[k] * b[k]
    return value


@ti.func
def over_lanes(operation: ti.template(), a: ti.template(), count: ti.template()):
    """`minimum` or `maximum` over `count` lanes, a power of two: combine the halves until one lane is left."""
    if ti.static(count == 1):
        return a
    elif ti.static(count == 2):
        return operation(a[0], a[1])
    else:
        half = ti.static(count // 2)
        low = ti.Vector([a[lane] for lane in ti.static(range(half))])
        high = ti.Vector([a[lane] for lane in ti.static(range(half, count))])
        return over_lanes(operation, operation(low, high), half)


@ti.func
def lane_sum(a, arrays: ti.template()):
    """Sum over the lanes, in double precision."""
    if ti.static(arrays.features.lanes == 1):
        return ti.cast(a, ti.f64)
    else:
        value = ti.cast(a[0], ti.f64)
        for lane in ti.static(range(1, arrays.features.lanes)):
            value += ti.cast(a[lane], ti.f64)
        return value


@ti.func
def vectors(array: ti.template(), first, count: ti.template()):
    """`count` vectors of a block from `first` on, as a list."""
    return [array[first + k] for k in ti.static(range(count))]


@ti.func
def present(block, arrays: ti.template()):
    """1 for each particle of a block, 0 for the lanes that only mirror one."""
    return arrays.state[block * arrays.features.state.size + arrays.features.state.present]


@ti.func
def lane_numbers(numbers: ti.template(), first, arrays: ti.template()):
    """D numbers of a lane from `first` on, one per vector of its block."""
    features = arrays.features
    return ti.Vector([numbers[first + k * features.lanes] for k in ti.static(range(features.dimension))])


@ti.func
def put_lane_numbers(numbers: ti.template(), first, value, arrays: ti.template()):
    """Put D numbers where `lane_numbers` reads them."""
    for k in ti.static(range(arrays.features.dimension)):
        numbers[first + k * arrays.features.lanes] = value[k]


@ti.func
def no_overflow(index):
    """An index below INDEX_LIMIT, masked for the compiler, which can then fold an added constant into an address.

    Otherwise the compiler has to allow for a 32-bit overflow at every node and every number of a particle.
    """
    return index & (INDEX_LIMIT - 1)


@ti.func
def add(array: ti.template(), at, value, arrays: ti.template()):
    """array[at] += value. Atomic only on a GPU: on a CPU Taichi would make it a compare-and-swap loop."""
    if ti.static(arrays.features.processor.gpu):
        ti.atomic_add(array[at], value)
    else:
        array[at] = array[at] + value


@ti.func
def box_cells(scene, arrays: ti.template()):
    """Cells of the box along each axis, shape [D]."""
    features = arrays.features
    return ti.Vector([arrays.offsets[scene, Offset.CELLS_X + k] for k in ti.static(range(features.dimension))])


@ti.func
def columns_deep(scene, arrays: ti.template()):
    """Columns of nodes between neighbours along x: the number of columns along z, 1 in 2D."""
    deep = 1
    if ti.static(arrays.features.dimension == 3):
        deep = arrays.offsets[scene, Offset.CELLS_Z] + 2 * PADDING + 1
    return deep


@ti.func
def synchronise(thread, arrays: ti.template()):
    """Wait until all threads of a shared scene have arrived; no effect if scenes are not shared.

    Taichi's own barrier is the end of a call, which takes a third of a millisecond, as long as a step of 10,000
    particles; this one takes a microsecond. All threads run at once, because Taichi has that many. Reading by adding
    zero forces the compiler to read every time.
    """
    if ti.static(arrays.features.processor.shared):
        arrived = ti.atomic_add(arrays.arrivals[thread], 1) + 1
        for other in range(arrays.arrivals.shape[0]):
            while ti.atomic_add(arrays.arrivals[other], 0) < arrived:
                pass


@ti.func
def workers_of(thread, arrays: ti.template()):
    """The first worker of a thread, and the one behind its last."""
    count, threads = arrays.workers.shape[0], arrays.arrivals.shape[0]
    return thread * count // threads, (thread + 1) * count // threads
