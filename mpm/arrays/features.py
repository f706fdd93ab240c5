"""The features that the scenes of a batch need: the kernels are compiled for exactly these."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, ClassVar

from datasets.errors import require
from datasets.geometry.contact_surface import has_faces, has_field
from datasets.geometry.placement import remembers_gaps
from datasets.scene import INFLOW, Scene
from datasets.scene.grid_field import FRICTION
from datasets.scene.material import MOHR_COULOMB
from datasets.scene.particles import mass_particle_volumes, volume_shares
from mpm.arrays.layout import Contact, Precision
from mpm.laws import law_named, law_of
from mpm.output.recording import ALL, Recording

REGISTER = 128  # bytes of a vector of lanes: two AVX-512 registers; one computes while the other waits for a root

NODE = 8  # numbers in a node, momentum, mass and force: a short vector, a power of two long


class Addresses:
    """Start of each of several consecutive parts of given lengths, by name; `size`: end of the last.

    A part that the kernels do not need has length 0."""

    _data_oriented = True  # tells Taichi that a kernel may hold it as a compile-time Python object

    def __init__(self, **lengths: int) -> None:
        vars(self).update(zip((*lengths, "size"), accumulate(lengths.values(), initial=0), strict=True))

    def __getattr__(self, name: str) -> int:
        raise AttributeError(name)


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What is recorded besides positions and energies."""

    strain: bool = False  # plastic strain is summed up
    walls: bool = False  # the momentum that floor and walls take
    until_rest: bool = False  # a scene ends when its deposit has come to rest


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """The kind of processor."""

    gpu: bool = False  # a thread per particle and atomic sums; else a thread per scene or per part of it
    shared: bool = False  # one scene, on several threads


