"""The result of a scene of a batch: its trajectory with a summary, or why there is none."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import WorkFailed
from datasets.measures import front, runout, toe
from datasets.particles import Particles
from datasets.scene import DOMAIN_SIDES, Scene
from datasets.trajectory import Trajectory, solid_names
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Energy, Offset, Precision, Worker
from mpm.output.recorder import RUNAWAY
from mpm.output.smoothing import density, smoothed
from mpm.runtime import Arch


def failure(batch: Batch, index: int) -> WorkFailed | None:
    """Why scene `index` of a batch blew up; None where it did not."""
    scene, features, frames = batch.scenes[index], batch.features, int(batch.offsets[index, Offset.FRAMES])
    if frames == scene.frames and batch.finite(index):
        return None
    count = len(batch.particles[index].positions)
    numbers = np.moveaxis(batch.state_of(index), 1, 0).reshape(features.block, -1)[:, :count]
    velocities = numbers[features.velocity :][: features.dimension].T
    return WorkFailed(explain(scene, batch.particles[index], velocities, frames - 1))


def outflow(batch: Batch, index: int) -> dict[str, float] | None:
    """Mass that has left through each open side [kg, in 2D per metre of width]; None where all sides are walls."""
    scene, features, particles = batch.scenes[index], batch.features, batch.particles[index]
    if not scene.open_sides:
        return None
    count = len(particles.positions)
    numbers = np.moveaxis(batch.state_of(index), 1, 0).reshape(features.block, -1)[:, :count]
    first = batch.offsets[index, Offset.BLOCK] * features.lanes
    mass = (particles.density * particles.volume)[batch.order[first : first + count]]
    removed = numbers[features.present] == 0.0
    # Through the side that it lies farthest beyond.
    beyond = np.full((len(DOMAIN_SIDES), count), -np.inf)
    for side in scene.open_sides:
        axis, upper = "xyz".index(side[0]), side[1] == "+"
        coordinate = numbers[axis]
        beyond[DOMAIN_SIDES.index(side)] = coordinate - scene.domain.size[axis] if upper else -coordinate
    through = beyond.argmax(axis=0)
    return {side: float(mass[removed & (through == DOMAIN_SIDES.index(side))].sum()) for side in scene.open_sides}


def fields_of(batch: Batch, index: int) -> dict[str, Any]:
    """The fields that were asked for of scene `index`, by the names of `datasets.trajectory.Trajectory`."""
    scene, particles, record = batch.scenes[index], batch.particles[index], batch.recording
    positions, values, features = batch.recorded(index), batch.recorded_fields(index), batch.features
    fields = {}
    if features.velocity_recorded:
        fields["velocities"] = values[:, :, : features.dimension]
    if features.stress_recorded:
        fields["stress"] = values[:, :, features.recorded_stress :][:, :, : features.stresses]
    if features.pressure_recorded:
        fields["pressure"] = values[:, :, features.recorded_stress]
    if features.strain_recorded:
        fields["plastic_strain"] = values[:, :, features.recorded_strain]
    if not record.raw:
        for name in fields.keys() & {"stress", "pressure"}:
            fields[name] = smoothed(fields[name], positions, particles.volume, scene)
    if features.stress_recorded and "pressure" in record.fields:
        fields["pressure"] = -fields["stress"][:, :, :3].sum(axis=2) / 3.0
    if "density" in record.fields:
        fields["density"] = density(positions, particles.density * particles.volume, scene)
    return fields


def trajectory(batch: Batch, index: int, *, arch: Arch, wall_s: float, compile_s: float) -> Trajectory | WorkFailed:
    """What scene `index` did; the frames after it came to rest are filled with the last one that was computed."""
    if (failed := failure(batch, index)) is not None:
        return failed
    scene, particles, offset, record = (
        batch.scenes[index],
        batch.particles[index],
        batch.offsets[index],
        batch.recording,
    )
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
        # What one trajectory holds must not keep the record of all others in memory.
        positions, fields = positions.copy(), {name: values.copy() for name, values in fields.items()}
    began = rest - int(offset[Offset.WINDOW]) + 1
    return Trajectory(
        positions=positions,
        time=np.array(kept, np.float64) * scene.frame_dt,
        velocity0=particles.velocities.astype(np.float32),
        friction=particles.friction,
        scene=scene,
        **fields,
        solid_impulse=impulses[kept, :solids] if solids else None,
        summary=summarise(
            positions[-1],
            energy=energies,
            steps=int(offset[Offset.STEPS]),
            clamped=int(batch.clamped[batch.workers[:, Worker.SCENE] == index].sum()),
            rest_time=began * scene.frame_dt if rest else None,
            end_time=(rest or scene.frames - 1) * scene.frame_dt,
            relaxation_time=scene.relaxation,
            release_time=batch.release_times(index),
            wall_impulse=impulses[:, solids:] if record.wall_forces else None,
            outflow=outflow(batch, index),
            wall_s=wall_s,
            compile_s=compile_s,
            arch=arch,
            precision=batch.features.precision,
        ),
    )


def summarise(
    deposit: NDArray[np.float32],
    *,
    energy: NDArray[np.float64],
    steps: int,
    clamped: int,
    rest_time: float | None,
    end_time: float,
    relaxation_time: float,
    release_time: list[float | None] | None,
    wall_impulse: NDArray[np.float64] | None,
    outflow: dict[str, float] | None,
    wall_s: float,
    compile_s: float,
    arch: Arch,
    precision: Precision,
) -> dict[str, Any]:
    """Summary of a run that ended in `deposit` [m], shape [N, D]; `energy` [J/m], shape [T, len(Energy)].

    Lengths in metres; `energy` is a series with a value at every frame of the scene; `clamped` counts how often a
    particle was put back into the box; `rest_time` [s] is when the deposit came to rest, where the run may end there,
    and `end_time` [s] until when it was computed; `release_time` [s] when each mass was let go, where barriers hold
    one; `relaxation_time` [s] that of the scene, its default worked out; `wall_impulse` [N s] the momentum that the
    sides of the box and the barriers have taken up to each frame, shape [T, 2 D + 1, D], where asked for: their sum
    and, as `side_impulse`, each; `outflow` [kg] what left through each open side; `wall_s` is that of all scenes that
    ran together, compilation apart.
    """
    summary = {
        "runout": runout(deposit),
        "front": front(deposit),
        "toe": list(toe(deposit)),
        "steps": steps,
        "particles": len(deposit),
        "clamped": clamped,
        "rest_time": rest_time,
        "end_time": end_time,
        "relaxation_time": relaxation_time,
        "energy": {
            column.name.lower(): [float(f"{e:.6g}") for e in energy[:, column]]
            for column in (Energy.KINETIC, Energy.POTENTIAL, Energy.ELASTIC)
        },
        "wall_s": wall_s,
        "compile_s": compile_s,
        "arch": arch,
        "precision": precision,
    }
    if release_time is not None:
        summary["release_time"] = release_time
    if wall_impulse is not None:
        summary["wall_impulse"] = rounded(wall_impulse.sum(axis=1))
        names = DOMAIN_SIDES[: 2 * deposit.shape[1]]
        summary["side_impulse"] = {side: rounded(wall_impulse[:, number]) for number, side in enumerate(names)}
    if outflow is not None:
        summary["outflow"] = outflow
    return summary


def rounded(series: NDArray[np.float64]) -> list[list[float]]:
    """A series of vectors, shape [T, D], with six digits."""
    return [[float(f"{p:.6g}") for p in row] for row in series]


def explain(scene: Scene, particles: Particles, velocities: NDArray[np.floating], frame: int) -> str:
    """One line on a scene that ended after `frame` with `velocities` [m/s], shape [N, D].

    A particle faster than RUNAWAY times the wave speed ends a scene. Where gravity and the initial velocities can make
    it that fast, v^2 <= v_0^2 + 2 sum_k |g_k| L_k in a box of lengths L, that is the flow itself, and the material is
    too soft for it; where they cannot, or where there is no number, the integration was unstable.
    """
    when, speed = f"t = {scene.frame_dt * frame:g} s", _fastest(velocities)
    fall = 2.0 * sum(abs(g) * length for g, length in zip(scene.gravity_vector, scene.domain.size, strict=True))
    possible = math.sqrt(_fastest(particles.velocities) ** 2 + fall)
    # Some slack: a pile-up transfers energy to the few particles that it throws.
    if not math.isfinite(speed) or speed > 2.0 * possible:
        return f"the simulation blew up at {when}; try a step_fraction below {scene.step_fraction:g}"
    stiffest = max(particles.materials, key=lambda material: material.wave_speed)
    wave_speed = stiffest.wave_speed
    young = _rounded_up(stiffest.young * (speed / (RUNAWAY * wave_speed)) ** 2)
    return (
        f"a particle moves at {speed:.3g} m/s at {when}, more than {RUNAWAY:g} times the wave speed of "
        f"{wave_speed:.3g} m/s: a shorter step does not help; "
        f"a young of at least {young:.2g} Pa or a lower velocity does"
    )


def _fastest(velocities: NDArray[np.floating]) -> float:
    """The largest speed [m/s] of velocities [N, D]; nan where one is."""
    return float(np.linalg.norm(velocities.astype(np.float64), axis=1).max())


def _rounded_up(value: float) -> float:
    """The next larger number of two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(1.001 * value / unit) * unit
