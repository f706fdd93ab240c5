"""What the scenes of a batch need: the kernels are compiled for exactly this."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Any, ClassVar

from datasets.errors import require
from datasets.field import FRICTION
from datasets.geometry.placement import remembers_gaps
from datasets.material import MOHR_COULOMB
from datasets.particles import mass_particle_volumes, particle_count
from datasets.records import Record
from datasets.scene import Scene
from mpm.arrays.layout import Contact, Precision
from mpm.laws import law_named, law_of
from mpm.output.request import ALL, Recording

REGISTER = 128
"""Bytes of a vector of lanes: two registers of AVX-512, so that one is computed while the other waits for a root."""

PREFETCHED = 50_000
"""Particles of a scene in 3D from which they are read ahead: its state is beyond the cache. In 2D that does not pay."""


@dataclass(frozen=True, kw_only=True)
class Features(Record):
    """What the scenes of a batch need; nothing else is in their kernels."""

    dimension: int
    precision: Precision
    law_name: str = MOHR_COULOMB
    """Of strength: the name of one in `mpm.laws`."""
    damped: bool = False
    cohesive: bool = False
    """Strength without pressure: cohesion, and with it a tension cutoff."""
    dilates: bool = False
    softens: bool = False
    """Strength depends on the plastic strain, which is then part of the state."""
    inertial: bool = False
    """Friction grows with the inertial number (`mpm.physics.inertial`)."""
    volume_correction: bool = False
    """A particle carries the gap to its neighbours."""
    heterogeneous: bool = False
    """A scene has several materials, or particles of several volumes or frictions."""
    contact: bool = False
    """Solids stand in the box: baffles, ground, obstacles."""
    channel: bool = False
    """Side walls of a scene in 2D brake it (`mpm.physics.channel`)."""
    outflow: bool = False
    """A side of the box lets particles out."""
    strain_recorded: bool = False
    """Plastic strain is summed up, to be recorded."""
    walls_recorded: bool = False
    """The momentum that floor and walls take is recorded."""
    shared: bool = False
    """One scene, on several threads."""
    prefetch: bool = False
    """The next block of particles is read ahead of its turn."""
    gpu: bool = False
    """A thread per particle and atomic sums, for many threads; else a thread per scene or per part of it."""
    barriers: bool = False
    """Masses stand behind barriers until their release."""
    gates: bool = False
    """Barriers rise when they open."""
    until_rest: bool = False
    """A scene ends when its deposit has come to rest."""

    node: ClassVar[int] = 8
    """Numbers in a node, momentum, mass and force: a short vector, a power of two long."""
    _data_oriented: ClassVar[bool] = True
    """Tells Taichi that a kernel may hold it as a Python object of compile time."""

    @property
    def law(self) -> Any:
        """The module of its law."""
        return law_named(self.law_name)

    @property
    def lanes(self) -> int:
        """Particles in a block: what REGISTER bytes hold; one on a GPU."""
        return 1 if self.gpu else REGISTER // (4 if self.precision == "f32" else 8)

    @property
    def stresses(self) -> int:
        """Components of the stress: xx, yy, zz, xy and, in 3D, yz, zx; 2D is plane strain."""
        return 4 if self.dimension == 2 else 6

    @property
    def cracks(self) -> bool:
        """Whether cracks count as plastic strain (`mpm.physics.stress.stress_step`)."""
        return self.volume_correction and self.cohesive and self.strained

    @property
    def strained(self) -> bool:
        """Plastic strain is accumulated."""
        return self.strain_recorded or self.softens

    @property
    def contact_vectors(self) -> int:
        """How many vectors describe the contact of a block: those of `Contact`, in whose last place n and q stand."""
        return len(Contact) + 2 * self.dimension - 1 if self.contact else 0

    @property
    def columns(self) -> int:
        """How many properties a particle of its own material carries: up to the last that the law reads."""
        return 1 + int(max(self.law.columns(self)))

    @property
    def compensated(self) -> bool:
        """Positions are summed with compensation (Kahan 1965): in f32 slow particles far from the origin would rest."""
        return self.precision == "f32"

    @property
    def impulses(self) -> bool:
        """The momentum that solids take is recorded."""
        return self.contact or self.walls_recorded

    def __getattr__(self, name: str) -> int:
        """Where the part `name` begins of a block, a face, a node or the scratch; see `parts`."""
        return offset(parts, self, name)


def parts(features: Features) -> list[dict[str, int]]:
    """How long the parts are of what the kernels read, in their order; one that a kernel does without has length 0."""
    size, contact = features.dimension, int(features.contact)
    return [
        {  # Vectors of a block of particles; `present` is 1, and 0 in lanes that only mirror a scene's last particle.
            "position": size,
            "velocity": size,
            "affine": size**2,  # APIC's C, row by row
            "stress": features.stresses,
            "plastic_strain": int(features.strained),
            "gap": int(features.volume_correction),  # mean stress that what opened would have made [Pa]
            "contacts": features.contact_vectors,
            "present": 1,
            "properties": features.columns if features.heterogeneous else 0,
            "remainder": size if features.compensated else 0,  # what rounding has kept from the position [m]
            "before": size if features.until_rest else 0,  # the velocity at the end of the frame before
            "block": 0,
        },
        {  # Columns of a face: its corners, its normal and those of its corners and, in 3D, edges, ...
            "face_corners": size**2,
            "face_normal": size * (1 + size + (3 if size == 3 else 0)),
            "face_friction": size,  # at each corner [-]
            "face_solid": 1,  # its number
            "face_columns": 0,
        },
        {  # Numbers of a node; the others stay zero.
            "momentum": size,
            "mass": 1,
            "force": size,
            "side_friction": int(features.channel),
            "used": 0,
        },
        # The change of a node's velocity stands in place of its force, which is done with.
        {"momentum_and_mass": size + 1, "change": 0},
        {  # Scratch vectors of a worker.
            "weights": 3 * size,  # of the three nodes along each axis,
            "levers": 3 * size,  # and these times their distances
            "values": features.node * (1 + size),  # what a block gives: a node's value at the lowest one, and D slopes
            "ahead": int(features.prefetch),  # what was read of the next block
            "lowest": 3 * size,  # each particle's lowest node, the grid's velocity at it and its change
            "density": 1 + size if features.volume_correction else 0,  # the grid's mass at each particle, its slopes
            "gradient": size**2 if features.volume_correction else 0,  # of the grid's velocity at each particle
            "changes": size**2 if features.volume_correction else 0,  # of its change
            "origin": size * contact,  # the positions before a step
            "push": 2 * size * contact,  # the contact's force per volume and its arm
            "scratch": 0,
        },
    ]


def offset(parts: Callable[[Features], list[dict[str, int]]], features: Features, name: str) -> int:
    """Where one of the `parts` begins. Raises AttributeError for another name."""
    found = None if name.startswith("_") else begins(parts, features).get(name)
    if found is None:
        raise AttributeError(name)
    return found


@cache
def begins(parts: Callable[[Features], list[dict[str, int]]], features: Features) -> dict[str, int]:
    """Where parts of given lengths begin in their group; the last of one has none and says how long the group is."""
    found: dict[str, int] = {}
    for group in parts(features):
        found |= dict(zip(group, accumulate(group.values(), initial=0), strict=False))
    return found


def features_of(
    scenes: Sequence[Scene], precision: Precision, *, record: Recording = ALL, shared: bool = False, gpu: bool = False
) -> Features:
    """What has to be compiled for these scenes, all of one dimension."""
    materials = [scene.material_of(mass) for scene in scenes for mass in scene.masses]
    law = law_of(materials)
    asked = any(scene.volume_correction for scene in scenes)
    require(law.OPENS or not asked, "volume_correction", "none of a material that does not open", "true")
    stages = [stage for scene in scenes for stage in scene.stages]
    return Features(
        dimension=scenes[0].dimension,
        precision=precision,
        damped=any(scene.damping > 0.0 for scene in scenes),
        law_name=materials[0].law,
        **law.features(materials, stages),
        volume_correction=law.OPENS and any(remembers_gaps(scene) for scene in scenes),
        heterogeneous=any(varies(scene) for scene in scenes),
        contact=any(scene.baffles or scene.solids for scene in scenes),
        channel=any(scene.channel is not None for scene in scenes),
        outflow=any(scene.open_sides for scene in scenes),
        strain_recorded=record.fields,
        walls_recorded=record.wall_forces,
        barriers=any(mass.release is not None for scene in scenes for mass in scene.masses),
        gates=any(mass.gate is not None for scene in scenes for mass in scene.masses),
        until_rest=record.until_rest,
        shared=shared,
        prefetch=not gpu and any(s.dimension == 3 and particle_count(s) >= PREFETCHED for s in scenes),
        gpu=gpu,
    )


def varies(scene: Scene) -> bool:
    """Whether a scene has several materials or stages, or particles of several volumes, frictions or strengths."""
    materials = {scene.material_of(mass) for mass in scene.masses}
    return (
        len(materials) > 1
        or len(scene.stages) > 0
        or len(set(mass_particle_volumes(scene).tolist())) > 1
        or any(field.quantity == FRICTION for field in scene.fields)
        or any(material.strength_gradient > 0.0 for material in materials)
    )
