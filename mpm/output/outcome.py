"""What a scene of a batch came to: its trajectory, or why there is none."""

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import WorkFailed
from datasets.scene import SIDES
from datasets.trajectory import Trajectory, solid_names
from mpm.arrays.batch import Batch
from mpm.arrays.layout import Offset, Worker
from mpm.output.failure import explain
from mpm.output.summary import summarise
from mpm.physics.smoothing import density, smoothed
from mpm.runtime import Arch


def failure(batch: Batch, index: int) -> WorkFailed | None:
    """Why scene `index` of a batch blew up; None where it did not."""
    scene, features, reached = batch.scenes[index], batch.features, int(batch.offsets[index, Offset.FRAMES])
    if reached == scene.frames and np.isfinite(batch.recorded(index)).all():
        return None
    count = len(batch.particles[index].positions)
    numbers = np.moveaxis(batch.state_of(index), 1, 0).reshape(features.block, -1)[:, :count]
    velocities = numbers[features.velocity :][: features.dimension].T
    return WorkFailed(explain(scene, batch.particles[index], velocities, reached - 1))


def outflow(batch: Batch, index: int) -> dict[str, float] | None:
    """Mass that has left through each open side [kg, in 2D per metre of width]; None where all sides are walls."""
    scene, features, particles = batch.scenes[index], batch.features, batch.particles[index]
    if not scene.open_sides:
        return None
    count = len(particles.positions)
    numbers = np.moveaxis(batch.state_of(index), 1, 0).reshape(features.block, -1)[:, :count]
    first = batch.offsets[index, Offset.BLOCK] * features.lanes
    mass = (particles.density * particles.volume)[batch.order[first : first + count]]
    gone = numbers[features.present] == 0.0
    # Through the side that it lies farthest beyond.
    beyond = np.full((len(SIDES), count), -np.inf)
    for side in scene.open_sides:
        axis, upper = "xyz".index(side[0]), side[1] == "+"
        place = numbers[axis]
        beyond[SIDES.index(side)] = place - scene.domain.size[axis] if upper else -place
    through = beyond.argmax(axis=0)
    return {side: float(mass[gone & (through == SIDES.index(side))].sum()) for side in scene.open_sides}


def fields_of(batch: Batch, index: int) -> dict[str, NDArray[np.float32]]:
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
        solid_impulse=impulses[kept, :solids] if solids and record.baffle_forces else None,
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
