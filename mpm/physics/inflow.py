"""Inflow: particles wait at their section until their entry time; nodes on and behind the section are held.

All particles of an inflow exist from the start (`datasets.geometry.inflow`), each at the place where it enters, without
mass, stress and velocity. In the step that contains its entry time, a particle joins the flow, as far from the section
as its velocity takes it by the end of the step. A vector of its block counts the frames that it has to wait: by whole
frames, which causes no rounding, and by steps in the frame in which it enters.

From the first to the last time of the hydrograph the nodes on and behind the section have the velocity v(t) of the
inflow, averaged over each frame. Material that has entered leaves the section at that speed, so that the next finds an
empty place: it is neither compressed nor torn apart, and nothing flows back. It enters free of stress. Its weight
compresses it by rho g h^2 / (2 M) within the time h / c of an elastic wave, in which it moves by a small part of its
depth h. An initial earth pressure would push a front out of the section before gravity has moved anything.
"""

import taichi as ti

from mpm.arrays.access import minimum, over_lanes
from mpm.arrays.layout import PADDING, Contact, Inflow, Offset, Setting
from mpm.physics.contact import contact_at

BEHIND, BESIDE, BELOW, SLACK = 3.0, 1.5, 2.0, 0.01
"""Extent [cells] of the nodes held behind, beside and below the foot of a section, at any height above; SLACK in front
of it for rounding. A quadratic B-spline reaches one and a half cells along each axis."""
EARLY = 1.0e-5  # frames by which a particle may enter early, so that rounding leaves none outside at the end
NEVER = -1.0  # speed of an inflow that has not begun, or has ended


@ti.func
def waits(block, arrays: ti.template()):
    """Whether no particle of a block has entered or enters in this frame."""
    entry = arrays.state[block * arrays.features.state.size + arrays.features.state.entry]
    return over_lanes(minimum, entry, arrays.features.lanes) > 1.0


@ti.func
def wait_frame(block, arrays: ti.template()):
    """Count one frame down for the particles of a block that enter in a later frame."""
    at = block * arrays.features.state.size + arrays.features.state.entry
    arrays.state[at] = ti.select(arrays.state[at] > 1.0, arrays.state[at] - 1.0, arrays.state[at])


@ti.func
def let_in(block, scene, dt, arrays: ti.template()):
    """Let the particles of a block whose entry time is in this step join the flow, with only their velocity."""
    features = arrays.features
    x = block * features.state.size
    entry, present, velocity = x + features.state.entry, x + features.state.present, x + features.state.velocity
    step, before = dt / arrays.settings[scene, Setting.FRAME_DT], arrays.state[entry]
    left = ti.select((before > 0.0) & (before <= 1.0), before - step, before)
    enters, late = (before > 0.0) & (left < EARLY), left * arrays.settings[scene, Setting.FRAME_DT]
    arrays.state[entry] = ti.select(enters, 0.0, left)
    arrays.state[present] = ti.select(enters, 1.0, arrays.state[present])
    for k in ti.static(range(features.state.contacts - features.state.velocity)):
        if ti.static(k < features.dimension):
            speed = arrays.state[entry + 1 + k]
            arrays.state[x + k] = ti.select(enters, arrays.state[x + k] - late * speed, arrays.state[x + k])
            arrays.state[velocity + k] = ti.select(enters, speed, arrays.state[velocity + k])
        else:
            arrays.state[velocity + k] = ti.select(enters, 0.0, arrays.state[velocity + k])
    if ti.static(features.contact):
        for k in ti.static(range(features.dimension)):
            shear = contact_at(block, Contact.NORMAL + features.dimension + k, arrays)
            arrays.state[shear] = ti.select(enters, 0.0, arrays.state[shear])


@ti.func
def held_behind(v, node, scene, arrays: ti.template()):
    """Velocity `v` of the node with the indices `node`, or that of the inflow that holds it, [D]."""
    first = arrays.offsets[scene, Offset.INFLOW]
    for line in range(first, first + arrays.offsets[scene, Offset.INFLOWS]):
        speed = arrays.inflows[line, Inflow.SPEED]
        if speed > NEVER:
            ahead, aside, above = 0.0 * speed, 0.0 * speed, 0.0 * speed
            for k in ti.static(range(arrays.features.dimension)):
                apart = node[k] - PADDING - arrays.inflows[line, Inflow.FOOT_X + k]
                ahead += apart * arrays.inflows[line, Inflow.FLOW_X + k]
                aside += apart * arrays.inflows[line, Inflow.ALONG_X + k]
                above += apart * arrays.inflows[line, Inflow.UP_X + k]
            beside = ti.abs(aside) <= arrays.inflows[line, Inflow.HALF_WIDTH] + BESIDE
            if ahead >= -BEHIND and ahead <= SLACK and beside and above >= -BELOW:
                for k in ti.static(range(arrays.features.dimension)):
                    v[k] = speed * arrays.inflows[line, Inflow.FLOW_X + k]
    return v


@ti.func
def next_speeds(scene, frame, arrays: ti.template()):
    """Set the speeds of the inflows of a scene to those of the frame after `frame`."""
    first = arrays.offsets[scene, Offset.INFLOW]
    for line in range(first, first + arrays.offsets[scene, Offset.INFLOWS]):
        arrays.inflows[line, Inflow.SPEED] = arrays.inflows[line, ti.static(len(Inflow)) + frame]
