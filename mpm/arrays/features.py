"""What the scenes of a batch need: the kernels are compiled for exactly this."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

from datasets.geometry.placement import remembers_gaps
from datasets.material import Material
from datasets.records import Record
from datasets.scene import Scene
from mpm.arrays.layout import Contact, Precision, Property
from mpm.output.request import ALL, Recording

REGISTER = 64
"""Bytes of a vector of lanes: a register of AVX-512. LLVM computes it in parts where registers are shorter."""


@dataclass(frozen=True, kw_only=True)
class Features(Record):
    """What the scenes of a batch need; the kernels are compiled for exactly this, and nothing else is in them."""

    dimension: int
    precision: Precision
    relaxed: bool = True
    """Velocity that the grid cannot represent decays in a relaxation time (AFLIP); else it is lost each step (APIC)."""
    damped: bool = False
    cohesive: bool = False
    """Strength without pressure: cohesion, and with it a tension cutoff."""
    dilates: bool = False
    softens: bool = False
    """Strength and dilation fall with plastic strain, which is then part of the state."""
    volume_correction: bool = False
    """A particle carries the gap to its neighbours."""
    heterogeneous: bool = False
    """A scene has several materials, or particles of several volumes or frictions."""
    contact: bool = False
    """Solids stand in the box: baffles, ground, obstacles."""
    outflow: bool = False
    """A side of the box lets particles out."""
    velocity_recorded: bool = False
    stress_recorded: bool = False
    pressure_recorded: bool = False
    """Recorded by itself, where the stress is not."""
    strain_recorded: bool = False
    """Plastic strain is summed up and recorded."""
    walls_recorded: bool = False
    """The momentum that floor and walls take is recorded."""
    shared: bool = False
    """One scene, on several threads."""
    gpu: bool = False
    """A thread per particle and atomic sums, for many threads; else a thread per scene or per part of it."""
    barriers: bool = False
    """Masses stand behind barriers until their release."""
    until_rest: bool = False
    """A scene ends when its deposit has come to rest."""
    register: int = REGISTER
    """Bytes of a vector of lanes."""

    _data_oriented: ClassVar[bool] = True
    """Tells Taichi that a kernel may hold it as a Python object of compile time."""

    @property
    def lanes(self) -> int:
        """Particles in a block: what a register holds; one on a GPU."""
        return 1 if self.gpu else self.register // (4 if self.precision == "f32" else 8)

    # The vectors of a block: position from 0, velocity, C row by row, stress, and what only some scenes need.

    @property
    def velocity(self) -> int:
        """First vector of a block that holds velocity."""
        return self.dimension

    @property
    def affine(self) -> int:
        """First of the D x D vectors of APIC's C, row by row."""
        return 2 * self.dimension

    @property
    def stress(self) -> int:
        """First vector of the stress: xx, yy, zz, xy and, in 3D, yz, zx."""
        return self.affine + self.dimension**2

    @property
    def stresses(self) -> int:
        """Components of the stress; 2D is plane strain."""
        return 4 if self.dimension == 2 else 6

    @property
    def plastic_strain(self) -> int:
        """Vector of the plastic strain, where `strained`."""
        return self.stress + self.stresses

    @property
    def strained(self) -> bool:
        """Plastic strain is accumulated."""
        return self.strain_recorded or self.softens

    @property
    def gap(self) -> int:
        """Vector of the mean stress that what opened would have made [Pa], where `volume_correction`."""
        return self.plastic_strain + int(self.strained)

    @property
    def properties(self) -> int:
        """First vector of the material properties, where `heterogeneous`."""
        return self.gap + int(self.volume_correction)

    @property
    def remainder(self) -> int:
        """First of the D vectors of what rounding has kept from the position [m], where `compensated`."""
        return self.properties + (self.columns if self.heterogeneous else 0)

    @property
    def before(self) -> int:
        """First of the D vectors of the velocity at the end of the frame before, where `until_rest`."""
        return self.remainder + (self.dimension if self.compensated else 0)

    @property
    def contacts(self) -> int:
        """First of the vectors that `Contact` lists, where `contact`."""
        return self.before + (self.dimension if self.until_rest else 0)

    @property
    def present(self) -> int:
        """Vector of ones, and of zeros in the lanes that only mirror a scene's last particle."""
        return self.contacts + self.contact_vectors

    @property
    def contact_vectors(self) -> int:
        """How many vectors describe the contact of a block: those of `Contact`, in whose last place n and q stand."""
        return len(Contact) + 2 * self.dimension - 1 if self.contact else 0

    @property
    def columns(self) -> int:
        """How many of the columns of `Property` a particle of its own material carries."""
        return len(Property) if self.softens else int(Property.RESIDUAL_SIN_PHI)

    @property
    def block(self) -> int:
        """Vectors in a block."""
        return self.present + 1

    @property
    def compensated(self) -> bool:
        """Positions are summed with compensation (Kahan 1965): in f32 slow particles far from the origin would rest."""
        return self.precision == "f32"

    @property
    def impulses(self) -> bool:
        """The momentum that solids take is recorded."""
        return self.contact or self.walls_recorded

    # What is recorded of a particle besides its position: velocity, stress or pressure, plastic strain.

    @property
    def recorded_stress(self) -> int:
        """Which of a particle's recorded numbers is the first of its stress, or its pressure."""
        return self.dimension if self.velocity_recorded else 0

    @property
    def recorded_strain(self) -> int:
        """Which of a particle's recorded numbers is its plastic strain."""
        return self.recorded_stress + (self.stresses if self.stress_recorded else int(self.pressure_recorded))

    @property
    def recorded(self) -> int:
        """Numbers that are recorded of a particle besides its position."""
        return self.recorded_strain + int(self.strain_recorded)

    # A face, a line of `faces`: its corners, its normal and those of its corners and, in 3D, edges; friction at each
    # corner, adhesion, number of its solid.

    @property
    def face_normal(self) -> int:
        """Column of a face's normal; those of its D corners and, in 3D, of its 3 edges follow."""
        return self.dimension**2

    @property
    def face_friction(self) -> int:
        """Column of the friction at a face's first corner [-]."""
        return self.face_normal + self.dimension * (1 + self.dimension + (3 if self.dimension == 3 else 0))

    @property
    def face_adhesion(self) -> int:
        """Column of a face's adhesion [Pa]."""
        return self.face_friction + self.dimension

    @property
    def face_solid(self) -> int:
        """Column of the number of a face's solid."""
        return self.face_adhesion + 1

    # A node: momentum, mass and, where forces stay apart, force.

    @property
    def forces(self) -> bool:
        """Nodes hold forces apart from momentum: local damping and AFLIP both need them."""
        return self.damped or self.relaxed

    @property
    def node(self) -> int:
        """Numbers in a node: a short vector, a power of two long."""
        return 8 if self.forces else 4

    @property
    def used(self) -> int:
        """Numbers of a node that mean something; the others stay zero."""
        return self.dimension + 1 + (self.dimension if self.forces else 0)

    @property
    def force(self) -> int:
        """First number of a node that holds force, where `forces`."""
        return self.dimension + 1

    @property
    def change(self) -> int:
        """First number of a node that holds its change of velocity, where `relaxed`; mass and force are done with."""
        return self.force

    # The scratch vectors of a worker: weights of the three nodes along each axis, these times their distances, what a
    # block gives to its nodes, its lowest nodes.

    @property
    def values(self) -> int:
        """First of the scratch vectors of what a block gives: a node's value at the lowest one, and D slopes of it."""
        return 6 * self.dimension

    @property
    def lowest(self) -> int:
        """First of the D scratch vectors that hold each particle's lowest node."""
        return self.values + self.node * (1 + self.dimension)

    @property
    def scratch(self) -> int:
        """Scratch vectors of a worker; after the lowest nodes, velocity of the grid and its change at each particle."""
        return self.push + (2 * self.dimension if self.contact else 0)

    @property
    def push(self) -> int:
        """First of the 2 D scratch vectors of the contact's force per volume and its arm, where `contact`."""
        return self.origin + (self.dimension if self.contact else 0)

    @property
    def origin(self) -> int:
        """First of the D scratch vectors of the positions before a step, where `contact`."""
        return self.density + (1 + self.dimension if self.volume_correction else 0)

    @property
    def density(self) -> int:
        """First of 1 + D scratch vectors: the grid's mass at each particle and its slopes (`volume_correction`)."""
        return self.lowest + self.dimension * (3 if self.relaxed else 1)


