"""The rows of the table: each a scene file and what has to hold in it."""

from functools import partial

from validation.bench.stability import deposit
from validation.bench.stability import expectations as expect
from validation.bench.stability.case import Case
from validation.bench.stability.exact_cases import EXACT_CASES

CASES = (
    Case(name="friction-12", what="a square of sand of 12° lets go", rests=True, checks=(expect.spreads,)),
    Case(name="friction-48", what="a square of sand of 48° lets go", rests=True, checks=(expect.spreads,)),
    Case(
        name="separation",
        what="cohesionless sand, its upper half thrown up",
        checks=(expect.parts_freely, expect.never_pulls),
    ),
    Case(name="impact-wall", what="10 m/s into the wall", rests=True, sprays=True, checks=(expect.wall_stops,)),
    Case(
        name="impact-baffle",
        what="10 m/s into a baffle",
        rests=True,
        sprays=True,
        checks=(partial(expect.baffle_takes, least=0.5),),
    ),
    Case(
        name="tall-column", what="a column eight times as high as wide", rests=True, checks=(expect.reach_of_collapse,)
    ),
    Case(
        name="thin-layer",
        what="three points thick, over the corner of a baffle",
        checks=(expect.keeps_speed, expect.passes_baffle),
    ),
    Case(name="dropped-column", what="a column falls 0.3 m", rests=True, sprays=True, checks=(expect.falls_freely,)),
    Case(
        name="dropped-bed",
        what="a bed between walls falls 0.3 m",
        rests=True,
        checks=(expect.falls_freely, expect.stands_as_before),
    ),
    Case(
        name="rest",
        what="a deposit rests for 10 s",
        rests=True,
        checks=(partial(expect.creeps, since=2.0, cells=0.1),),
    ),
    Case(
        name="cut-holds",
        what="a cohesive cut at 0.6 of its critical height",
        checks=(partial(expect.over_critical_height, ratio=0.6), partial(expect.creeps, since=1.0, cells=0.05)),
    ),
    Case(
        name="cut-fails",
        what="the same at 1.6",
        checks=(partial(expect.over_critical_height, ratio=1.6), partial(expect.runs_out, cells=2.0)),
    ),
    Case(
        name="column",
        what="a column: f32 against f64, point by point",
        rests=True,
        checks=(expect.spreads,),
        precisions=(expect.every_point_agrees,),
    ),
    Case(
        name="long-step",
        what="the column at 0.9 of the stability limit",
        rests=True,
        checks=(expect.step_used,),
        beside="column",
        comparisons=(partial(expect.as_far_as, within=0.05),),
    ),
    Case(
        name="filled-domain",
        what="sand fills the box",
        checks=(expect.settles_at_most_twice,),
        remark="It stays at the bottom of its first swing: the grid makes contact within a cell, so the ceiling holds "
        "back what has sunk from it by a twentieth of one.",
    ),
    Case(name="one-point", what="one material point falls", checks=(expect.falls_freely, expect.lands)),
    Case(name="layers-settle", what="stiff on soft (100 to 1) settles between walls", checks=(expect.settles,)),
    Case(name="layers-collapse", what="a column, stiff on soft (100 to 1)", rests=True, checks=(expect.spreads,)),
    Case(
        name="column-3d",
        what="a quarter of a square column",
        rests=True,
        checks=(expect.is_symmetric,),
    ),
    Case(
        name="impact-baffle-3d",
        what="10 m/s into a narrow baffle",
        checks=(partial(expect.baffle_takes, least=0.3),),
    ),
    Case(
        name="slope-holds-3d",
        what="a slope of 26.6° in sand of 30°",
        checks=(partial(expect.creeps, since=0.5, cells=0.05), deposit.volume),
    ),
    Case(
        name="slope-fails-3d",
        what="a slope of 45° in sand of 30°",
        rests=True,
        checks=(partial(expect.runs_out, cells=2.0),),
    ),
    Case(
        name="ball-3d",
        what="a ball of sand set down on the floor",
        rests=True,
        checks=(expect.is_round, expect.stays_in_place),
    ),
    *EXACT_CASES,
)
