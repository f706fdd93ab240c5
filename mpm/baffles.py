"""Rigid baffles: fixed boxes that material runs into, over and around, with Coulomb friction on every face.

Contact is a matter of the points, not of the nodes: what counts is a point's own distance from a face, so nothing
happens in steps of a cell and the flow is a continuous function of where the baffle stands.

1. A point that would come inside is held at the nearest face: it loses its velocity v_n into the face, and friction
   takes at most mu v_n of its velocity along it (Bardenhagen et al. 2000, eq. 18, for a point in place of a node).
2. A point within REACH of a face that moves towards it keeps its length along the normal n: of its velocity gradient,
   n . C n = 0. The nodes inside the baffle carry no material of their own; they hurry ahead, and a gradient taken from
   them would stretch the layer at the face until it bears nothing, and the material would sink in.

The momentum that leaves the material by 1 is what the baffle takes: its rate is the impact force. Material on either
side of a baffle meets on the same nodes where it is thinner than three cells.
"""

import taichi as ti

from mpm.lanes import add, larger, least, magnitude
from mpm.layout import Place, Setting, Worker

REACH = 1.0
"""How far from a face [cells] a point counts as part of the layer that lies on it."""


@ti.func
def points_against_baffles(block, mass, worker, scene, of: ti.template()):
    """Keep the points of a block, moved already, out of the baffles; `mass` [kg] of each lane."""
    needs = of.needs
    x, v = block * needs.block, block * needs.block + needs.velocity
    reach = REACH * of.settings[scene, Setting.CELL]
    for number in range(of.places[scene, Place.BAFFLES]):
        baffle = of.places[scene, Place.BAFFLE] + number
        offset = [of.state[x + k] - of.baffles[baffle, k] for k in ti.static(range(needs.dimension))]
        away = [
            magnitude(offset[k]) - of.baffles[baffle, needs.dimension + k] for k in ti.static(range(needs.dimension))
        ]
        side = [ti.select(offset[k] < 0.0, -1.0, 1.0) for k in ti.static(range(needs.dimension))]
        distance = larger(away[0], away[1])
        if ti.static(needs.dimension == 3):
            distance = larger(distance, away[2])
        # Most blocks are far away. A vector has no truth value, its lanes have to be asked one by one.
        if least(distance, of) < reach:
            inside = distance < 0.0
            into, slip = 0.0 * distance, 0.0 * distance
            for k in ti.static(range(needs.dimension)):
                here = inside & (away[k] >= distance)
                face = of.baffles[baffle, k] + side[k] * of.baffles[baffle, needs.dimension + k]
                of.state[x + k] = ti.select(here, face, of.state[x + k])
                into = ti.select(here, larger(0.0 - side[k] * of.state[v + k], 0.0), into)
                slip = slip + ti.select(here, 0.0, of.state[v + k] * of.state[v + k])
            grip = of.settings[scene, Setting.BAFFLE_FRICTION] * into
            keep = larger(1.0 - grip / larger(ti.sqrt(slip), 1.0e-20), 0.0)
            for k in ti.static(range(needs.dimension)):
                here = inside & (away[k] >= distance)
                before = of.state[v + k]
                after = ti.select(inside, ti.select(here, before + side[k] * into, keep * before), before)
                of.state[v + k] = after
                at = of.workers[worker, Worker.IMPULSE] + number * needs.dimension + k
                add(of.impulse, at, mass * (before - after), of)
                # In front of this face and of no other: the next largest distance is inside the baffle's width.
                layer = (away[k] >= distance) & (distance < reach) & (side[k] * after <= 0.0)
                for other in ti.static(range(needs.dimension)):
                    if ti.static(other != k):
                        layer = layer & (away[other] < 0.0)
                stretch = block * needs.block + needs.affine + k * (needs.dimension + 1)
                of.state[stretch] = ti.select(layer, 0.0, of.state[stretch])