class Filled(Protocol):
    """Of the particles of a scene, what decides which kernel is compiled."""

    @property
    def materials(self) -> tuple[Material, ...]:
        """The different materials of the scene."""

    @property
    def common_volume(self) -> float | None:
        """The initial volume [m^D] that all particles have."""

    @property
    def friction_varies(self) -> bool:
        """Whether a field gives the friction of each particle."""


def features_of(
    scenes: Sequence[Scene],
    particles: Sequence[Filled],
    precision: Precision,
    *,
    record: Recording = ALL,
    shared: bool = False,
    gpu: bool = False,
) -> Features:
    """What has to be compiled for these scenes, all of one dimension."""
    materials = [material for each in particles for material in each.materials]
    return Features(
        dimension=scenes[0].dimension,
        precision=precision,
        relaxed=any(scene.relaxation > 0.0 for scene in scenes),
        damped=any(scene.damping > 0.0 for scene in scenes),
        cohesive=any(material.cohesive for material in materials),
        dilates=any(material.dilation_deg > 0.0 for material in materials),
        softens=any(material.softening_length is not None for material in materials),
        volume_correction=any(remembers_gaps(scene) for scene in scenes),
        heterogeneous=any(
            len(each.materials) > 1
            or each.common_volume is None
            or each.friction_varies
            or any(material.strength_gradient > 0.0 for material in each.materials)
            for each in particles
        ),
        contact=any(scene.baffles or scene.solids for scene in scenes),
        outflow=any(scene.open_sides for scene in scenes),
        velocity_recorded="velocity" in record.fields,
        stress_recorded="stress" in record.fields,
        pressure_recorded="pressure" in record.fields and "stress" not in record.fields,
        strain_recorded="plastic_strain" in record.fields,
        walls_recorded=record.wall_forces,
        barriers=any(mass.release is not None for scene in scenes for mass in scene.masses),
        until_rest=record.until_rest,
        shared=shared,
        gpu=gpu,
        register=REGISTER,
    )
