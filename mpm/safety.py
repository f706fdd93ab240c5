"""The factor of safety of a slope, by reduction of its strength.

    found = safety_factor(read_scene("slope.toml"))
    found.factor, found.stands, found.moves        # 1.36, between the tried factors 1.35 and 1.37

The factor of safety F (Bishop 1955) is the number by which tan(phi) and c may be divided before the slope moves
(Zienkiewicz, Humpheson & Lewis 1975; Griffiths & Lane, Geotechnique 49, 1999). Each run starts under self-weight, in
equilibrium with the reduced strength as far as possible (`mpm.initial.stress`), and lasts TIME sqrt(H / g), with H the
height of the bodies. Local damping is off, since it acts like wall friction. The slope **moves** if a SHARE of its
particles accelerates: they travel farther in the second half of the run than in the first, and more than MOVED elastic
settlements u in all. It also moves if they travel more than SLUMPED settlements, even if they stop again:

    u = rho g H^2 / (2 M),     M the constrained (oedometer) modulus.

Ground behind and below a slope does not slide with it. Of much ground, the SHARE is therefore that of a part as high as
the slope and AROUND times as long, in 3D at most as wide as long.

A stable slope yields locally and comes to rest. Sand on a slope slightly flatter than its friction angle creeps by a
few u, more on coarser cells; up to the limit it creeps less in the second half than in the first.

**What a run changes.** One particle per cell and no jitter: four particles per cell lock in incompressible flow, which
makes a coarse slope seem too strong (Nagtegaal, Parks & Rice 1974). The stiffness, on which no limit load depends, is
set so that u = SETTLEMENT H and motion shows early. Tension cutoff and residual strength are reduced like c; the
dilation angle stays below phi; the friction of floor and solids is unchanged. Initial velocities, stages, barriers and
rate-dependent friction are left out. Water exerts only the force -grad p of the initial pore pressure
(`mpm.initial.water`): long-term, drained conditions.

The stability page gives the error against cells over the height (`python -m validation.bench stability`). The factor is
too low if the crest is shorter than 1.5 H behind the edge, since the wall of the box is smooth. It is also too low on
terrain, whose contact holds single particles less well than a floor does: a layer on inclined ground creeps, and a
warning says so. Four particles per cell would hold it, but lock (above). Without dilation the limit load of a
frictional material is not unique: it lies between those for psi = phi and for tan(phi) = sin(phi) (Davis 1968).
"""

import dataclasses
import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack, cast

import numpy as np
from scipy.ndimage import binary_dilation

from datasets.errors import InputError, require
from datasets.flow.trajectory import Trajectory
from datasets.geometry.bodies import scene_height
from datasets.geometry.ground import plan_axes
from datasets.scene import Mass, Scene
from datasets.scene.grid_field import FRICTION, THICKNESS, Field
from datasets.scene.material import Material
from datasets.scene.parts import Water
from datasets.scene.water import saturated
from mpm.laws import law_named
from mpm.laws.mohr_coulomb import flatter
from mpm.output.recording import Recording
from mpm.simulation import Options, simulate_many

TIME = 3.0  # duration of a run, over sqrt(H / g)
MOVED = 2.0  # least displacement of a slope that moves, in elastic settlements
SLUMPED = 50.0  # displacement of a slope that has moved, even if it stops again
UNHELD = 5.0  # largest displacement at half of the factor; beyond it something else than the strength fails
SHARE = 0.05  # share of the particles that must have moved so far
AROUND = 2.5  # length of the ground that counts, over the height of the slope
COLUMN = 2  # cells across a column of ground in which its surface is looked up
SETTLEMENT = 4.0e-4  # elastic settlement over the height
FRAMES = 50  # frames of a run; the time step adapts to the speed at each
FIRST = (0.5, 0.8, 1.25, 2.0)  # factors of the first batch; every later batch has as many
WIDEST = 64.0  # the search ends at this factor and at its reciprocal


@dataclass(frozen=True, kw_only=True)
class Safety:
    """A factor of safety, and the runs that it comes from."""

    factor: float  # geometric mean of `stands` and `moves`
    stands: float  # the largest factor at which it stands
    moves: float  # the smallest at which it moves
    displacements: dict[float, float]  # factor -> displacement that a SHARE of the particles exceeds [settlements]
    cells: float  # grid cells over the height of the slope, or over the thickness of the masses if they are thinner
    seconds: float


