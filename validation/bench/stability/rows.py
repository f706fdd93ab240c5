"""The rows of the table: each a scene file and what has to hold in it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from datasets.library import read_scene
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from validation.bench.stability import deposit
from validation.bench.stability import expectations as expect
from validation.bench.stability.finding import Finding

SCENES = Path(__file__).parent / "hard_cases"

Check = Callable[[Trajectory], Finding | None]
Comparison = Callable[[Trajectory, Trajectory], Finding]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row; what every flow keeps is checked without being named here."""

    name: str
    """Of the scene file."""
    what: str
    """What happens."""
    rests: bool = False
    """It ends as a deposit of cohesionless sand at rest: checked for that, for its slope and for its volume."""
    rings: bool = False
    """An elastic wave in free space: its decrement is checked in place of its energy, because velocity and stress are
    recorded half a step apart, so that the sum of their energies swings by omega dt."""
    spalls: bool = False
    """A slice of a cell may fall off its face, as rounding decides: fronts in f32 and f64 are not compared."""
    sprays: bool = False
    """Particles fly apart and land: rounding grows as large as another jitter, and fronts agree as those of two do."""
    until_rest: bool = False
    """Run until the solver says that it rests, which is then checked."""
    checks: tuple[Check, ...] = ()
    """Its own."""
    precisions: tuple[Comparison, ...] = ()
    """Of the flow in f32 with that in f64, besides their fronts."""
    beside: str = ""
    """Another row ..."""
    comparisons: tuple[Comparison, ...] = ()
    """... and what is checked of the two together."""
    remark: str = ""
    """What the numbers do not say by themselves."""
    cause: str = ""
    """Why the row is red, where it is."""

    @property
    def scene(self) -> Scene:
        """The scene, read from its file."""
        return read_scene(str(SCENES / f"{self.name}.toml"))


HARD = (
    Row(name="friction-12", what="a square of sand of 12° lets go", rests=True, checks=(expect.spreads,)),
    Row(name="friction-48", what="a square of sand of 48° lets go", rests=True, checks=(expect.spreads,)),
    Row(
        name="separation",
        what="cohesionless sand, its upper half thrown up",
        checks=(expect.parts_freely, expect.never_pulls),
    ),
    Row(name="impact-wall", what="10 m/s into the wall", rests=True, sprays=True, checks=(expect.wall_stops,)),
    Row(
        name="impact-baffle",
        what="10 m/s into a baffle",
        rests=True,
        sprays=True,
        checks=(partial(expect.baffle_stops, minimum=0.5),),
    ),
    Row(
        name="tall-column", what="a column eight times as high as wide", rests=True, checks=(expect.runout_of_collapse,)
    ),
    Row(
        name="thin-layer",
        what="three particles thick, over the corner of a baffle",
        checks=(expect.keeps_speed, expect.passes_baffle),
    ),
    Row(name="dropped-column", what="a column falls 0.3 m", rests=True, sprays=True, checks=(expect.falls_freely,)),
    Row(
        name="dropped-bed",
        what="a bed between walls falls 0.3 m",
        rests=True,
        checks=(expect.falls_freely, expect.stands_as_before),
    ),
    Row(
        name="rest",
        what="a deposit rests for 10 s",
        rests=True,
        checks=(partial(expect.creeps, since=2.0, cells=0.1),),
    ),
    Row(
        name="cut-holds",
        what="a cohesive cut at 0.6 of its critical height",
        checks=(partial(expect.over_critical_height, ratio=0.6), partial(expect.creeps, since=1.0, cells=0.05)),
    ),
    Row(
        name="cut-fails",
        what="the same at 1.6",
        checks=(partial(expect.over_critical_height, ratio=1.6), expect.runs_out),
    ),
    Row(
        name="column",
        what="a column: f32 against f64, particle by particle",
        rests=True,
        checks=(expect.spreads,),
        precisions=(expect.every_particle_agrees,),
    ),
    Row(
        name="long-step",
        what="the column at 0.9 of the stability limit",
        rests=True,
        checks=(expect.step_used,),
        beside="column",
        comparisons=(partial(expect.as_far_as, within=0.05),),
    ),
    Row(
        name="filled-domain",
        what="sand fills the box",
        checks=(expect.settles_at_most_twice,),
        remark="It stays at the bottom of its first swing: the grid makes contact within a cell, so the ceiling holds "
        "back what has sunk from it by a twentieth of one.",
    ),
    Row(name="one-point", what="one material point falls", checks=(expect.falls_freely, expect.lands)),
    Row(name="layers-settle", what="stiff on soft (100 to 1) settles between walls", checks=(expect.settles,)),
    Row(name="layers-collapse", what="a column, stiff on soft (100 to 1)", rests=True, checks=(expect.spreads,)),
    Row(name="column-3d", what="a quarter of a square column", rests=True, checks=(expect.is_symmetric,)),
    Row(
        name="impact-baffle-3d",
        what="10 m/s into a narrow baffle",
        checks=(partial(expect.baffle_stops, minimum=0.3),),
    ),
    Row(
        name="slope-holds-3d",
        what="a slope of 26.6° in sand of 30°",
        checks=(partial(expect.creeps, since=0.5, cells=0.05), deposit.volume),
    ),
    Row(name="slope-fails-3d", what="a slope of 45° in sand of 30°", rests=True, checks=(expect.runs_out,)),
    Row(
        name="ball-3d",
        what="a ball of sand set down on the floor",
        rests=True,
        checks=(expect.is_round, expect.stays_centred),
    ),
)

