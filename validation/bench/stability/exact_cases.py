"""Rows whose outcome is an exact solution."""

import math
from functools import partial

from validation.bench.stability import exact
from validation.bench.stability import expectations as expect
from validation.bench.stability.case import Case

NO_TENSION = (
    "At an explicit cutoff of 0 it crumbles, undamped: it loses 1.4 cells of height and a fifth of it moves by a cell "
    "or more. Soil that carries no tension at all has nothing that holds a free face: the lateral stress of a column "
    "is 0, which is its limit, and gravity that comes at once makes it ring. Lateral tension of jittered particles "
    "opens cracks; the next compression is resisted although they are open, and so it spreads. The default cutoff, "
    "0.003 of the cohesion, keeps the faces whole, and so do 100 Pa, a ten-thousandth of it."
)

EXACT_CASES = (
    Case(
        name="block-24",
        what="a block on an incline of 24°, mu = 0.5",
        checks=(partial(expect.creeps, since=0.0, cells=0.05),),
    ),
    Case(
        name="block-29",
        what="a block on an incline of 29°, mu = 0.5",
        checks=(exact.slides,),
        remark="The formula is that of a rigid block, so this one is stiff, 20 MPa, without Poisson's ratio: with "
        "0.3 and 2 MPa it slides 17 % further. An elastic body that slides at a constant coefficient and that nothing "
        "damps is unstable (Adams 1995); while parts of its base stick, the whole feels 0.47 instead of 0.5.",
    ),
    Case(name="block-35", what="a block on an incline of 35°, mu = 0.5", checks=(exact.slides,)),
    Case(
        name="bed-k0",
        what="a bed in geostatic stress",
        checks=(exact.stays_at_rest, exact.weighs_what_lies_above),
    ),
    Case(
        name="layer-mode",
        what="a layer in geostatic stress rings",
        checks=(
            partial(exact.layer_decrement, most=2.0 * math.pi * exact.DAMPING_OF_SAND),
            partial(exact.layer_viscosity, most=2.0 * math.pi * exact.DAMPING_OF_SAND),
        ),
    ),
    Case(name="thin-body", what="a layer of 1 mm in cells of 20 mm", checks=(exact.moves_on,)),
    Case(
        name="cut-critical-holds",
        spalls=True,
        what="a cut with hardly any tension at 0.9 of its critical height",
        checks=(
            partial(expect.over_critical_height, ratio=0.9),
            expect.stands_but_for_spall,
        ),
        remark="A slice of a cell, which has hardly any tension to hold it, may fall off its face, or a part of it, or "
        "none: rounding or the jitter decides. So fronts in f32 and in f64 are not compared.",
    ),
    Case(
        name="cut-critical-fails",
        what="the same at 1.1",
        checks=(partial(expect.over_critical_height, ratio=1.1), expect.falls),
    ),
    Case(
        name="undrained-cut-holds",
        what="a cut in clay, phi = 0, at 0.8 of its critical height",
        checks=(
            partial(expect.over_critical_height, ratio=0.8),
            expect.stands_but_for_spall,
        ),
    ),
    Case(
        name="undrained-cut-fails",
        what="the same at 1.2",
        checks=(partial(expect.over_critical_height, ratio=1.2), expect.falls),
    ),
    Case(
        name="spin",
        what="an elastic square turns three times in free space",
        checks=(exact.spins_on, exact.keeps_angular_momentum),
    ),
    Case(
        name="bar-mode",
        what="a free elastic bar rings, particles on a lattice",
        rings=True,
        checks=(partial(exact.bar_decrement, most=1.0e-3),),
    ),
    Case(
        name="bar-mode-jitter",
        what="the same, particles jittered",
        rings=True,
        checks=(partial(exact.bar_decrement, most=2.0 * math.pi * exact.DAMPING_OF_SAND),),
        remark="Jittered particles at free surfaces damp it, in proportion to the cell over the bar's thickness and at "
        "any step. Asked for is less damping than sand has: a damping ratio of 0.5 %, a decrement of 2 pi times that.",
    ),
    Case(name="far-slow", what="10 mm/s in free space, 2 km away", checks=(exact.moves_on,)),
    Case(name="far-stiff", what="1 mm/s in free space, 100 MPa, 100 m away", checks=(exact.moves_on,)),
    Case(
        name="cohesive-column",
        what="a column of soil of 1 MPa",
        remark=NO_TENSION,
        checks=(exact.stands,),
    ),
    Case(
        name="thrown-rest",
        what="sand thrown up: when does it rest?",
        until_rest=True,
        checks=(exact.rests_after_landing,),
    ),
    Case(
        name="bed-ringing", what="a bed that swings: when does it rest?", until_rest=True, checks=(exact.rests_settled,)
    ),
    Case(name="stiff-2e7", what="a column of 20 MPa", rests=True, checks=(expect.spreads,)),
    Case(
        name="stiff",
        what="a column of 2 GPa",
        rests=True,
        checks=(expect.spreads,),
        beside="stiff-2e7",
        comparisons=(partial(expect.as_far_as, within=0.03),),
    ),
)
