"""Gradients of an objective of the flow with respect to all initial numbers of a run.

    objective(positions, velocities) -> J, dJ/d(positions), dJ/d(velocities)
    J, slope = gradient(scene, objective)
    slope.velocities                    # dJ/d(initial velocity) of every particle, shape [N, D]
    slope.of_mass(slope.velocities)     # and of every body, shape [masses, D]
    slope.material("friction_deg")      # of every particle, shape [N]
    slope.setting("floor_friction")     # of the scene
    slope.along(scene_at, 0.0)          # along any path of scenes, scene_at(t)

The kernel's own adjoints are exact. The steps before the kernel, from Young's modulus to Lame's constants or from a
tilt to gravity, are closed forms of a few numbers; their derivatives are central differences of these forms alone.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.geometry.contact_surface import contact_surface_of
from datasets.geometry.surface import solids_of
from datasets.scene import Scene
from datasets.scene.material import Material
from datasets.scene.particles import Particles, initial_particles
from mpm.adjoint.tape import FlowAdjoints, Tape
from mpm.arrays.features import drags_of
from mpm.arrays.layout import Property
from mpm.arrays.properties import IN_FLIGHT, initial_gaps, properties_at, properties_of, roughest, settings_row
from mpm.initial.slope import begins_as_slope
from mpm.initial.stress import initial_tractions
from mpm.solids.obstacles import face_lines, farthest, holds_at, limited, obstacles_in

Floats = NDArray[np.float64]

Objective = Callable[[Floats, Floats], tuple[float, Floats, "Floats | None"]]
"""Function of positions [m] and velocities [m/s] at the observed frames, shape [T, N, D] each: the value, and its
derivatives with respect to both; None if it does not depend on velocity."""

STEP = 1.0e-5  # relative step of the differences of closed forms


@dataclass(frozen=True, kw_only=True, eq=False)
class RunNumbers:
    """The initial numbers of a run of a scene, or the derivatives of an objective J with respect to each of them; N
    particles, D dimensions."""

    scene: Scene
    particles: Particles
    positions: Floats
    """Positions of the particles [m], shape [N, D]."""
    velocities: Floats
    """[m/s], shape [N, D]."""
    velocity_gradients: Floats
    """[1/s], shape [N, D, D]."""
    stress: Floats
    """xx, yy, zz, xy, yz, zx [Pa], shape [N, 4 or 6]."""
    properties: Floats
    """`mpm.arrays.layout.Property` of every particle and the columns of its law, shape [N, columns]; in a derivative
    the first ones, which the kernel reads."""
    settings: Floats
    """`mpm.arrays.layout.Setting`, shape [len(Setting)]."""
    faces: Floats
    """Faces of solids, `mpm.solids.obstacles.Obstacles.faces`, shape [F, columns]; no rows without solids."""
    holds: Floats
    """Holds of nodes deep in solids, `mpm.solids.obstacles.Obstacles.holds`, shape [K, 3]."""
    terrain: Floats
    """The friction at the posts of a terrain in 3D, or the uniform one, shape [P]; empty without terrain."""
    drags: Floats
    """g / xi of each solid [1/m], 0 for those without `turbulence`, shape [solids]."""

    def in_a_row(self, columns: int) -> Floats:
        """All numbers in one row, with so many columns of the properties."""
        parts = vars(self) | {"properties": self.properties[:, :columns]}
        return np.concatenate([parts[field.name].ravel() for field in dataclasses.fields(RunNumbers)[2:]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradient(RunNumbers):
    """Derivatives of an objective J."""

    cut: float
    """Share of the adjoints of all particles and steps that were cut (`mpm.adjoint.tape.CUT`); 0 where it is exact."""

    def of_mass(self, values: Floats) -> Floats:
        """Values of particles, summed over those of each mass, shape [masses, ...]."""
        sums = np.zeros((len(self.scene.masses), *values.shape[1:]))
        np.add.at(sums, self.particles.mass, values)
        return sums

    def material(self, name: str) -> Floats:
        """dJ/d(constant `name` of the material) of every particle, as if each had its own, shape [N].

        `friction_deg` is taken at the angle of each particle if a field of the scene gives it. Raises InputError for a
        constant of cohesion if a material has none."""
        derivatives = np.zeros(len(self.positions))
        for index, material in enumerate(self.particles.materials):
            if name in ("cohesion", "tension_cutoff", "strength_gradient") and not material.cohesive:
                reason = f"a run without any does not depend on {name}"
                raise InputError(f"expected a material with cohesion, {reason}", key=name)
            here = self.particles.material == index
            depth, angles = self.particles.depth[here], self.particles.friction_deg
            friction_deg = None if angles is None else angles[here]
            varies = name == "friction_deg" and friction_deg is not None
            at, step = (0.0, STEP * material.friction_deg) if varies else (material.constant(name), None)
            rows = differences(partial(rows_at, material, depth, friction_deg, name), at, name, step)
            rows = rows[:, : self.properties.shape[1]]
            # The volume goes with the particle's initial position, not with its material.
            rows[:, Property.VOLUME] = 0.0
            derivatives[here] = (self.properties[here] * rows).sum(axis=1)
        return derivatives

    def setting(self, name: str) -> float:
        """dJ/d(number `name` of the scene): floor_friction, wall_friction, damping, gravity, slope_deg, ..."""
        at = getattr(self.scene, name)
        if isinstance(at, str):
            raise InputError(f"expected a number that has a derivative, got {at!r}", key=name)
        return self.along(lambda value: dataclasses.replace(self.scene, **{name: value}), at)  # type: ignore[arg-type]

    def along(self, scene_at: Callable[[float], Scene], at: float, step: float | None = None) -> float:
        """dJ/dt of scenes `scene_at(t)` at t = `at`, where it is this scene. Raises InputError for other particles."""
        return float(self.products(self.slopes(scene_at, at, step)).sum())

    def shared(self, slopes: Floats) -> tuple[Floats, Floats]:
        """The contributions to `along` of each particle, shape [N], and of each post of the terrain, shape [P].

        For a path along which a field changes everywhere, with its `slopes`, these are the derivatives with respect to
        the value of the field at each particle and each post."""
        names = [field.name for field in dataclasses.fields(RunNumbers)[2:]]
        ends, count = np.cumsum([vars(self)[name].size for name in names]), len(self.positions)
        parts = dict(zip(names, np.split(self.products(slopes), ends[:-1]), strict=True))
        of_particles = names[: names.index("settings")]
        return sum(parts[name].reshape(count, -1).sum(axis=1) for name in of_particles), parts["terrain"]

    def slopes(self, scene_at: Callable[[float], Scene], at: float, step: float | None = None) -> Floats:
        """Derivatives of the initial numbers along a path of scenes, in the order of `in_a_row`; of no objective."""
        columns = self.properties.shape[1]

        def numbers_at(value: float) -> Floats:
            return started(scene_at(value), self.start).in_a_row(columns)

        return np.asarray(differences(numbers_at, at, "the path", step))

    def products(self, slopes: Floats) -> Floats:
        """Terms of dJ/dt with the slopes of a path, one for each number in the order of `in_a_row`."""
        adj = self.in_a_row(self.properties.shape[1])
        # Numbers without effect on J may be infinite, such as the rate of an instantaneous relaxation.
        return np.multiply(adj, slopes, out=np.zeros_like(adj), where=(adj != 0.0) & (slopes != 0.0))

    @cached_property
    def start(self) -> "Start":
        """The start that runs along paths of scenes through this one share."""
        return started(self.scene)


@dataclass(frozen=True, kw_only=True, eq=False)
class Start(RunNumbers):
    """The initial numbers of a run of a scene."""

    held: NDArray[np.int64]
    """The node of each of the `holds`, by its indices, shape [K, D]."""


def rows_at(material: Material, depth: Floats, friction_deg: Floats | None, name: str, value: float) -> Floats:
    """`properties_at` with a constant of the material at `value`; given angles of particles increase by it."""
    if name == "friction_deg" and friction_deg is not None:
        return properties_at(material, depth, friction_deg + value)
    return properties_at(material.with_constant(name, value), depth, friction_deg)


def started(scene: Scene, base: Start | None = None) -> Start:
    """The initial numbers of a run of `scene`; those that it shares with `base` are not computed again.

    Raises InputError if the scenes have different numbers of particles or faces."""
    if base is None:
        particles, solids = initial_particles(scene), obstacles_in(scene)
        stress, properties = initial_tractions(scene, particles)[0], properties_of(particles)
        faces, holds, terrain = solids.faces, solids.holds, solids.frictions[0].ravel()
        held = solids.windows[0].nodes(np.repeat(np.arange(len(solids.node_holds) - 1), np.diff(solids.node_holds)))
    else:
        particles, properties = particles_with(scene, base)
        stress, faces, holds, terrain, held = base.stress, base.faces, base.holds, base.terrain, base.held
        if stress.any() or any(mass.k0 is not None or begins_as_slope(scene, mass) for mass in scene.masses):
            stress = initial_tractions(scene, particles)[0]
        if len(faces) + len(terrain) and solids_with(scene) != solids_with(base.scene):
            faces, holds, terrain = faces_and_holds(scene, held, holds)
        if varied_turbulence(scene) != varied_turbulence(base.scene):
            raise InputError("expected the same turbulence at all posts of a terrain, it has no derivative")
        if len(particles.positions) != len(base.particles.positions):
            raise InputError("expected scenes with as many particles, a change of their number has no derivative")
        if faces.shape != base.faces.shape or terrain.shape != base.terrain.shape:
            raise InputError("expected solids with as many faces, a change of their number has no derivative")
    return Start(
        scene=scene,
        particles=particles,
        positions=particles.positions,
        velocities=particles.velocities,
        velocity_gradients=particles.velocity_gradients,
        stress=stress,
        properties=properties,
        settings=np.array(settings_row(scene, particles)),
        faces=faces,
        holds=holds,
        held=held,
        terrain=terrain,
        drags=np.array(drags_of(scene)),
    )


def varied_turbulence(scene: Scene) -> list[Any]:
    """The non-numeric settings of the solids, which have no derivative."""
    return [solid.turbulence for solid in scene.solids if isinstance(solid.turbulence, tuple)]


def solids_with(scene: Scene) -> tuple[Any, ...]:
    """All inputs of the faces and the holds of a scene."""
    return scene.domain, solids_of(scene), farthest(scene), roughest(scene)


def faces_and_holds(scene: Scene, nodes: NDArray[np.int64], base: Floats) -> tuple[Floats, Floats, Floats]:
    """Faces of the solids of a scene, its holds in the order of `base` [K, 3], which belong to `nodes` [K, D], and the
    friction of its terrain, [P].

    A hold that the scene does not have gets a share of zero. Other data of solids for the kernel are not made."""
    surface, holds = contact_surface_of(scene), base.copy()
    holds[:, 2] = 0.0
    if surface is None:
        return np.zeros((0, 0)), holds, np.zeros(0)
    field = surface.field
    terrain = np.zeros(0) if field is None else np.minimum(field.friction, roughest(scene)).ravel()
    lines = face_lines(limited(surface.faces, roughest(scene)))
    if not len(nodes):
        return lines, holds, terrain
    window, first, ours, _ = holds_at(scene, surface, np.unique(nodes, axis=0))
    owners, count = np.repeat(np.arange(len(first) - 1), np.diff(first)), int(max(base[:, 0].max(), *ours[:, 0], 0)) + 1
    rows = (window.numbers(nodes), base), (owners, ours)
    keys, our_keys = (node * count + hold_rows[:, 0].astype(np.int64) for node, hold_rows in rows)
    _, at, our_at = np.intersect1d(keys, our_keys, assume_unique=True, return_indices=True)
    holds[at] = ours[our_at]
    return lines, holds, terrain


def particles_with(scene: Scene, base: Start) -> tuple[Particles, Floats]:
    """The particles of a scene and their properties; they take their places from `base` if these are the same."""
    if placement(scene) != placement(base.scene):
        particles = initial_particles(scene)
        return particles, properties_of(particles)
    soils, base_soils = ([version.material_of(mass) for mass in version.masses] for version in (scene, base.scene))
    materials = {material: number for number, material in enumerate(dict.fromkeys(soils))}
    numbers = np.array([materials[material] for material in soils], np.int32)[base.particles.mass]
    particles = dataclasses.replace(base.particles, materials=tuple(materials), material=numbers)
    properties = base.properties.copy()
    for mass in np.flatnonzero([ours != theirs for ours, theirs in zip(soils, base_soils, strict=True)]):
        here = particles.mass == mass
        properties[here] = properties_at(soils[mass], particles.depth[here])
        properties[here, Property.VOLUME] = particles.volume[here]
    return particles, properties


def placement(scene: Scene) -> tuple[Any, ...]:
    """All inputs of the places, velocities and volumes of a scene's particles, and what its fields vary."""
    others = dict.fromkeys(("material", "k0", "release", "gate"))
    masses = [vars(mass) | others for mass in scene.masses]
    ground = scene.solids if any(mass.kind == "layer" for mass in scene.masses) else ()
    varied = (scene.fields, scene.material, scene.masses) if scene.fields else ()
    return scene.domain, scene.seed, scene.jitter, scene.particles_per_axis, masses, ground, varied


