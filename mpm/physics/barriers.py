"""Masses held until their release: smooth vertical barriers at their lateral faces, and damping while they settle.

A node that a barrier holds loses its velocity across the barrier (which nodes: `mpm.initial.barriers`). A mass that is
to be released when "settled" is damped meanwhile, at the nodes in its box:

    v_i = exp(-2 omega dt) v_i,   omega = pi c / (2 H)

with omega the lowest natural frequency of a layer of height H on a rigid floor (c: its pressure-wave speed), so that
this mode is critically damped. The mass has settled when two conditions hold in two frames in a row: its kinetic energy
is at most ENERGY times that of the whole mass at the speed g H / c, which gravity gives it in one passage of the wave,
and its momentum changes by at most FORCE of its weight times the frame. This is decided where frames are recorded;
scenes without held masses compile none of it.

Barriers without a gate disappear when they open. A gate rises with the speed v (1 - exp(-t / tau)): at the time t after
opening its foot is z(t) = v (t - tau (1 - exp(-t / tau))) above that of the mass, and the barriers hold the nodes above
it. A gate is smooth like the barriers and moves once per frame, to its place in the middle of the next frame.
"""

import taichi as ti

from mpm.arrays.access import add
from mpm.arrays.layout import PADDING, Barrier, Offset, Retained, Setting, Settling
from mpm.physics.transfer import particles_in

ENERGY = 1.0e-6  # kinetic energy of a settled mass over that at the speed g H / c: a thousandth of this speed
FORCE = 1.0e-3  # change of momentum of a settled mass in a frame over its weight times the frame
SETTLED_FRAMES = 2  # frames in a row in which a mass must fulfil both
NEVER = 1 << 30  # frame that no scene has


@ti.func
def apply_barriers(v, node, scene, dt, arrays: ti.template()):
    """Velocity `v` of the node with the indices `node` after all closed barriers and the damping behind them, [D]."""
    features = arrays.features
    first = arrays.offsets[scene, Offset.BARRIER]
    for line in range(first, first + arrays.offsets[scene, Offset.BARRIERS]):
        mass = arrays.barriers[line, Barrier.RETAINED]
        closed = arrays.retained[mass, Retained.OPENED] == 0
        if ti.static(features.gates):
            # Damping ends when the gate begins to rise.
            above = node[1] >= arrays.retained[mass, Retained.FOOT]
            closed = closed or (above and arrays.barriers[line, Barrier.AXIS] < ti.static(len(Barrier)))
        if closed:
            among = 1
            for k in ti.static(range(features.dimension)):
                low, high = arrays.barriers[line, Barrier.LOW_X + k], arrays.barriers[line, Barrier.HIGH_X + k]
                if node[k] < low or node[k] >= high:
                    among = 0
            if among == 1:
                axis = arrays.barriers[line, Barrier.AXIS]
                if axis == ti.static(len(Barrier)):
                    # To `float`: the precision that Taichi was started with.
                    v = ti.exp(0.0 - dt * ti.cast(arrays.settling[mass, Settling.RATE], float)) * v
                for k in ti.static(range(features.dimension)):
                    if axis == k:
                        v[k] = 0.0
    return v


@ti.func
def measure_retained(scene, block, arrays: ti.template()):
    """Add the kinetic energy and the momentum of a block to those of the retained masses."""
    features = arrays.features
    lanes = ti.static(features.lanes)
    velocity = (block * features.state.size + features.state.velocity) * lanes
    first = arrays.offsets[scene, Offset.RETAINED]
    for line in range(first, first + arrays.offsets[scene, Offset.RETAINED_COUNT]):
        if arrays.retained[line, Retained.OPENED] == 0:
            for lane in range(particles_in(scene, block, arrays)):
                particle = arrays.order[block * lanes + lane]
                if arrays.retained[line, Retained.FIRST] <= particle < arrays.retained[line, Retained.LAST]:
                    mass = arrays.settling[line, Settling.PARTICLE]
                    for k in ti.static(range(features.dimension)):
                        v = ti.cast(arrays.lanes[velocity + k * lanes + lane], ti.f64)
                        add(arrays.settling, ti.Vector([line, Settling.MOMENTUM_X + k]), mass * v, arrays)
                        add(arrays.settling, ti.Vector([line, Settling.KINETIC]), 0.5 * mass * v * v, arrays)


@ti.func
def open_barriers(scene, frame, arrays: ti.template()):
    """Open the barriers of masses whose release time is in the recorded `frame`, or that have settled."""
    first = arrays.offsets[scene, Offset.RETAINED]
    for line in range(first, first + arrays.offsets[scene, Offset.RETAINED_COUNT]):
        if arrays.retained[line, Retained.OPENED] == 0:
            change = 0.0 * arrays.settling[line, Settling.KINETIC]
            for k in ti.static(range(3)):
                now = arrays.settling[line, Settling.MOMENTUM_X + k]
                change += (now - arrays.settling[line, Settling.EARLIER_X + k]) ** 2
                arrays.settling[line, Settling.EARLIER_X + k] = now
                arrays.settling[line, Settling.MOMENTUM_X + k] = 0.0
            calm = arrays.retained[line, Retained.SETTLED_FRAMES] + 1
            moves = arrays.settling[line, Settling.KINETIC] > arrays.settling[line, Settling.MOST_KINETIC]
            if moves or ti.sqrt(change) > arrays.settling[line, Settling.MOST_IMPULSE]:
                calm = 0
            arrays.retained[line, Retained.SETTLED_FRAMES] = calm
            arrays.settling[line, Settling.KINETIC] = 0.0
            release = arrays.retained[line, Retained.RELEASE]
            if frame == release or (release == 0 and calm >= SETTLED_FRAMES):
                arrays.retained[line, Retained.OPENED] = frame
        if ti.static(arrays.features.gates):
            raise_gate(scene, line, frame, arrays)


@ti.func
def raise_gate(scene, line, frame, arrays: ti.template()):
    """Set the lowest row of nodes that the opened barriers of a retained mass hold in the frame after `frame`."""
    opened = arrays.retained[line, Retained.OPENED]
    if opened > 0:
        speed, tau = arrays.settling[line, Settling.GATE_SPEED], arrays.settling[line, Settling.GATE_TIME]
        frame_dt, cell = arrays.settings[scene, Setting.FRAME_DT], arrays.settings[scene, Setting.CELL]
        row = arrays.retained[line, Retained.TOP]
        if speed > 0.0:
            time = (frame - opened + 0.5) * frame_dt
            risen = speed * (time - tau * (1.0 - ti.exp(0.0 - time / ti.max(tau, 1.0e-9))))
            height = (arrays.settling[line, Settling.GATE_FOOT] + risen) / cell
            row = ti.min(row, ti.cast(ti.ceil(height), ti.i32) + PADDING)
        arrays.retained[line, Retained.FOOT] = row


@ti.func
def free_since(scene, arrays: ti.template()):
    """The frame since which no mass of a scene is held; NEVER while one is held."""
    latest = 0
    first = arrays.offsets[scene, Offset.RETAINED]
    for line in range(first, first + arrays.offsets[scene, Offset.RETAINED_COUNT]):
        opened = arrays.retained[line, Retained.OPENED]
        closed = opened == 0
        if ti.static(arrays.features.gates):
            closed = closed or arrays.retained[line, Retained.FOOT] < arrays.retained[line, Retained.TOP]
        if closed:
            opened = NEVER
        latest = ti.max(latest, opened)
    return latest