@dataclass(frozen=True, kw_only=True)
class Features:
    """The features that the scenes of a batch need; `state`, `face`, `node` and `scratch` are addresses."""

    dimension: int
    precision: Precision
    law_name: str = MOHR_COULOMB  # name of the law of strength, in `mpm.laws`
    cohesive: bool = False  # strength at zero pressure: cohesion, and with it a tension cutoff
    dilates: bool = False
    softens: bool = False  # strength depends on the plastic strain, which is then part of the state
    inertial: bool = False  # friction grows with the inertial number (`mpm.physics.inertial`)
    heterogeneous: bool = False  # a scene has several materials, or particles of several frictions or strengths
    uneven: bool = False  # a scene has particles of several volumes
    volume_correction: bool = False  # a particle carries the gap to its neighbours
    damped: bool = False
    listed: bool = False  # solids have listed faces
    terrain: bool = False  # a terrain is a smooth bed (`mpm.solids.terrain`)
    contact: bool = False  # there are solids in the box: baffles, ground, obstacles
    turbulent: bool = False  # solids brake with the square of the speed (`mpm.physics.contact`)
    channel: bool = False  # side walls of a scene in 2D brake it (`mpm.physics.channel`)
    outflow: bool = False  # a side of the box is open, or particles have not entered yet
    inflow: bool = False  # particles enter over time (`mpm.physics.inflow`)
    wet: bool = False  # water fills the pores of a material (`mpm.physics.water`)
    seeps: bool = False  # water exerts a given force on each particle (`mpm.initial.water`)
    barriers: bool = False  # masses stand behind barriers until their release
    gates: bool = False  # barriers rise when they open
    recorded: Recorded = Recorded()
    processor: Hardware = Hardware()

    _data_oriented: ClassVar[bool] = True  # as of `Addresses`

    @property
    def law(self) -> Any:
        """The module of its law."""
        return law_named(self.law_name)

    @property
    def lanes(self) -> int:
        """Particles in a block: what REGISTER bytes hold; one on a GPU."""
        return 1 if self.processor.gpu else REGISTER // (4 if self.precision == "f32" else 8)

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
        return self.recorded.strain or self.softens

    @property
    def contact_vectors(self) -> int:
        """Number of vectors that describe the contact of a block: those of `Contact`, the last being n and q."""
        return len(Contact) + 2 * self.dimension - 1 if self.contact else 0

    @property
    def pores(self) -> bool:
        """Pore pressure is part of the state."""
        return self.wet or self.seeps

    @property
    def columns(self) -> int:
        """Number of properties that a particle carries if materials differ: up to the last that the law reads."""
        return 1 + int(max(self.law.columns(self)))

    @property
    def own_columns(self) -> int:
        """Number of properties that each particle carries; if they differ in volume alone, that is the first one."""
        return self.columns if self.heterogeneous else int(self.uneven)

    @property
    def compensated(self) -> bool:
        """Positions are summed with compensation (Kahan 1965): in f32 slow particles far from the origin would rest."""
        return self.precision == "f32"

    @property
    def impulses(self) -> bool:
        """The momentum that solids take is recorded."""
        return self.contact or self.recorded.walls

    @cached_property
    def state(self) -> Addresses:
        """Vectors of a block of particles."""
        size = self.dimension
        return Addresses(
            position=size,
            velocity=size,
            affine=size**2,  # APIC's C, row by row
            stress=self.stresses,
            plastic_strain=int(self.strained),
            gap=int(self.volume_correction),  # mean stress that the opening would have caused [Pa]
            contacts=self.contact_vectors,
            present=1,  # 0 in lanes that mirror a scene's last particle, and for those that have left or not entered
            properties=self.own_columns,
            remainder=size if self.compensated else 0,  # rounding error of the position [m]
            before=size if self.recorded.until_rest else 0,  # the velocity at the end of the frame before
            entry=(1 + size) * int(self.inflow),  # frames to wait, 0 after entry; velocity at entry
            seepage=size * int(self.seeps),  # force of water per volume [N/m^3]
            pore_pressure=int(self.pores),  # [Pa]
            saturated=int(self.wet),  # 1 where water fills the pores, else 0
            volume_strain=int(self.wet),  # of a step [-]
            pressure_slope=size * int(self.wet),  # of the pressure in space [Pa/m]
        )

    @cached_property
    def face(self) -> Addresses:
        """Columns of a face."""
        size = self.dimension
        return Addresses(
            corners=size**2,
            normal=size * (1 + size + (3 if size == 3 else 0)),  # of the face, its corners and, in 3D, its edges
            friction=size,  # at each corner [-]
            solid=1,  # its number
        )

    @cached_property
    def node(self) -> Addresses:
        """The used numbers of a node, out of NODE; the others stay zero."""
        size, braked = self.dimension, int(self.channel)
        # The change of a node's velocity replaces its force, which is no longer needed. Last the sum of w m d / h
        # (`mpm.physics.contact`).
        dragged = int(self.turbulent)
        return Addresses(momentum=size, mass=1, change=0, force=size, side_friction=braked, distance=dragged)

    @property
    def not_given(self) -> list[int]:
        """Numbers of value and slopes that no particle contributes: absent ones, slopes but of momentum and force."""
        given = {k for k in range(2 * self.dimension + 1) if k != self.node.mass}
        return [k for k in range(4 * NODE) if (k % NODE not in given if k >= NODE else k >= self.node.size)]

    @cached_property
    def scratch(self) -> Addresses:
        """Vectors of a worker's scratch."""
        size = self.dimension
        corrected, contact = int(self.volume_correction), int(self.contact)
        return Addresses(
            weights=3 * size,  # of the three nodes along each axis,
            levers=3 * size,  # and these times their distances
            values=4 * NODE,  # contribution of a block: value at the lowest node and D slopes; then its gathered sums
            rows=0 if self.processor.gpu else 4 * NODE,  # the same, of one particle after the other
            lowest=3 * size,  # each particle's lowest node, the grid's velocity at it and its change
            density=(1 + size) * corrected,  # the grid's mass at each particle, and its slopes
            gradient=size**2 * corrected,  # of the grid's velocity at each particle
            changes=size**2 * corrected,  # of its change
            origin=size * contact,  # the positions before a step
            push=2 * size * contact,  # the contact's force per volume and its arm
            drag=int(self.turbulent),  # g / xi of the solid next to each particle [1/m]
            layer=2 * int(self.turbulent),  # mass around each particle and its sum times distances from solids
            bed=10 * int(self.terrain),  # nine elevations around each particle, and the friction there
        )


