"""Rigid baffles: fixed boxes that material runs into, over and around, with Coulomb friction on every face.

Contact is a matter of the particles, not of the nodes: what counts is a particle's own distance from a face, so nothing
happens in steps of a cell and the flow is a continuous function of where the baffle stands.

1. A particle that would come inside is held at the nearest face: it loses its velocity v_n into the face, and friction
   takes at most mu v_n of its velocity along it (Bardenhagen et al. 2000, eq. 18, for a particle in place of a node).
2. A particle within LAYER of a face that moves towards it keeps its length along the normal n: of its velocity
   gradient, n . C n = 0. The nodes inside the baffle carry no material of their own; they hurry ahead, and a gradient
   taken from them would stretch the layer at the face until it bears nothing, and the material would sink in.
3. In that layer a particle takes the velocity of the grid as it is (`mpm.transfer` with tau = 0), and the baffle the
   difference of momentum: else a layer on a baffle gains height, 20 mm in 2 s.

The momentum that leaves the material by 1 and 3 is what the baffle takes: its rate is the impact force. Material on
either side of a baffle meets on the same nodes where it is thinner than three cells.
"""

import taichi as ti

from mpm.lanes import add, lane_minimum, larger, magnitude
from mpm.layout import Offset, Setting, Worker

LAYER = 1.0
"""How far from a face [cells] a particle counts as part of the layer that lies on it."""


@ti.func
def particles_against_baffles(block, scratch, mass, worker, scene, arrays: ti.template()):
    """Keep the particles of a block, moved already, out of the baffles; `mass` [kg] of each lane."""
    features = arrays.features
    x, v = block * features.block, block * features.block + features.velocity
    layer_thickness = LAYER * arrays.settings[scene, Setting.CELL]
    for number in range(arrays.offsets[scene, Offset.BAFFLES]):
        baffle = arrays.offsets[scene, Offset.BAFFLE] + number
        offset = [arrays.state[x + k] - arrays.baffles[baffle, k] for k in ti.static(range(features.dimension))]
        away = [
            magnitude(offset[k]) - arrays.baffles[baffle, features.dimension + k]
            for k in ti.static(range(features.dimension))
        ]
        side = [ti.select(offset[k] < 0.0, -1.0, 1.0) for k in ti.static(range(features.dimension))]
        distance = larger(away[0], away[1])
        if ti.static(features.dimension == 3):
            distance = larger(distance, away[2])
        # Most blocks are far away. A vector has no truth value, its lanes have to be asked one by one.
        if lane_minimum(distance, arrays) < layer_thickness:
            inside = distance < 0.0
            start = [arrays.state[v + k] for k in ti.static(range(features.dimension))]
            if ti.static(features.relaxed):
                for k in ti.static(range(features.dimension)):
                    grid = arrays.scratch[scratch + features.lowest + features.dimension + k]
                    arrays.state[v + k] = ti.select(distance < layer_thickness, grid, start[k])
            into, slip = 0.0 * distance, 0.0 * distance
            for k in ti.static(range(features.dimension)):
                here = inside & (away[k] >= distance)
                face = arrays.baffles[baffle, k] + side[k] * arrays.baffles[baffle, features.dimension + k]
                arrays.state[x + k] = ti.select(here, face, arrays.state[x + k])
                into = ti.select(here, larger(0.0 - side[k] * arrays.state[v + k], 0.0), into)
                slip = slip + ti.select(here, 0.0, arrays.state[v + k] * arrays.state[v + k])
            grip = arrays.settings[scene, Setting.BAFFLE_FRICTION] * into
            keep = larger(1.0 - grip / larger(ti.sqrt(slip), 1.0e-20), 0.0)
            for k in ti.static(range(features.dimension)):
                here = inside & (away[k] >= distance)
                before = arrays.state[v + k]
                after = ti.select(inside, ti.select(here, before + side[k] * into, keep * before), before)
                arrays.state[v + k] = after
                at = arrays.workers[worker, Worker.IMPULSE] + number * features.dimension + k
                add(arrays.impulse, at, mass * (start[k] - after), arrays)
                # In front of this face and of no other: the next largest distance is inside the baffle's width.
                layer = (away[k] >= distance) & (distance < layer_thickness) & (side[k] * after <= 0.0)
                for other in ti.static(range(features.dimension)):
                    if ti.static(other != k):
                        layer = layer & (away[other] < 0.0)
                stretch = block * features.block + features.affine + k * (features.dimension + 1)
                arrays.state[stretch] = ti.select(layer, 0.0, arrays.state[stretch])
