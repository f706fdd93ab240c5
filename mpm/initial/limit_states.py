"""Geostatic stress with a given thrust, within the yield surface: admissible up to active and passive pressure.

Jitter of single particles must not change the thrust of a box on its walls, K0 rho g H^2 / 2. If K0 is near a yield
limit, nearly all particles are at that limit, and the correction of `mpm.initial.equilibrium` moves their mean away
from it (0.40 for 0.34). A stress that fulfils equilibrium, thrust and yield lies in two convex sets,

    E = {sigma: r(sigma) = 0, sum_p V_p sigma_aa = K0 sum_p V_p sigma_v for every box and level axis a}
    Y = {sigma: the law of strength, reduced by a little, and the tension limit hold in every particle}

and Douglas-Rachford iteration finds such a stress (Lions & Mercier 1979; Bauschke, Combettes & Luke 2002):

    x = P_E(z),   y = P_Y(2 x - z),   z <- z + RELAXED (y - x)

P projects in the norm sum_p V_p sigma : sigma. For E that is the correction of an elastic body with lambda = 0 and one
shear modulus, so that one factorisation serves all iterations; the thrust adds a self-equilibrated stress to it. P_E is
computed roughly: the next iteration takes the rest.
"""

import numpy as np
from numpy.typing import NDArray

from datasets.scene import Scene
from mpm.initial.equilibrium import BALANCED, Equilibrium, conjugate_gradients, in_axes
from mpm.initial.grid_operators import clings

Floats = NDArray[np.float64]

RELAXED = 1.6  # factor on the step of z, below 2
ITERATIONS, BETWEEN = 240, 4  # most steps, and steps between checks of the unbalanced force
PATIENCE, PROGRESS = 8, 0.8  # how many checks in a row may leave more than this share of the least unbalanced force
NEARLY, ENOUGH, HASTE = 2.0e-3, 2.0e-4, 4
"""Unbalanced nodal forces, summed, over the weight: below NEARLY, or when patience ends, nodes that walls would pull
are freed; below ENOUGH, where hardly anything moves, a check without progress counts HASTE times."""
ROUGH = 0.1  # relative residual of P_E
RELEASES = 5  # how often nodes are freed


class WithThrust:
    """The set E of an equilibrium, whose stiffness it changes, and the thrusts of its geostatic boxes; N chosen
    particles."""

    def __init__(self, problem: Equilibrium, scene: Scene, mass: NDArray[np.int32], guess: Floats) -> None:
        """mass: index of the mass of each chosen particle, [N]; guess: geostatic stress of these thrusts, [N, 3, 3]."""
        self.problem = problem
        problem.lame, problem.shear = 0.0 * problem.lame, np.full_like(problem.shear, problem.shear.mean())
        problem.theta, problem.inertia = np.ones_like(problem.theta), 0.0 * problem.inertia
        boxes = [number for number, each in enumerate(scene.masses) if each.k0 is not None and not clings(each)]
        self.parts = [
            (problem.volume * (mass == number), axis) for number in boxes for axis in (0, 2)[: scene.dimension - 1]
        ]
        self.thrusts = self.sums(guess)
        self.modes, self.correction = np.zeros((len(self.parts), *guess.shape)), np.zeros(guess.shape)
        for mode, (volume, axis) in zip(self.modes, self.parts, strict=True):
            mode[volume > 0.0, axis, axis] = 1.0
        self.factorise()

    def factorise(self) -> None:
        """Factorise for the free nodes, and remove from the level stress of each box its nodal forces there."""
        self.precondition = self.problem.preconditioner()
        contact = self.problem.contact
        for mode in self.modes:
            for _ in range(2):
                force = contact.force(contact.normal_stress(mode[contact.touching]), 0.0 * contact.traction)
                mode += self.problem.elastic(self.displaced_by(force - self.problem.divergence(mode)))
        self.response = np.array([self.sums(each) for each in self.modes]).T

    def sums(self, stress: Floats) -> Floats:
        """sum_p V_p sigma_aa of every box and level axis [N m]."""
        return np.array([volume @ stress[:, axis, axis] for volume, axis in self.parts])

    def displaced_by(self, force: Floats) -> Floats:
        """Displacements [m], [n, D], by nodal forces [N], to a residual of ROUGH."""
        problem = self.problem
        force = np.where(problem.free, force, 0.0)
        return conjugate_gradients(problem.stiffness, force, self.precondition, ROUGH)[0]

    def nearest(self, stress: Floats) -> Floats:
        """P_E(stress), [N, 3, 3], starting from the change of the previous projection."""
        problem = self.problem
        force = problem.unbalanced(stress + self.correction, problem.contact.traction)
        self.correction += problem.elastic(self.displaced_by(force))
        if self.parts:
            lacking = self.thrusts - self.sums(stress + self.correction)
            self.correction += np.tensordot(np.linalg.solve(self.response, lacking), self.modes, 1)
        return stress + self.correction

    def sought(self, start: Floats) -> Floats:
        """An admitted stress of E, [N, 3, 3], found from `start`, or the best within ITERATIONS; frees the nodes that
        walls would have to pull."""
        problem, releases = self.problem, RELEASES
        best, smallest, patience, moving = start, np.inf, PATIENCE, start
        for step in range(ITERATIONS):
            stress = self.nearest(moving)
            if step % BETWEEN == 0:
                admitted = problem.admitted(stress)
                force = problem.unbalanced(admitted, problem.contact.traction)
                off = np.abs(self.sums(admitted) / self.thrusts - 1.0).max(initial=0.0)
                left = float(np.abs(force[problem.free]).sum()) / problem.weight + float(off)
                pulled = problem.pulled(force)
                if pulled.any() and releases > 0 and (left <= NEARLY or patience <= 1):
                    problem.free |= pulled
                    self.factorise()
                    releases, patience, smallest = releases - 1, PATIENCE, np.inf
                    continue
                patience -= HASTE if smallest <= ENOUGH else 1
                patience = PATIENCE if left < PROGRESS * smallest else patience
                if left < smallest:
                    best, smallest = admitted, left
                if smallest <= BALANCED or patience <= 0:
                    break
            reflected = 2.0 * stress - moving
            principal, axes = np.linalg.eigh(reflected)
            nearest = problem.law.nearest(principal, problem.properties)
            changed = (nearest != principal).any(axis=1)
            reflected[changed] = in_axes(axes[changed], nearest[changed])
            moving = moving + RELAXED * (reflected - stress)
        return best