def differences(function: Callable[[float], Any], at: float, name: str, step: float | None = None) -> Any:
    """Derivative of a closed form at a value by a central difference, or a one-sided one at the end of its range."""
    step = STEP * (abs(at) or 1.0) if step is None else step
    with np.errstate(invalid="ignore"):
        try:
            return (function(at + step) - function(at - step)) / (2.0 * step)
        except InputError:
            pass
        try:
            # One-sided, of second order.
            return (4.0 * function(at + step) - function(at + 2.0 * step) - 3.0 * function(at)) / (2.0 * step)
        except InputError as error:
            raise InputError(f"expected a value of {name} inside its range, got {at:g}: {error}") from None


def gradient(
    scene: Scene, objective: Objective, frames: Sequence[int] | None = None, **options: Any
) -> tuple[float, Gradient]:
    """Value and gradient of an objective that sees `frames`, the last unless given; options and errors are `Tape`'s."""
    tape = Tape([scene], [scene.frames - 1] if frames is None else frames, **options)
    value, positions, velocities = objective(tape.positions(), tape.velocities())
    ((slope,),) = pull_back_all(tape, [[FlowAdjoints(positions, velocities)]])
    return value, slope


def pull_back_all(tape: Tape, adjoints: Sequence[Sequence[FlowAdjoints]]) -> list[list[Gradient]]:
    """Vector-Jacobian products: the gradient of each objective and scene of a tape, from the adjoints of each flow."""
    scenes = range(len(tape.batch.scenes))
    return [[gradient_of(tape, index, adj) for index in scenes] for adj in tape.reverse(adjoints)]


