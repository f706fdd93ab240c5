"""The initial stress of masses: geostatic or elastic, in equilibrium with gravity on the grid itself.

docs/theory/initial-stress.md gives the method and its sources: a first guess, geostatic (tension positive, y normal to
the floor) or that of an infinite slope (`mpm.initial.slope`), and its correction within yield. The smallest change of
stress, in elastic energy, that restores equilibrium derives from nodal displacements u through the kernel's gradient,

    C_p = (4 / dx^2) sum_i w_ip u_i x_ip^T,   dsigma_p = theta_p [lambda tr(C) I + 2 mu sym(C)]

and K u = r with K = sum_p V_p B^T D B (B: u -> sym C) and the unbalanced force r_i = m_i g - sum_p w_ip V_p (4 / dx^2)
sigma_p x_ip at every node that can move. A node at or beyond a wall of the box does not move across it, unless the wall
would have to pull, nor across a barrier (`mpm.initial.barriers`). Under an elastic mass a rough floor holds the node
completely, unless that needs more than friction: then it slips, and friction acts on it as a force. A geostatic box
stands between smooth barriers on all its lateral faces; rough ground holds a geostatic layer like an elastic mass.
Solids push as in `mpm.physics.contact`, whose law is part of C_p and of K, with shear tractions where they are rough
and hold a mass. Where bodies touch solids, or slip, K has a little inertia (`INERTIA`). Where particles yield, theta_p
is reduced to a tenth, so that the others take the load, as with a tangent stiffness.

**Solver.** K is never assembled. Conjugate gradients are preconditioned by the diagonal and, where K is worst, by a
sparse LU of the block of nodes with few particles (surfaces and edges); in 2D of all nodes. Everything is in f64.
"""

import warnings

import numpy as np
from numpy.typing import NDArray

from datasets.geometry.ground import plan_axes
from datasets.scene import TOLERANCE, Mass, Scene, keyed
from datasets.scene.particles import Particles
from mpm.initial.equilibrium import Equilibrium
from mpm.initial.grid_operators import clings
from mpm.initial.limit_states import WithThrust
from mpm.initial.slope import slope_stress

Floats = NDArray[np.float64]

NEAR = 0.01  # share of a box's thrust that an elastic solution may lack, and any solution without a warning


def initial_tractions(
    scene: Scene, particles: Particles, positions: Floats | None = None, water: tuple[Floats, Floats] | None = None
) -> tuple[Floats, Floats]:
    """Stress of every particle at time 0 [Pa], shape [N, 4] (xx, yy, zz, xy) or, in 3D, [N, 6] (..., xy, yz, zx), and
    the shear traction of the solid that it touches [Pa], shape [N, D]. In masses without `k0` it is that of
    `mpm.initial.slope`, or zero. `positions` [m], shape [N, D]: the particles' positions as the solver rounds them, if
    that matters. Warns in one line if no equilibrium within the yield surface was found. water: the result of
    `mpm.initial.water`, if there is any; the stress is then the effective one."""
    dimension = scene.dimension
    rounded = particles.positions if positions is None else np.asarray(positions, np.float64)
    stress, shear = slope_stress(scene, particles, rounded, None if water is None else water[0][:, 2])
    chosen = np.array([mass.k0 is not None for mass in scene.masses])[particles.mass]
    if water is not None and not chosen.all() and scene.gravity > 0.0:
        # Otherwise water, which is stiffer, would take the unbalanced forces of the grid.
        numbers = np.flatnonzero(~chosen)
        problem = Equilibrium(scene, particles, rounded, numbers)
        problem.carry(scene, rounded[numbers], water[0][numbers, 0], water[1][numbers])
        stress[numbers] = problem.settled(stress[numbers], shear[numbers[problem.contact.touching]])
    if chosen.any() and scene.gravity > 0.0:
        guess, numbers = geostatic(scene, particles, rounded), np.flatnonzero(chosen)
        problem = Equilibrium(scene, particles, rounded, numbers)
        if water is not None:
            problem.carry(scene, rounded[numbers], water[0][numbers, 0], water[1][numbers])
            guess = guess * water[0][:, 2, None, None]
        guess[chosen] += stress[chosen]
        problem.contact.traction = shear[numbers[problem.contact.touching]]
        stress[chosen] = guess[chosen]
        boxes = [mass.k0 is not None and not clings(mass) for mass in scene.masses]
        alone = all(box or mass.k0 is None for box, mass in zip(boxes, scene.masses, strict=True))
        if not alone:
            stress[chosen] = problem.solution(guess[chosen])
        lacking = lateral_shortfall(scene, particles, guess, stress)
        if any(boxes) and (alone or np.abs(lacking).max() > NEAR):
            convex = WithThrust(problem, scene, particles.mass[chosen], guess[chosen])
            stress[chosen] = convex.sought(stress[chosen])
            lacking = lateral_shortfall(scene, particles, guess, stress)
        problem.warn(stress[chosen])
        warn_of_ratio(scene, particles, lacking)
        shear[numbers[problem.contact.touching]] = problem.contact.traction
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)][: 4 if dimension == 2 else 6]
    return np.stack([stress[:, i, j] for i, j in pairs], axis=1), shear


