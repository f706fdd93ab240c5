"""The result of a scene of a batch: its trajectory with a summary, or the reason why there is none."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import WorkFailed
from datasets.flow.measures import extents
from datasets.flow.trajectory import Trajectory, solid_names
from datasets.geometry.bodies import scene_height
from datasets.scene import DOMAIN_SIDES, Scene
from datasets.scene.particles import Particles, unresolved
from datasets.scene.water import drainage
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Energy, Offset, Retained
from mpm.initial.barriers import retained_masses
from mpm.initial.stages import selected
from mpm.output.recorder import RUNAWAY
from mpm.output.smoothing import smoothed
from mpm.runtime import Arch

Floats = NDArray[np.floating]

MOVING = "not at rest"  # first words of the remark on a flow that still moves at its end
AT_REST = 1e-3  # largest kinetic energy of a deposit at rest, over its maximum in time
SLOW = 2e-3  # rms speed over sqrt(g H) below which nothing moves, H the initial height of the body
SHARE = 0.005  # share of the particles beyond the front
NEAR = 2.0  # cells from a wall: sand against it lies a part of a cell off, and its tongue is a layer of particles
FEWEST_CELLS = 3.0  # cells across a body or a layer


def failure(batch: Batch, index: int) -> WorkFailed | None:
    """Why scene `index` of a batch blew up, in one line; None if it did not.

    A particle faster than RUNAWAY times the wave speed ends a scene. If gravity and the initial velocities can make it
    that fast, v^2 <= v_0^2 + 2 sum_k |g_k| L_k in a box of lengths L, the flow itself is too fast for so soft a
    material; if they cannot, or if the speed is not a number, the integration was unstable."""
    scene, features, particles = batch.scenes[index], batch.features, batch.particles[index]
    frames = int(batch.offsets[index, Offset.FRAMES])
    motion = batch.numbers(index, 0, features.state.velocity + features.dimension)
    if frames == scene.frames and np.isfinite(motion).all():
        return None
    when, speed = f"t = {scene.frame_dt * (frames - 1):g} s", fastest(motion[features.state.velocity :].T)
    fall = 2.0 * sum(abs(g) * length for g, length in zip(scene.gravity_vector, scene.domain.size, strict=True))
    possible = math.sqrt(fastest(particles.velocities) ** 2 + fall)
    # Some slack: a pile-up transfers energy to the few particles that it throws.
    if not math.isfinite(speed) or speed > 2.0 * possible:
        return WorkFailed(f"the simulation blew up at {when}; try a step_fraction below {scene.step_fraction:g}")
    stiffest = max(particles.materials, key=lambda material: material.wave_speed)
    young = stiffest.modulus * (max(speed, possible) / (RUNAWAY * stiffest.wave_speed)) ** 2
    # The next larger number of two digits.
    unit = 10.0 ** (math.floor(math.log10(young)) - 1)
    young = math.ceil(1.001 * young / unit) * unit
    return WorkFailed(
        f"a particle moves at {speed:.3g} m/s at {when}, more than {RUNAWAY:g} times the wave speed of "
        f"{stiffest.wave_speed:.3g} m/s: a shorter step does not help; "
        f"a young of at least {young:.2g} Pa or a lower velocity does"
    )


def fastest(velocities: Floats) -> float:
    """The largest speed [m/s] of velocities [N, D]; nan if one is nan."""
    return float(np.linalg.norm(velocities.astype(np.float64), axis=1).max())


def outflow(batch: Batch, index: int) -> dict[str, float]:
    """Mass that has left through each open side [kg, in 2D per metre of width]."""
    scene, features, particles = batch.scenes[index], batch.features, batch.particles[index]
    order, (present,) = batch.order_of(index), batch.numbers(index, features.state.present, 1)
    mass = (particles.density * particles.volume)[order]
    removed = present == 0.0
    # A particle left through the side that it lies farthest beyond.
    beyond = np.full((len(DOMAIN_SIDES), len(order)), -np.inf)
    for side in scene.open_sides:
        axis, upper = "xyz".index(side[0]), side[1] == "+"
        (coordinate,) = batch.numbers(index, axis, 1)
        beyond[DOMAIN_SIDES.index(side)] = coordinate - scene.domain.size[axis] if upper else -coordinate
    through = beyond.argmax(axis=0)
    return {side: float(mass[removed & (through == DOMAIN_SIDES.index(side))].sum()) for side in scene.open_sides}


def fields_of(batch: Batch, index: int) -> dict[str, Any]:
    """The requested fields of scene `index`, by the names of `datasets.flow.trajectory.Trajectory`."""
    fields: dict[str, Any] = {name: values for name, values in batch.record[index].items() if name != "positions"}
    if "pore_pressure" in fields:
        # A negative value measures the opening that must close before water presses again.
        fields["pore_pressure"] = np.maximum(fields["pore_pressure"], 0.0)
    if "stress" in fields:
        volume, scene = batch.particles[index].volume, batch.scenes[index]
        fields["stress"] = smoothed(fields["stress"], batch.recorded(index), volume, scene)
        fields["pressure"] = -fields["stress"][:, :, :3].sum(axis=2) / 3.0
    return fields


def trajectory(batch: Batch, index: int, *, arch: Arch, wall_s: float, compile_s: float) -> Trajectory | WorkFailed:
    """The trajectory of scene `index`; the frames after it came to rest repeat the last computed one.

    Its summary holds lengths in metres; `step_limit`, which sets the time step: "waves" of `wave_speed` [m/s] or, in
    some frames, the speed of the "flow"; `energy` [J, in 2D per metre of width], a series over all frames of the scene;
    `rest_time` [s], when the deposit came to rest, if the run may end there, and `end_time` [s], up to which it was
    computed; with barriers `release_time` [s], when each mass was released, None if it is still held; `stage_time` [s],
    when each stage began, None if it did not; if asked for, the momentum that the sides of the box and the barriers
    have taken up to each frame [N s], `side_impulse` of each and their sum `wall_impulse`; `outflow` [kg] through each
    open side; `drainage`, in words, if water fills pores; `wall_s` of all scenes that ran together, without
    compilation."""
    if (failed := failure(batch, index)) is not None:
        return failed
    scene, particles, offset = batch.scenes[index], batch.particles[index], batch.offsets[index]
    energies, impulses, kept = batch.energies(index), batch.impulses(index), batch.kept(index)
    rest, solids = int(offset[Offset.REST]), len(solid_names(scene))
    if rest:
        for series in (energies, impulses):
            series[rest + 1 :] = series[rest]
        for slot, frame in enumerate(kept):
            if frame > rest:
                batch.store(index, slot)
    positions, fields = batch.recorded(index), fields_of(batch, index)
    if len(batch.scenes) > 1:
        # One trajectory must not keep the records of all others in memory.
        positions, fields = positions.copy(), {name: values.copy() for name, values in fields.items()}
    began = rest - int(offset[Offset.WINDOW]) + 1
    deposit, kinds = positions[-1], (Energy.KINETIC, Energy.POTENTIAL, Energy.ELASTIC)
    summary: dict[str, Any] = {
        **extents(scene, deposit, particles.volume),
        "steps": (steps := int(offset[Offset.STEPS])),
        "step_limit": "flow" if steps > int(offset[Offset.SUBSTEPS]) * (rest or scene.frames - 1) else "waves",
        "wave_speed": max(material.wave_speed for material in particles.materials),
        "particles": len(deposit),
        "rest_time": began * scene.frame_dt if rest else None,
        "end_time": (rest or scene.frames - 1) * scene.frame_dt,
        "energy": {kind.name.lower(): rounded(energies[:, kind]) for kind in kinds},
        "wall_s": wall_s,
        "compile_s": compile_s,
        "arch": arch,
        "precision": batch.features.precision,
    }
    if retained := retained_masses(scene):
        opened = batch.retained[offset[Offset.RETAINED] :, Retained.OPENED][: len(retained)]
        times = dict(zip(retained, (opened * scene.frame_dt).tolist(), strict=True))
        summary["release_time"] = [(times[k] or None) if k in times else 0.0 for k in range(len(scene.masses))]
    if batch.recording.wall_forces:
        walls = impulses[:, solids:]
        summary["wall_impulse"], sides = rounded(walls.sum(axis=1)), DOMAIN_SIDES[: 2 * scene.dimension]
        summary["side_impulse"] = {side: rounded(walls[:, number]) for number, side in enumerate(sides)}
    if left := outflow(batch, index) if scene.open_sides else {}:
        summary["outflow"] = left
    end_time, kinetic = summary["end_time"], energies[:, Energy.KINETIC]
    over_time = {"kinetic": kinetic, "present": batch.present(index)}
    summary["remarks"] = caveats(scene, particles, deposit, **over_time, end_time=end_time, outflow=left)
    if water := drainage(scene, end_time):
        summary["drainage"] = water
    if scene.stages:
        nowhere = [f"stages[{k}]" for k, stage in enumerate(scene.stages) if not selected(stage, particles).any()]
        summary["remarks"] += [f"{key} changes nothing: no particle began where it applies" for key in nowhere]
        begun = batch.staged[index, : len(scene.stages)]
        summary["stage_time"] = [frame * scene.frame_dt or None for frame in begun.tolist()]
        if not begun.all():
            waiting = f"stages[{np.count_nonzero(begun)}] did not begin: by t = {end_time:g} s"
            summary["remarks"].append(f"{waiting} the scene had not settled")
    solid_impulse = impulses[kept, :solids] if solids else None
    return flow_of(batch, index, positions, **fields, solid_impulse=solid_impulse, summary=summary)


def flow_of(batch: Batch, index: int, positions: Floats, **others: Any) -> Trajectory:
    """The flow of scene `index` with `positions` [m] in the first of the kept frames, shape [T, N, D]."""
    scene, particles = batch.scenes[index], batch.particles[index]
    return Trajectory(
        positions=positions,
        time=np.array(batch.kept(index)[: len(positions)], np.float64) * scene.frame_dt,
        velocity0=particles.velocities.astype(np.float32),
        friction=particles.friction,
        scene=scene,
        entry_time=particles.entry_time,
        **others,
    )


def still_moves(summary: Mapping[str, Any]) -> bool:
    """Whether a flow was not at rest at its end, according to its summary."""
    return any(line.startswith(MOVING) for line in summary.get("remarks", []))


def caveats(
    scene: Scene,
    particles: Particles,
    deposit: Floats,
    *,
    kinetic: Floats,
    present: Floats,
    end_time: float,
    outflow: dict[str, float],
) -> list[str]:
    """Remarks on a flow of `particles`, one per line; none if all is well.

    deposit: positions at the end [m], shape [N, D]; kinetic: energy of every frame [J], present: share of the mass that
    is in the box then [-], shape [T]; end_time: until when the flow was computed [s]; outflow: mass that left through
    each open side [kg]. In 2D energy and mass are per metre of width."""
    lines = []
    mass, start = float(np.sum(particles.density * particles.volume)), particles.positions
    speed = math.sqrt(2.0 * float(kinetic[-1]) / (mass * float(present[-1])))
    # Of as much mass as is there in the end: what has left took its energy along.
    most = float((kinetic * (present[-1] / np.maximum(present, present[-1]))).max())
    if kinetic[-1] > AT_REST * most and speed > SLOW * math.sqrt(scene.gravity * scene_height(scene)):
        moving = f"at t = {end_time:g} s, the end, it still moves at {speed:.2g} m/s (rms)"
        lines.append(f"{MOVING}: {moving}; front and deposit are not final")
    for number, side in enumerate(DOMAIN_SIDES[: 2 * scene.dimension]):
        axis, upper = divmod(number, 2)
        if side in (*scene.open_sides, "y-"):
            continue
        wall, close = scene.domain.size[axis] if upper else 0.0, NEAR * scene.domain.cell
        near = [float(np.mean(np.abs(each[:, axis] - wall) < close)) for each in (start, deposit)]
        if not near[0] and near[1] > SHARE:
            share = f"{near[1]:.2g} of the particles"
            lines.append(f"side {side} of the box stops {share}, which would have spread further")
    for side, left in outflow.items():
        if left > 0.0:
            lines.append(f"{left / mass:.2g} of the mass left the box through its open side {side}")
    return lines + [line for line in [unresolved(scene, FEWEST_CELLS)] if line]


def rounded(series: NDArray[np.float64]) -> Any:
    """A series of numbers or vectors, shape [T, ...], with six digits, as lists."""
    return [rounded(value) if value.ndim else float(f"{value:.6g}") for value in series]