def gradient_of(tape: Tape, index: int, adj: dict[str, Any]) -> Gradient:
    """The gradient of scene `index` from the result of `Tape.reverse` for an objective."""
    scene, features, size = tape.batch.scenes[index], tape.features, tape.features.dimension
    here, (faces, nodes) = tape.particles(index), tape.solids(index)

    def numbers(first: int, count: int) -> Floats:
        return tape.vectors(adj["adjoints"], first, count)[here].astype(np.float64)

    particles, properties = tape.batch.particles[index], numbers(features.state.properties, features.columns)
    if features.volume_correction:
        # The initial gap of a body in flight is proportional to its bulk modulus.
        opened = IN_FLIGHT * (initial_gaps(scene, particles) > 0.0) * numbers(features.state.gap, 1)
        properties[:, [Property.LAME, Property.SHEAR]] += opened * (1.0, 2.0 / 3.0)
    return Gradient(
        scene=scene,
        particles=particles,
        positions=numbers(0, size),
        velocities=numbers(features.state.velocity, size),
        velocity_gradients=numbers(features.state.affine, size * size).reshape(-1, size, size),
        stress=numbers(features.state.stress, features.stresses),
        properties=properties,
        settings=adj["settings"][index].copy(),
        faces=adj["face_adjoints"][faces],
        cut=float(adj["cut"][index]),
        holds=adj["hold_adjoints"][nodes],
        terrain=tape.of_posts(index, adj["terrain_adjoints"][index]),
        drags=adj["drag_adjoints"][index, : len(drags_of(scene))],
    )