def geostatic(scene: Scene, particles: Particles, positions: Floats) -> Floats:
    """sigma_v = -overburden and sigma_h = K0 sigma_v of the masses with a number for `k0` [Pa], shape [N, 3, 3]."""
    stress = np.zeros((len(positions), 3, 3))
    for number, mass in enumerate(scene.masses):
        if mass.k0 is None or isinstance(mass.k0, str):
            continue
        selected = particles.mass == number
        vertical = -overburden(scene, mass, positions[selected], particles.depth[selected])
        stress[selected] = vertical[:, None, None] * np.diag([mass.k0, 1.0, mass.k0])
    return stress


def lateral_shortfall(scene: Scene, particles: Particles, guess: Floats, stress: Floats) -> Floats:
    """Share of the level stresses of `guess` that `stress` lacks, on average over a mass [-], [N, 3, 3].

    For boxes with a number for `k0`, between smooth walls, this mean is the thrust through each section, whatever the
    jitter of single particles (virtual work of a uniform strain). 0 elsewhere."""
    lacking = np.zeros_like(stress)
    for number, mass in enumerate(scene.masses):
        if mass.k0 is None or clings(mass):
            continue
        of_mass = particles.mass == number
        volume = particles.volume[of_mass]
        for axis in plan_axes(scene.dimension):
            required, thrust = (float(volume @ tensors[of_mass, axis, axis]) for tensors in (guess, stress))
            lacking[of_mass, axis, axis] = 1.0 - thrust / required if required < 0.0 else 0.0
    return lacking


def warn_of_ratio(scene: Scene, particles: Particles, lacking: Floats) -> None:
    """One UserWarning for each box whose thrust differs from that of its `k0`."""
    for number, (key, mass) in enumerate(keyed(scene, "masses").items()):
        share = float(np.abs(lacking[particles.mass == number]).max(initial=0.0))
        if share > NEAR:
            said = f"the ratio {key}.k0 = {mass.k0:g} on this grid: the thrust is {100.0 * share:.2g} % off"
            warnings.warn(f"no initial stress within the yield surface has {said}", stacklevel=5)


def overburden(scene: Scene, mass: Mass, positions: Floats, depth: Floats) -> Floats:
    """Weight per area above `positions` in `mass` [Pa], shape [n], `depth` [m] below its surface.

    It includes masses that rest on `mass` without a gap and have a `k0`: others carry no stress yet and so press on
    nothing."""
    gravity = -scene.gravity_vector[1]
    top = positions[:, 1] + depth if mass.kind != "box" else np.full(len(positions), mass.lower[1] + mass.size[1])
    load = scene.material_of(mass).density * (top - positions[:, 1])
    level = plan_axes(scene.dimension)
    for above in sorted(scene.masses, key=lambda other: other.lower[1]):
        if above is mass or above.k0 is None:
            continue
        low, size = np.array(above.lower)[level], np.array(above.size)[level]
        inside = (positions[:, level] >= low) & (positions[:, level] <= low + size)
        rests = inside.all(axis=1) & (np.abs(above.lower[1] - top) <= TOLERANCE)
        load = load + np.where(rests, scene.material_of(above).density * above.size[1], 0.0)
        top = np.where(rests, above.lower[1] + above.size[1], top)
    return np.asarray(gravity * load)