def safety_factor(scene: Scene, *, tolerance: float = 0.01, **options: Unpack[Options]) -> Safety:
    """The factor of safety of a scene, to a relative `tolerance`; each batch runs len(FIRST) factors side by side.

    options: those of `mpm.simulate_many`, except `record`. Raises InputError for a scene without gravity, or one that
    stands, or moves, whatever its strength, one with a field of thickness, and for a tolerance not above 0. Warns in
    one line if the slope moves even at twice the strength."""
    require(scene.gravity > 0.0, "gravity", "gravity above 0: nothing moves without it")
    require(tolerance > 0.0, "tolerance", "a number above 0", tolerance)
    uneven = any(field.quantity == THICKNESS for field in scene.fields)
    require(not uneven, "fields", "no field of thickness beside --safety; give the layer its own thickness")
    tall = scene_height(scene)
    begin, options["record"] = time.perf_counter(), Recording(frames=FRAMES // 2)
    displacements: dict[float, float] = {}
    moving: set[float] = set()
    factors: tuple[float, ...] = FIRST
    stands, moves = 0.0, math.inf

    def flows_of(factors: Sequence[float]) -> list[Trajectory]:
        with warnings.catch_warnings():
            # The search includes strengths too low for equilibrium: this warning is expected.
            warnings.filterwarnings("ignore", message="no initial stress")
            return simulate_many([reduced(scene, factor) for factor in factors], **options)

    while not (stands > 0.0 and moves <= stands * (1.0 + tolerance) ** 2):
        for factor, flow in zip(factors, flows_of(factors), strict=True):
            first, second, whole = settlements(flow)
            displacements[factor] = whole
            if whole > SLUMPED or (whole > MOVED and second > first):
                moving.add(factor)
        moves = min(moving, default=math.inf)
        stands = max((factor for factor in displacements if factor < moves), default=0.0)
        if stands >= WIDEST or moves <= 1.0 / WIDEST:
            said = f"stands at {stands:g} times less" if stands else f"moves at {1.0 / moves:g} times its"
            raise InputError(f"expected a scene with a factor of safety, this one {said} strength", key="masses")
        if math.isinf(moves) or not stands:
            scale = FIRST[-1] / FIRST[0] * FIRST[1] / FIRST[0]
            factors = tuple(factor * scale if stands else factor / scale for factor in factors)
        else:
            steps = np.arange(1, len(FIRST) + 1) / (len(FIRST) + 1)
            factors = tuple(stands * (moves / stands) ** step for step in steps.tolist())
    (strong,) = flows_of([0.5 * stands])
    if (moved := settlements(strong)[2]) > UNHELD:
        said = f"moves by {moved:.0f} elastic settlements even at half of this factor, which is far too low"
        ground = "model inclined ground as a mass of stronger material, which holds single particles better"
        warnings.warn(f"the slope {said}: {ground}", stacklevel=2)
    tried, cells = dict(sorted(displacements.items())), min(tall, slope_height(strong)) / scene.domain.cell
    factor, seconds = math.sqrt(stands * moves), time.perf_counter() - begin
    return Safety(factor=factor, stands=stands, moves=moves, displacements=tried, cells=cells, seconds=seconds)


def settlements(flow: Trajectory) -> tuple[float, ...]:
    """Displacements that a SHARE of the particles exceeds: first half, second half, whole run [elastic settlements]."""
    scene, (begun, middle, last) = flow.scene, flow.positions
    around = AROUND * slope_height(flow)
    width = [min(around, scene.domain.size[2])] if scene.dimension == 3 else []
    near = around**2 / AROUND * math.prod(width)
    share = SHARE * min(1.0, near / float(flow.volumes.sum()))
    return tuple(
        float(np.quantile(np.linalg.norm(end - start, axis=1), 1.0 - share)) / (SETTLEMENT * scene_height(scene))
        for start, end in ((begun, middle), (middle, last), (begun, last))
    )


def slope_height(flow: Trajectory) -> float:
    """Height of the slope [m] against gravity: from the lowest surface, or the foot of a free face, to the highest; at
    least that of a column."""
    scene, positions = flow.scene, np.asarray(flow.positions[0], np.float64)
    level, column = -positions @ np.array(scene.gravity_vector) / scene.gravity, COLUMN * scene.domain.cell
    axes = plan_axes(scene.dimension)
    counts = [math.ceil(scene.domain.size[axis] / column - 1.0e-6) for axis in axes]
    place = tuple(np.clip(positions[:, axes] // column, 0, np.array(counts) - 1).astype(np.int64).T)
    top, foot = np.full(counts, -math.inf), np.full(counts, math.inf)
    np.maximum.at(top, place, level)
    np.minimum.at(foot, place, level)
    empty = np.isinf(top)
    # Beside an empty column the ground ends at a free face; its foot, a particle lower, counts as a surface.
    lowest = np.where(binary_dilation(empty), foot - scene.particle_spacing, top)[~empty].min()
    return max(float(top.max() - lowest), column)


def reduced(scene: Scene, factor: float) -> Scene:
    """The scene of a run: its strength over `factor`, under its own weight from the start."""
    tall, bodies = scene_height(scene), [scene.material_of(mass) for mass in scene.masses]
    settlement = max(scene.gravity * tall / (2.0 * material.wave_speed**2) for material in bodies)
    frame_dt = TIME * math.sqrt(tall / scene.gravity) / FRAMES

    def weaker(material: Material) -> Material:
        stiff = dataclasses.replace(material, young=material.modulus * settlement / SETTLEMENT)
        return cast(Material, law_named(material.law).weakened(stiff, factor))

    def flat(field: Field, number: int) -> Field:
        material = bodies[number]
        phi = (material.phi_deg_of(angle, material.dilation_deg) for angle in field.values)
        return dataclasses.replace(field, mass=number, values=tuple(flatter(angle, factor) for angle in phi))

    # One field for each mass: a field of all masses means another phi in each material.
    varying = [field for field in scene.fields if field.quantity == FRICTION]
    fields = [flat(field, k) for field in varying for k in range(len(bodies)) if field.mass in (None, k)]

    def standing(number: int, mass: Mass) -> Mass:
        material = None if mass.material is None else weaker(mass.material)
        if least := [min(field.values) for field in fields if field.mass == number]:
            material = weaker(bodies[number])
            psi = min(max(material.dilation_deg, -min(least)), *least)
            material = dataclasses.replace(material, dilation_deg=psi)
        k0 = "elastic" if mass.k0 is None else mass.k0
        still: dict[str, Any] = dict.fromkeys(("velocity", "angular_velocity", "release", "gate"))
        return dataclasses.replace(mass, material=material, k0=k0, **still)

    return dataclasses.replace(
        scene,
        material=weaker(scene.material),
        masses=tuple(standing(number, mass) for number, mass in enumerate(scene.masses)),
        fields=tuple(fields),
        stages=(),
        water=None if saturated(scene) is None else dataclasses.replace(scene.water or Water(), fixed=True),
        particles_per_axis=1,
        jitter=0.0,
        damping=0.0,
        frame_dt=frame_dt,
        duration=frame_dt * FRAMES,
    )