EXACT = (
    Row(
        name="block-24",
        what="a block on an incline of 24°, mu = 0.5",
        checks=(partial(expect.creeps, since=0.0, cells=0.05),),
    ),
    Row(
        name="block-29",
        what="a block on an incline of 29°, mu = 0.5",
        checks=(expect.slides,),
        remark="The formula is that of a rigid block, so this one is stiff, 20 MPa, without Poisson's ratio: with "
        "0.3 and 2 MPa it slides 17 % further. An elastic body that slides at a constant coefficient and that nothing "
        "damps is unstable (Adams 1995); while parts of its base stick, the whole feels 0.47 instead of 0.5.",
    ),
    Row(name="block-35", what="a block on an incline of 35°, mu = 0.5", checks=(expect.slides,)),
    Row(name="bed-k0", what="a bed in geostatic stress", checks=(expect.stays_at_rest, expect.weighs_what_lies_above)),
    Row(
        name="layer-mode",
        what="a layer in geostatic stress rings",
        checks=(expect.layer_decrement, expect.layer_viscosity),
    ),
    Row(name="thin-body", what="a layer of 1 mm in cells of 20 mm", checks=(expect.moves_on,)),
    Row(
        name="cut-critical-holds",
        spalls=True,
        what="a cut with hardly any tension at 0.9 of its critical height",
        checks=(partial(expect.over_critical_height, ratio=0.9), expect.stands_but_for_spall),
        remark="A slice of a cell, which has hardly any tension to hold it, may fall off its face, or a part of it, or "
        "none: rounding or the jitter decides. So fronts in f32 and in f64 are not compared.",
    ),
    Row(
        name="cut-critical-fails",
        what="the same at 1.1",
        checks=(partial(expect.over_critical_height, ratio=1.1), expect.falls),
    ),
    Row(
        name="undrained-cut-holds",
        what="a cut in clay, phi = 0, at 0.8 of its critical height",
        checks=(partial(expect.over_critical_height, ratio=0.8), expect.stands_but_for_spall),
    ),
    Row(
        name="undrained-cut-fails",
        what="the same at 1.2",
        checks=(partial(expect.over_critical_height, ratio=1.2), expect.falls),
    ),
    Row(
        name="spin",
        what="an elastic square turns three times in free space",
        checks=(expect.spins_on, expect.keeps_angular_momentum),
    ),
    Row(
        name="bar-mode",
        what="a free elastic bar rings, particles on a lattice",
        rings=True,
        checks=(partial(expect.bar_decrement, maximum=1.0e-3),),
    ),
    Row(
        name="bar-mode-jitter",
        what="the same, particles jittered",
        rings=True,
        checks=(expect.bar_decrement,),
        remark="Jittered particles at free surfaces damp it, in proportion to the cell over the bar's thickness and at "
        "any step. Required is less damping than sand has: a damping ratio of "
        f"{100.0 * expect.DAMPING_OF_SAND:g} %, a decrement of {2.0 * math.pi * expect.DAMPING_OF_SAND:.3f}.",
    ),
    Row(name="far-slow", what="10 mm/s in free space, 2 km away", checks=(expect.moves_on,)),
    Row(name="far-stiff", what="1 mm/s in free space, 100 MPa, 100 m away", checks=(expect.moves_on,)),
    Row(
        name="cohesive-column",
        what="a column of soil of 1 MPa",
        checks=(expect.stands,),
        remark="At an explicit cutoff of 0 it crumbles, undamped. Soil that carries no tension at all has nothing that "
        "holds a free face: the lateral stress of a column is 0, which is its limit, and gravity that comes at once "
        "makes it ring. Lateral tension of jittered particles opens cracks; the next compression is resisted although "
        "they are open, and so it spreads. The default cutoff keeps the faces whole.",
    ),
    Row(
        name="thrown-rest",
        what="sand thrown up: when does it rest?",
        until_rest=True,
        checks=(expect.rests_after_landing,),
    ),
    Row(
        name="bed-ringing",
        what="a bed that swings: when does it rest?",
        until_rest=True,
        checks=(expect.rests_settled,),
    ),
    Row(name="stiff-2e7", what="a column of 20 MPa", rests=True, checks=(expect.spreads,)),
    Row(
        name="stiff",
        what="a column of 2 GPa",
        rests=True,
        checks=(expect.spreads,),
        beside="stiff-2e7",
        comparisons=(partial(expect.as_far_as, within=0.03),),
    ),
)
"""Rows whose outcome is an exact solution."""

ROWS = (*HARD, *EXACT)
