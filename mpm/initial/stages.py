"""Stages: at a given time, or when the scene has settled, particles get other constants of their material.

A stage (`datasets.scene.Stage`) begins at the end of a frame, between two calls of the kernel, which does not know it:
the particles' properties are rewritten. Stress beyond the new yield surface returns to it in the next step. The
particles of a stage follow from their initial places alone, so that a run can be interrupted anywhere.

Settled: over a window of frames (`mpm.output.recording.window_frames`), at least a period of the slowest oscillation
and a flow time, the kinetic energy per mass in the box was below REST times its largest since the last stage, or below
REST_ENERGY.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from datasets.scene import TOLERANCE, Scene, Stage
from datasets.scene.particles import Particles
from mpm.arrays.batch import Batch, put_vectors
from mpm.arrays.layout import INDEX_LIMIT, Energy, Offset, Setting
from mpm.arrays.properties import properties_of
from mpm.output.recording import REST, window_frames


def selected(stage: Stage, particles: Particles) -> NDArray[np.bool_]:
    """Which of N particles, in their initial state, a stage applies to, shape [N]."""
    places = particles.positions
    here = np.full(len(places), True) if stage.mass is None else particles.mass == stage.mass
    if stage.lower is not None and stage.size is not None:
        low, high = np.array(stage.lower) - TOLERANCE, np.add(stage.lower, stage.size) + TOLERANCE
        here &= ((places >= low) & (places <= high)).all(axis=1)
    if stage.outline is not None and places.shape[1] == 2:
        here &= (places[:, 0] >= np.min(stage.outline)) & (places[:, 0] <= np.max(stage.outline))
    elif stage.outline is not None:
        import shapely

        here &= shapely.contains_xy(shapely.Polygon(stage.outline), places[:, [0, 2]])
    return here


def particles_after(scene: Scene, particles: Particles, count: int) -> Particles:
    """The particles at the start of a scene with the materials that the first `count` of its stages give them."""
    materials, numbers, angle = list(particles.materials), particles.material.copy(), particles.friction_deg
    for stage in scene.stages[:count]:
        here = selected(stage, particles)
        for index in np.unique(numbers[here]).tolist():
            numbers[here & (numbers == index)] = len(materials)
            materials.append(dataclasses.replace(materials[index], **stage.values))
        if angle is not None and stage.friction_deg is not None:
            angle = np.where(here, stage.friction_deg, angle)
    return dataclasses.replace(particles, material=numbers, materials=tuple(materials), friction_deg=angle)


def next_stage(batch: Batch, index: int) -> Stage | None:
    """The stage that scene `index` of a batch waits for; None if it waits for none, or has ended."""
    begun = np.count_nonzero(batch.staged[index])
    waits = begun < len(batch.scenes[index].stages) and not batch.ended(batch.computed + 1)[index]
    return batch.scenes[index].stages[begun] if waits else None


def call_end(batch: Batch, first: int) -> int:
    """The frame before which a call that begins with `first` must end, so that stages can begin.

    While a scene waits for a stage, and for a window of frames after the last, it does not count as at rest."""
    end = INDEX_LIMIT
    for index, scene in enumerate(batch.scenes):
        if not scene.stages:
            continue
        stage, since = next_stage(batch, index), int(batch.staged[index].max())
        window = window_frames(scene, batch.particles[index].materials)
        if stage is not None:
            end = min(end, first + 1 if isinstance(stage.time, str) else round(stage.time / scene.frame_dt) + 1)
        elif first < since + window:
            end = min(end, since + window)
        waits = stage is not None or first < since + window
        batch.offsets[index, Offset.WINDOW] = INDEX_LIMIT if waits else min(window, INDEX_LIMIT)
    return end


def begin_stages(batch: Batch) -> None:
    """Begin the stages that are due after the last computed frame, and those of scenes that have settled."""
    for index, scene in enumerate(batch.scenes):
        stage = next_stage(batch, index)
        if stage is None:
            continue
        timed = not isinstance(stage.time, str) and round(stage.time / scene.frame_dt) <= batch.computed
        if timed or (isinstance(stage.time, str) and settled(batch, index)):
            count = int(np.count_nonzero(batch.staged[index]))
            batch.staged[index, count] = batch.computed
            rows = properties_of(particles_after(scene, batch.particles[index], count + 1))
            state, features = batch.state_of(index), batch.features
            first = batch.offsets[index, Offset.BLOCK] * features.lanes
            columns = rows[batch.order[first : first + len(state) * features.lanes], : features.columns]
            put_vectors(state, features.state.properties, columns)


def settled(batch: Batch, index: int) -> bool:
    """Whether nothing has moved in scene `index` over a window of frames, all of them after its last stage."""
    since = max(int(batch.staged[index].max()), int(batch.offsets[index, Offset.ENTERED]))
    window = window_frames(batch.scenes[index], batch.particles[index].materials)
    kinetic = (batch.energies(index)[:, Energy.KINETIC] / batch.present(index))[since + 1 : batch.computed + 1]
    if len(kinetic) < window:
        return False
    most = max(REST * kinetic.max(), float(batch.settings[index, Setting.REST_ENERGY]))
    return bool(kinetic[-window:].max() <= most)
