"""A differentiable run: forwards with checkpoints, backwards segment by segment (Griewank & Walther 2000).

There are two levels. The run goes forwards in the solver's own kernel and keeps its state at the first frame of every
segment. Backwards, the last segment first, each segment is replayed from its checkpoint with the state before every
step in memory, and its steps are reversed. With F frames of n steps and segments of k frames, memory holds F / k + k n
states, least at k = sqrt(F / n): it grows with the root of the steps; each step is computed twice and reversed once.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datasets.errors import WorkFailed, require
from datasets.scene import Scene
from datasets.scene.particles import Particles
from mpm import runtime
from mpm.adjoint.kernel import Pass
from mpm.adjoint.kernel import kernel as adjoint_kernel
from mpm.adjoint.layout import Layout
from mpm.arrays.batch import Batch, particles_of, put_vectors
from mpm.arrays.features import Features, features_of
from mpm.arrays.kernel_arguments import ADJOINT, STEP, aligned, arguments
from mpm.arrays.layout import INDEX_LIMIT, Offset, Precision, Retained, Setting, Worker
from mpm.kernel import compute
from mpm.output.outcome import failure
from mpm.output.recording import LAST

Array = NDArray[Any]

MEMORY_MIB = 256.0  # default memory budget of checkpoints, states of a segment and adjoints [MiB]
CUT = 20.0
"""Adjoint of a particle's velocity, over the largest of the objective times the duration, above which it is cut.

