"""Sums over the nodes of a particle: with few instructions on a CPU (`mpm.arrays.bitcode`), in plain code on a GPU.

Weights are numbers, values are vectors of nodes. The sums over a column form a pair of nodes: one with the weights of
its three nodes, one with three other weights.
"""

import taichi as ti

from mpm.arrays.bitcode import SIZES, call
from mpm.arrays.features import NODE, REGISTER
from mpm.arrays.layout import CACHE_LINE, Address


@ti.func
def zero_node():
    """A node's vector of zeros."""
    return ti.Vector([0.0 for _ in ti.static(range(NODE))])


@ti.func
def zero_pair():
    """The zeros of two nodes, side by side."""
    return ti.Vector([0.0 for _ in ti.static(range(2 * NODE))])


@ti.func
def node_address(grid, node, arrays: ti.template()):
    """Address of a node in memory; grid: address of the first node."""
    return grid + ti.cast(node, ti.i64) * ti.static(NODE * SIZES[arrays.features.precision][1])


@ti.func
def add_to_column(grid, node, w: ti.template(), value, step, arrays: ti.template()):
    """Add to `node` of the grid, at that address, and the two above it: w_0 value, w_1 (value + step), and so on."""
    address, here, rise, w0, w1, w2 = node_address(grid, node, arrays), value, step, w[0], w[1], w[2]
    ti.static(call("add_to_column", arrays.features.precision))(address, here, rise, w0, w1, w2)


@ti.func
def column_sums(grid, node, weights: ti.template(), arrays: ti.template()):
    """Sums over `node` of the grid, at that address, and the two above it, with three pairs of weights (`pair_of`)."""
    total = zero_pair()
    if ti.static(arrays.features.processor.gpu):
        for c in ti.static(range(3)):
            value = arrays.grid[node + c]
            twice = ti.Vector([value[k % NODE] for k in ti.static(range(2 * NODE))])
            total = total + weights[c] * twice
    else:
        address, s0, s1, s2 = node_address(grid, node, arrays), weights[0], weights[1], weights[2]
        ti.static(call("column_sums", arrays.features.precision))(total, address, s0, s1, s2)
    return total


@ti.func
def pair_of(one, other, arrays: ti.template()):
    """A pair of nodes, in the first one number everywhere, in the second another."""
    pair = zero_pair()
    if ti.static(arrays.features.processor.gpu):
        pair = ti.Vector([one if k < NODE else other for k in ti.static(range(2 * NODE))])
    else:
        first, second = one, other
        ti.static(call("pair_of", arrays.features.precision))(pair, first, second)
    return pair


@ti.func
def fused(scale, value, total, name: ti.template(), arrays: ti.template()):
    """scale value + total; `name` is "add_scaled" for nodes, "add_scaled_pair" for pairs."""
    result = total
    if ti.static(arrays.features.processor.gpu):
        result = scale * value + total
    else:
        a, b = scale, value
        ti.static(call(name, arrays.features.precision))(result, a, b)
    return result


@ti.func
def fused_first(scale, pair, total, arrays: ti.template()):
    """scale times the first node of a pair + total."""
    result = total
    if ti.static(arrays.features.processor.gpu):
        result = scale * nodes_of(pair, arrays)[0] + total
    else:
        a, b = scale, pair
        ti.static(call("add_first_scaled", arrays.features.precision))(result, a, b)
    return result


@ti.func
def nodes_of(pair, arrays: ti.template()):
    """The two nodes of a pair."""
    first, second = zero_node(), zero_node()
    if ti.static(arrays.features.processor.gpu):
        first = ti.Vector([pair[k] for k in ti.static(range(NODE))])
        second = ti.Vector([pair[NODE + k] for k in ti.static(range(NODE))])
    else:
        both = pair
        ti.static(call("split", arrays.features.precision))(first, second, both)
    return first, second


@ti.func
def turn(name: ti.template(), source, target, arrays: ti.template()):
    """Turn a block's vectors of `scratch` from `source` on into rows from `target` on ("to_rows"), or the reverse."""
    features = arrays.features
    size = ti.static(features.lanes * SIZES[features.precision][1])
    first, start = arrays.addresses[Address.SCRATCH], arrays.addresses[Address.SCRATCH]
    first += ti.cast(source, ti.i64) * size
    start += ti.cast(target, ti.i64) * size
    ti.static(call(name, features.precision))(first, start)


@ti.func
def read_ahead(state, block, lane, arrays: ti.template()):
    """Prefetch a lane's share of the state of a block into the cache; state: address of the first block.

    A processor continues to compute while it waits for a few lines, but not for all lines of a block at once.
    """
    features = arrays.features
    size = ti.static(features.state.size * REGISTER)
    address = state + ti.cast(block, ti.i64) * size + lane * ti.static(size // features.lanes)
    for _ in ti.static(range(-(-size // features.lanes // CACHE_LINE))):
        ti.static(call("read_ahead", features.precision))(address)
        address += CACHE_LINE