def features_of(
    scenes: Sequence[Scene], precision: Precision, *, record: Recording = ALL, shared: bool = False, gpu: bool = False
) -> Features:
    """The features to compile for these scenes, all of one dimension."""
    materials = [scene.material_of(mass) for scene in scenes for mass in scene.masses]
    law = law_of(materials)
    asked = any(scene.volume_correction for scene in scenes)
    require(law.OPENS or not asked, "volume_correction", "false or none with a law without gaps", "true")
    stages = [stage for scene in scenes for stage in scene.stages]
    inflow = any(mass.kind == INFLOW for scene in scenes for mass in scene.masses)
    seeps = any(scene.water is not None and scene.water.fixed for scene in scenes)
    wet = any(material.saturated for material in materials) and not seeps
    pool = any(scene.water is not None and scene.water.pool is not None for scene in scenes)
    require(seeps or not pool, "water.pool", "none in a flow: only --safety supports water above the ground", "one")
    require(not (wet and gpu), "material.saturated", "false on a GPU, which does not support pore water yet", "true")
    return Features(
        dimension=scenes[0].dimension,
        precision=precision,
        damped=any(scene.damping > 0.0 for scene in scenes),
        law_name=materials[0].law,
        **law.features(materials, stages),
        volume_correction=law.OPENS and (wet or any(remembers_gaps(scene) for scene in scenes)),
        heterogeneous=any(varies(scene) for scene in scenes),
        uneven=any(has_uneven_particles(scene) for scene in scenes),
        contact=any(scene.baffles or scene.solids for scene in scenes),
        listed=any(has_faces(scene) for scene in scenes),
        terrain=any(has_field(scene) for scene in scenes),
        turbulent=any(any(drags_of(scene)) for scene in scenes),
        channel=any(scene.channel is not None for scene in scenes),
        outflow=any(scene.open_sides for scene in scenes) or inflow,
        inflow=inflow,
        wet=wet,
        seeps=seeps,
        barriers=any(mass.release is not None for scene in scenes for mass in scene.masses),
        gates=any(mass.gate is not None for scene in scenes for mass in scene.masses),
        recorded=Recorded(strain=record.fields, walls=record.wall_forces, until_rest=record.until_rest),
        processor=Hardware(gpu=gpu, shared=shared),
    )


def drags_of(scene: Scene) -> list[float]:
    """g / xi [1/m] of each solid of a scene, in the order of their numbers; 0 for those without `turbulence`, and g
    alone [m/s^2] for those whose xi varies (`drag_tables`)."""
    coefficients = [*(baffle.turbulence for baffle in scene.baffles), *(solid.turbulence for solid in scene.solids)]
    fixed = [1.0 if isinstance(xi, tuple) else xi for xi in coefficients]
    return [0.0 if xi is None else scene.gravity / xi for xi in fixed]


def varies(scene: Scene) -> bool:
    """Whether a scene has several materials or stages, or particles of several frictions or strengths."""
    materials = {scene.material_of(mass) for mass in scene.masses}
    return (
        len(materials) > 1
        or len(scene.stages) > 0
        or any(field.quantity == FRICTION for field in scene.fields)
        or any(material.strength_gradient > 0.0 for material in materials)
    )


def has_uneven_particles(scene: Scene) -> bool:
    """Whether a scene has particles of several volumes."""
    shares = volume_shares(scene)
    return len({*mass_particle_volumes(scene).tolist()}) > 1 or any(len(uneven) > 1 for uneven in shares)