Single particles that fly apart and touch again oscillate on their own; with large steps the oscillation grows until
they lose contact: some 1e-8 m, without effect on the flow. The derivative along the run grows by a factor at each of
their steps. The motion of such a particle has no meaningful derivative, and its adjoint is set to 0. Its earlier
contributions to others are kept, so that an inversion takes shorter steps (`steady`). Adjoints of the force on a baffle
exceed 5 even without such particles."""
MOST_CUT = 0.02  # share of cut adjoints, of all particles and steps, from which a gradient is rejected
SPARE = 1.25  # steps in a frame, over its usual number, for which a plan has room: fast particles shorten the step


def check(features: Features) -> None:
    """Raise InputError if scenes with `features` need something without an adjoint."""
    dry = "false: the adjoint does not cover pore water, python -m validation.loop needs none"
    require(not features.pores, "material.saturated", dry, "true")
    require(not features.gates, "scene", "a scene without a gate, which the adjoint does not cover yet")
    require(not features.inflow, "masses", "masses present from the start, the adjoint does not cover inflow")


def steady(scene: Scene) -> Scene:
    """The scene with steps short enough that, in 3D, no isolated particle oscillates with growing amplitude.

    They are at most sqrt((lambda + 2 mu) / (3 lambda + 2 mu)) of a cell over the wave speed, 0.73 with nu = 0.3. With
    longer steps a few particles dominate a gradient although they move by only 1e-8 m, as in a chaotic system (Metz et
    al. 2021, Gradients are not all you need). In 2D few particles fly alone, and the scene keeps its step."""
    if scene.dimension < 3:
        return scene
    moduli = [(material.lame, 2.0 * material.shear_modulus) for material in map(scene.material_of, scene.masses)]
    stable = min(math.sqrt((lame + twice) / (3.0 * lame + twice)) for lame, twice in moduli)
    return dataclasses.replace(scene, step_fraction=min(scene.step_fraction, stable))


class FlowAdjoints(NamedTuple):
    """Adjoints of the observed quantities of a run of a scene, at T frames."""

    positions: Array
    """Adjoints of the positions of N particles [J / m], shape [T, N, D]."""
    velocities: Array | None = None
    """[J s / m], shape [T, N, D]; None if J does not depend on them."""
    impulses: Array | None = None
    """Of the momentum that solids have taken [J / (N s)], shape [T, solids, D]; None if J does not depend on it."""


class Tape:
    """A run of scenes of one kind side by side, one thread each, whose adjoints can be taken back to its start.

    A single large scene uses all threads. frames: observed frames, ascending; the run ends at the last. memory_mib:
    budget besides the arrays of the run itself; outputs: number of objectives that are reversed together, for whose
    adjoints memory is counted; exact: as `mpm.adjoint.layout.Layout.exact`, for tests; particles: initial particles of
    each scene, if they differ from the scene's own. Raises InputError if a scene needs something without an adjoint, if
    the scenes differ in kind, or if the budget is too small; WorkFailed if a run blows up."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        frames: Sequence[int],
        *,
        precision: Precision = "f64",
        memory_mib: float = MEMORY_MIB,
        threads: int | None = None,
        outputs: int = 1,
        exact: bool = False,
        particles: Sequence[Particles] | None = None,
    ) -> None:
        self.frames, last = sorted(set(frames)), min(scene.frames for scene in scenes) - 1
        within = bool(self.frames) and self.frames[0] >= 0 and 0 < self.frames[-1] <= last
        require(within, "", f"frames from 0 to {last}, one of them after the first", list(frames))
        particles = particles_of(scenes) if particles is None else list(particles)
        features = features_of(scenes, precision, record=LAST)
        alike = all(features_of([scene], precision, record=LAST) == features for scene in scenes)
        require(alike, "", "scenes of one kind, with the same features: contact, damping, ...")
        check(features)
        staged = any(scene.stages for scene in scenes)
        require(not staged, "stages", "a scene without stages, which the adjoint does not cover")
        workers = runtime.workers_for(len(particles[0].positions), threads) if len(scenes) == 1 else 1
        runtime.start(precision, threads, enough=max(workers, min(len(scenes), threads or len(scenes))))
        self.batch = Batch(scenes, precision=precision, workers=workers, record=LAST, particles=particles)
        self.features = features = self.batch.features
        self.layout = Layout(self.features, exact)
        # The reverse has more scratch vectors than a step.
        count = len(self.batch.workers)
        self.batch.scratch = aligned((count * self.layout.scratch.size, features.lanes), self.batch.state.dtype)
        self.batch.workers[:, Worker.SCRATCH] = np.arange(count) * self.layout.scratch.size
        # The vectors of a block that change from step to step.
        self.changing = [*range(features.state.properties), *range(features.state.remainder, features.state.size)]
        self.start = self.checkpoint()
        self.barriers = self.batch.retained.copy(), self.batch.settling.copy()
        self.released: set[int] = set()
        self.memory_mib, vector = memory_mib, self.batch.state[:, 0].nbytes
        # Bytes of a checkpoint, of the states before one step, and of the adjoints of particles.
        self.state_bytes, self.step_bytes = len(self.changing) * vector, self.layout.history * vector
        self.adjoint_bytes = outputs * self.layout.width * vector
        usual = float(self.batch.offsets[:, Offset.SUBSTEPS].max())
        self.run(usual, SPARE * usual)
        opened = {frame for frame in self.batch.retained[:, Retained.OPENED].tolist() if 0 < frame < self.frames[-1]}
        if missing := opened - set(self.boundaries):
            # Within a segment, barriers are either open or closed.
            self.released = missing
            self.run(usual, SPARE * usual)
        if self.bytes() > memory_mib * 2**20:
            # There were more steps than planned; now their number is known.
            most = float(np.max(self.steps / np.diff(self.boundaries)[:, None]))
            self.run(most, most)

    @property
    def fixed_bytes(self) -> int:
        """Bytes of adjoints and of the nodes that a reverse step keeps."""
        return 2 * self.batch.grid.nbytes + self.adjoint_bytes

    def plan(self, usual: float, most: float) -> list[int]:
        """The frames at which segments begin, and the last; steps in a frame: usually `usual`, at most `most`."""
        last, budget = self.frames[-1], self.memory_mib * 2**20 - self.fixed_bytes
        best, smallest = [0, last], math.inf
        for length in range(1, last + 1):
            boundaries = sorted({*range(0, last, length), *self.frames, *self.released, 0, last})
            steps = math.ceil(length * most + 1) * self.step_bytes
            if (whole := (len(boundaries) - 1) * self.state_bytes + steps) < smallest:
                best, smallest = boundaries, whole
        needed = f"memory for the adjoint of at least {(smallest + self.fixed_bytes) / 2**20:.1f} MiB"
        states = f"{last} frames of {usual:.0f} steps, {self.state_bytes / 2**20:.2g} MiB a state"
        require(smallest <= budget, "memory_mib", needed, f"{self.memory_mib:g} MiB: {states}")
        return best

    def bytes(self) -> int:
        """Bytes of everything besides the arrays of the run itself."""
        longest = int(self.steps.max()) + 1
        return self.fixed_bytes + len(self.checkpoints) * self.state_bytes + longest * self.step_bytes

    def checkpoint(self) -> Array:
        """The state of all scenes."""
        return self.batch.state[:, self.changing].copy()

    def restore(self, checkpoint: Array) -> None:
        """Return to a state."""
        self.batch.state[:, self.changing] = checkpoint

    def run(self, usual: float, most: float) -> None:
        """Run forwards with the solver's kernel, in the segments of a `plan`."""
        self.boundaries = self.plan(usual, most)
        self.restore(self.start)
        self.batch.impulse[:], self.batch.recorded_impulse[:] = 0.0, 0.0
        self.batch.retained[:], self.batch.settling[:] = self.barriers
        self.checkpoints = []
        self.observed = {0: self.motion()} if 0 in self.frames else {}
        steps = [self.batch.offsets[:, Offset.STEPS].copy()]
        for first, last in zip(self.boundaries, self.boundaries[1:], strict=False):
            self.checkpoints.append(self.checkpoint())
            self.batch.computed = first
            compute(self.batch, last + 1)
            steps.append(self.batch.offsets[:, Offset.STEPS].copy())
            if last in self.frames:
                self.observed[last] = self.motion()
        for index in range(len(self.batch.scenes)):
            if (failed := failure(self.batch, index)) is not None:
                raise failed
        self.steps = np.diff(steps, axis=0)  # of each segment and scene, shape [segments, scenes]

    def motion(self) -> tuple[Array, Array]:
        """Positions [m] and velocities [m/s] of the particles of all scenes, shape [blocks * lanes, D] each."""
        return self.vectors(self.batch.state, 0), self.vectors(self.batch.state, self.features.state.velocity)

    def vectors(self, blocks: Array, first: int, count: int | None = None) -> Array:
        """`count` numbers of every particle, D unless given, from vector `first` of its block on, shape [., count]."""
        count = self.features.dimension if count is None else count
        return np.moveaxis(blocks[:, first : first + count], 1, 2).reshape(-1, count).copy()

    def particles(self, index: int) -> slice:
        """The place of the particles of scene `index` in the result of `vectors`."""
        first = int(self.batch.offsets[index, Offset.BLOCK]) * self.features.lanes
        return slice(first, first + int(self.batch.offsets[index, Offset.PARTICLES]))

    def solids(self, index: int) -> tuple[slice, slice]:
        """The place of the faces of scene `index`, and of its holds of nodes, among those of all scenes."""
        if not self.features.contact:
            return slice(0), slice(0)
        firsts = self.batch.first_obstacles[:, 1:].tolist()
        (face, hold), (last_face, last_hold) = firsts[index : index + 2]
        return slice(face, last_face), slice(hold, last_hold)

    def of_posts(self, index: int, adjoint: NDArray[np.float64]) -> NDArray[np.float64]:
        """From the adjoints of the frictions of the bed of scene `index` to those of the posts of its terrain, [P]."""
        if not self.features.terrain:
            return adjoint[:0]
        bed = self.batch.beds[index]
        if bed is None or bed.field.friction.size == 1:
            return adjoint[: int(bed is not None)]
        return bed.to_posts(adjoint[: bed.heights.size].reshape(bed.heights.shape)).ravel()

    def positions(self, index: int = 0) -> NDArray[np.float64]:
        """Positions of the particles of a scene at the observed frames [m], shape [T, N, D]."""
        return np.stack([self.observed[frame][0][self.particles(index)] for frame in self.frames]).astype(np.float64)

    def velocities(self, index: int = 0) -> NDArray[np.float64]:
        """Velocities of the particles of a scene at the observed frames [m/s], shape [T, N, D]."""
        return np.stack([self.observed[frame][1][self.particles(index)] for frame in self.frames]).astype(np.float64)

    def impulses(self, index: int = 0) -> NDArray[np.float64]:
        """Momentum that the solids of a scene have taken at the observed frames [N s], shape [T, solids, D]."""
        return self.batch.impulses(index)[self.frames]

    def reverse(self, flow_adjoints: Sequence[Sequence[FlowAdjoints]]) -> list[dict[str, Array]]:
        """Adjoints of the initial numbers of the run for any number of objectives; segments are replayed once for all.

        flow_adjoints: for each objective and scene. Returns those of particles (`adjoints`, shape [blocks,
        Layout.width, lanes]), settings of each scene (`settings`), faces (`face_adjoints`), holds of nodes
        (`hold_adjoints`) and the friction of the bed of each scene (`terrain_adjoints`), g / xi of its solids
        (`drag_adjoints`), and the share of the adjoints of each scene that were cut (`cut`). Raises WorkFailed where a
        gradient grows without bound."""
        batch, features, layout = self.batch, self.features, self.layout
        real, lanes = batch.state.dtype, features.lanes
        history = aligned((int(self.steps.max()) + 1, len(batch.state), layout.history, lanes), real)
        fits, expected = history.size < INDEX_LIMIT, "fewer particles or observed frames"
        require(fits, "", expected, f"{history.size} numbers in a segment, of at most 2^30")
        shared: dict[str, Any] = self.nodes() | {
            "history": history,
            "step_times": np.zeros((len(batch.scenes), len(history)), real),
            "step_counts": np.zeros(len(batch.scenes), np.int32),
        }
        varied = [bed for bed in batch.beds if bed is not None and bed.field.friction.size > 1]
        frictions = max((bed.heights.size for bed in varied), default=1)
        objectives = [
            {
                "adjoints": aligned((len(batch.state), layout.width, lanes), real),
                "sums": np.zeros((len(batch.workers), len(Setting))),
                "face_adjoints": np.zeros(batch.faces.shape),
                "hold_adjoints": np.zeros(batch.holds.shape),
                "terrain_adjoints": np.zeros((len(batch.scenes), frictions)),
                "drag_adjoints": np.zeros(batch.drags.shape),
                "impulse_adjoints": np.zeros(len(batch.impulse), real),
                "cuts": self.cuts(per_scene).astype(real),
            }
            for per_scene in flow_adjoints
        ]
        forced = any(adjoints.impulses is not None for per_scene in flow_adjoints for adjoints in per_scene)
        walk = adjoint_kernel(dataclasses.replace(layout, impulses=forced))

        def call(objective: dict[str, Array], first: int, last: int, direction: Pass) -> bool:
            """Whether the call finished; otherwise grids had too little room and were enlarged."""
            batch.arrivals = np.zeros(len(batch.workers), np.int32)
            walk(*arguments(STEP | ADJOINT, vars(batch) | shared | objective, lanes).values(), first, last, direction)
            grown = batch.grow_grid()
            if grown:
                shared.update(self.nodes())
            return not grown

        opened = batch.retained[:, Retained.OPENED].copy()
        for segment in reversed(range(len(self.checkpoints))):
            first, last = self.boundaries[segment : segment + 2]
            batch.retained[:, Retained.OPENED] = np.where(opened <= first, opened, 0)
            self.restore(self.checkpoints[segment])
            while not call(objectives[0], first + 1, last + 1, Pass.REPLAY):
                self.restore(self.checkpoints[segment])
            counts = shared["step_counts"].copy()
            for objective, per_scene in zip(objectives, flow_adjoints, strict=True):
                if last in self.frames:
                    self.add_adjoints(objective, per_scene, self.frames.index(last))
                shared["step_counts"][:] = counts
                while not call(objective, first + 1, last + 1, Pass.REVERSE):
                    pass
        batch.retained[:, Retained.OPENED] = opened
        for objective, per_scene in zip(objectives, flow_adjoints, strict=True):
            call(objective, 0, 0, Pass.START)
            if 0 in self.frames:
                self.add_adjoints(objective, per_scene, 0)
        steps = self.steps.sum(axis=0) * batch.offsets[:, Offset.PARTICLES]
        shares = [objective["cuts"][:, 1] / steps for objective in objectives]
        for index, share in enumerate(np.max(shares, axis=0)):
            if share > MOST_CUT:
                fraction = batch.scenes[index].step_fraction
                raise WorkFailed(
                    f"the gradient of scene {index} grows without bound: {100.0 * share:.2g} % of all adjoints were "
                    f"cut, for single oscillating particles; try a step_fraction below {fraction:g}"
                )
        for objective, share in zip(objectives, shares, strict=True):
            objective["cut"], objective["settings"] = share, np.zeros((len(batch.scenes), len(Setting)))
            np.add.at(objective["settings"], batch.workers[:, Worker.SCENE], objective["sums"])
        return objectives

    def nodes(self) -> dict[str, Array]:
        """The nodes that a reverse step keeps, and their adjoints, by the names of the kernel's arrays."""
        shape, real = self.batch.grid.shape, self.batch.state.dtype
        return {"kept": aligned(shape, real), "grid_adjoints": aligned(shape, real)}

    def cuts(self, per_scene: Sequence[FlowAdjoints]) -> Array:
        """The square of the largest admitted adjoint of a velocity, and how many exceeded it, shape [scenes, 2]."""
        limits = np.zeros((len(per_scene), 2))
        for index, adjoints in enumerate(per_scene):
            time = self.frames[-1] * self.batch.scenes[index].frame_dt
            usual = np.abs(adjoints.positions).max() * time
            if adjoints.velocities is not None:
                usual += np.abs(adjoints.velocities).max()
            if adjoints.impulses is not None:
                particles = self.batch.particles[index]
                usual += float((particles.density * particles.volume).max()) * np.abs(adjoints.impulses).sum()
            limits[index, 0] = np.inf if self.layout.exact else (CUT * usual) ** 2
        return limits

    def add_adjoints(self, objective: dict[str, Array], per_scene: Sequence[FlowAdjoints], slot: int) -> None:
        """Add the adjoints of the observations at frame number `slot` to those of blocks and impulses."""
        for index, observed in enumerate(per_scene):
            here = self.particles(index)
            for first, values in ((0, observed.positions), (self.features.state.velocity, observed.velocities)):
                if values is not None:
                    flat = self.vectors(objective["adjoints"], first)
                    flat[here] += values[slot]
                    put_vectors(objective["adjoints"], first, flat)
            if observed.impulses is not None:
                impulses, workers = observed.impulses[slot].ravel(), self.batch.workers
                for at in workers[workers[:, Worker.SCENE] == index, Worker.IMPULSE].tolist():
                    objective["impulse_adjoints"][at : at + len(impulses)] += impulses
