"""Geostatic stress with a given thrust, within the yield surface: admissible up to active and passive pressure.

What jitter does to single particles must not change the thrust of a box on its walls, K0 rho g H^2 / 2. Where K0 is
near a limit of yield nearly all particles stand on it, and the elastic correction of `mpm.initial.equilibrium`, whose
excess is then scaled back, moves their mean away from it (0.40 for 0.34). Equilibrium and thrust are linear in the
stress and the yield surface is convex, so a stress that has them all is a point of two convex sets,

    E = {sigma: r(sigma) = 0, sum_p V_p sigma_aa = K0 sum_p V_p sigma_v for every box and level axis a}
    Y = {sigma: the law of strength, reduced by a little, and the tension limit hold in every particle}

and Douglas-Rachford iteration finds one (Lions & Mercier 1979; Bauschke, Combettes & Luke 2002):

    x = P_E(z),   y = P_Y(2 x - z),   z <- z + RELAXED (y - x)

P projects in the norm sum_p V_p sigma : sigma. For E that is the correction of an elastic body with lambda = 0 and one
shear modulus, so that one factorisation serves all iterations; the thrust adds a self-equilibrated stress to it.
"""

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene
from mpm.initial.equilibrium import BALANCED, Equilibrium, conjugate_gradients
from mpm.initial.grid_operators import clings

Floats = NDArray[np.float64]

RELAXED = 1.6
"""Factor on the step of z, below 2."""
ITERATIONS, BETWEEN, PATIENCE = 240, 4, 8
"""Steps at most; after how many what is unbalanced is computed, and how often in a row that may be no less."""
RELEASES = 5
"""Solutions at most, each without what walls would have to pull in the one before."""
FEW_NODES = 6000
"""Up to which a scene in 3D is factorised as a whole."""


class WithThrust:
    """The set E of an equilibrium and the thrusts of its geostatic boxes; N chosen particles."""

    def __init__(self, problem: Equilibrium, scene: Scene, mass: NDArray[np.int32], guess: Floats) -> None:
        """mass: index of the mass of each chosen particle, [N]; guess: geostatic stress of these thrusts, [N, 3, 3]."""
        self.problem = problem
        problem.lame, problem.shear = 0.0 * problem.lame, np.full_like(problem.shear, problem.shear.mean())
        problem.theta, problem.inertia = np.ones_like(problem.theta), 0.0 * problem.inertia
        if len(problem.mass) <= FEW_NODES:
            problem.direct = np.arange(len(problem.mass))
        self.precondition = problem.preconditioner()
        boxes = [number for number, each in enumerate(scene.masses) if each.k0 is not None and not clings(each)]
        self.parts = [(mass == number, axis) for number in boxes for axis in (0, 2)[: scene.dimension - 1]]
        self.thrusts = self.sums(guess)
        self.displacements = np.zeros(problem.nodes.shape)
        self.modes = [self.self_equilibrated(*part) for part in self.parts]
        self.response = np.array([self.sums(each) for each in self.modes]).T

    def sums(self, stress: Floats) -> Floats:
        """sum_p V_p sigma_aa of every box and level axis [N m]."""
        volume = self.problem.volume
        return np.array([volume[own] @ stress[own, axis, axis] for own, axis in self.parts])

    def self_equilibrated(self, own: NDArray[np.bool_], axis: int) -> Floats:
        """The uniform level stress of a box less what of it has nodal forces, [N, 3, 3]."""
        stress = np.zeros((len(own), 3, 3))
        stress[own, axis, axis] = 1.0
        contact = self.problem.contact
        for _ in range(4):
            force = contact.force(contact.normal_stress(stress), 0.0 * contact.traction)
            stress = stress + self.problem.elastic(self.displaced_by(force - self.problem.divergence(stress)))
        return stress

    def displaced_by(self, force: Floats) -> Floats:
        """Displacements [m], [n, D], by nodal forces [N], but for hundredths of it."""
        problem = self.problem
        return conjugate_gradients(problem.stiffness, np.where(problem.free, force, 0.0), self.precondition)[0]

    def nearest(self, stress: Floats) -> Floats:
        """P_E(stress), [N, 3, 3], starting from the displacements of the projection before."""
        problem = self.problem
        force = problem.unbalanced(stress + problem.elastic(self.displacements), problem.contact.traction)
        self.displacements = self.displacements + self.displaced_by(force)
        stress = stress + problem.elastic(self.displacements)
        if self.modes:
            factors = np.linalg.solve(self.response, self.thrusts - self.sums(stress))
            stress = stress + np.tensordot(factors, self.modes, 1)
        return np.asarray(stress)

    def sought(self, start: Floats) -> Floats:
        """The best stress of E that is admitted, [N, 3, 3], sought from `start`; walls may pull."""
        problem = self.problem
        best, smallest, patience, moving = start, np.inf, PATIENCE, start
        for step in range(ITERATIONS):
            stress = self.nearest(moving)
            if step % BETWEEN == 0:
                admitted = problem.admitted(stress)
                force = np.where(problem.free, problem.unbalanced(admitted, problem.contact.traction), 0.0)
                off = np.abs(self.sums(admitted) / self.thrusts - 1.0).max(initial=0.0)
                left = float(np.abs(force).sum()) / problem.weight + float(off)
                patience = PATIENCE if left < 0.9 * smallest else patience - 1
                if left < smallest:
                    best, smallest = admitted, left
                if smallest <= BALANCED or patience == 0:
                    break
            principal, axes = np.linalg.eigh(2.0 * stress - moving)
            projected = np.einsum("nik,nk,njk->nij", axes, problem.law.nearest(principal, problem.properties), axes)
            moving = moving + RELAXED * (projected - stress)
        return best


def with_thrusts(problem: Equilibrium, scene: Scene, mass: NDArray[np.int32], start: Floats, guess: Floats) -> Floats:
    """The stress of the chosen particles, [N, 3, 3], in equilibrium with the thrusts of `guess`, sought from `start`.

    The best admitted one where there is none within ITERATIONS. Changes the stiffness of `problem`, and frees the nodes
    that walls would have to pull. mass: as of `WithThrust`.
    """
    for _ in range(RELEASES):
        found = WithThrust(problem, scene, mass, guess).sought(start)
        pulled = problem.pulled(problem.unbalanced(found, problem.contact.traction))
        if not pulled.any():
            break
        start, problem.free = found, problem.free | pulled
    return found
