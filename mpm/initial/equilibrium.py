"""Nodal equilibrium of particles under gravity: the system that `mpm.initial.stress` solves, in the elastic energy."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from datasets.errors import require
from datasets.geometry.bodies import scene_height
from datasets.geometry.ground import plan_axes
from datasets.scene import DOMAIN_SIDES, Scene, coefficient
from datasets.scene.particles import Particles
from mpm.arrays.layout import PADDING, Property
from mpm.arrays.properties import CONTACT_WIDTH, properties_of
from mpm.initial.barriers import barriers
from mpm.initial.grid_operators import ContactOperator, clings, gradient_matrices
from mpm.laws import law_of
from mpm.physics.pore_pressure import COVERED
from mpm.solids.obstacles import contact_delta, covered_at, from_wall

Floats = NDArray[np.float64]
Operator = Callable[[Floats], Floats]

ITERATIONS = 100  # most solutions for an unbalanced force
PATIENCE, PROGRESS = 10, 0.9  # how many in a row may leave more than this share of the least unbalanced force so far
ROUNDING = 1.0e-9  # change of stress by the yield surface, over the largest stress, that counts as none
BALANCED = 1.0e-12  # unbalanced nodal forces, summed, over the weight, at which iterations end
UNBALANCED = 1.0e-3
"""The same, above which a warning says that there is no equilibrium.

Less is left where a cohesionless surface or its edge rests on single particles displaced by jitter: for those nodes
there is no admissible stress, and only they move, by tenths of a millimetre per second.
"""
INSIDE = 0.9  # share of the deviator at yield to which a stress that violated yield is reduced
SOFTENED, SOFTEST = 0.1, 1.0e-3  # factor on theta of a yielding particle, and its least value
ACCURACY = 1.0e-2  # relative residual of a solution; the next one takes the rest
INERTIA = 0.01
"""Share of the stiffness of a body's slowest mode, per mass, where it touches solids: there, nodes that single
particles at its edge cannot hold fall, instead of loading these particles without bound."""
UPWARD = 0.1  # least vertical component of the normal of a solid that carries load
WEAK = 0.4  # share of the largest nodal mass: lighter nodes are solved for directly
SHIFT = 1.0e-9  # on the diagonal of the scaled block that is factorised: nodes of a single particle make it singular
EXTRA_STEPS = 60  # steps of conjugate gradients after which the block is factorised again
MOST_STEPS = 600
SETTLING = {2: 20, 3: 5}  # solutions for layers on a slope, by dimension


class Equilibrium:
    """Nodal equilibrium of the particles `chosen` of a scene; n nodes, D dimensions, N chosen particles."""

    def __init__(self, scene: Scene, particles: Particles, positions: Floats, chosen: NDArray[np.int64]) -> None:
        self.dimension = scene.dimension
        self.volume, density = particles.volume[chosen], particles.density[chosen]
        self.law, self.properties = law_of(particles.materials), properties_of(particles)[chosen]
        self.lame, self.shear = self.properties[:, Property.LAME], self.properties[:, Property.SHEAR]
        self.limit = self.law.limit(self.properties)
        weights, self.slopes, self.nodes = gradient_matrices(scene, positions[chosen])
        # By columns, with which SciPy multiplies more than twice as fast as by rows.
        self.slopes_t = self.slopes.T
        self.weights, self.mass = weights, np.asarray(weights.T @ (self.volume * density))
        self.weight = float(self.mass.sum() * np.linalg.norm(scene.gravity_vector))
        self.gravity: Floats = self.mass[:, None] * np.array(scene.gravity_vector)
        self.friction = coefficient(scene.floor_friction)
        self.contact = ContactOperator(scene, particles, positions[chosen], chosen, weights, self.slopes)
        self.hold(scene, weights, particles.mass[chosen])
        direct = np.ones(len(self.mass), bool) if self.dimension == 2 else self.mass < WEAK * self.mass.max()
        self.direct = np.flatnonzero(direct)
        self.theta = np.ones(len(chosen))
        height = scene_height(scene) + scene.domain.cell
        slowest = np.pi / (2.0 * height) * max(material.wave_speed for material in particles.materials)
        # A body that nothing holds along the floor slides as a whole: K alone is singular.
        touches = len(self.contact.touching) > 0 or (scene.slope_deg != 0.0 and self.friction == 0.0)
        self.loose_inertia = INERTIA * slowest**2 * self.mass[:, None]
        self.inertia = self.loose_inertia if touches else np.zeros((len(self.mass), 1))
        self.level = plan_axes(self.dimension)
        self.slip, self.slid = np.zeros((2, *self.nodes.shape))

    def carry(self, scene: Scene, positions: Floats, pressure: Floats, slope: Floats) -> None:
        """Let water with the pore `pressure` [Pa], shape [N], and its `slope` in space [Pa/m], [N, D], carry its part
        at the `positions` [m], [N, D]: stresses are then effective. `Water.fixed` exerts only that slope."""
        if scene.water is not None and scene.water.fixed:
            self.gravity = self.gravity - self.weights.T @ (self.volume[:, None] * slope)
            return
        touching = self.contact.touching
        foot = pressure[touching] - self.contact.distance * (slope[touching] * self.contact.normal).sum(axis=1)
        push = self.contact.force(-np.maximum(foot, 0.0), self.contact.traction)
        self.gravity = self.gravity + push + self.divergence(pressure[:, None, None] * np.eye(3))
        count = len(pressure)
        for axis in range(self.dimension):
            for side in (0, 1):
                if DOMAIN_SIDES[2 * axis + side] in scene.open_sides:
                    continue
                inwards = 1.0 - 2.0 * side
                away = from_wall(scene, positions, 2 * axis + side)
                uncovered = np.ones(count, bool)
                uncovered[touching[inwards * self.contact.normal[:, axis] > COVERED]] = False
                foot = np.maximum(pressure - inwards * away * slope[:, axis], 0.0) * (uncovered & (pressure > 0.0))
                force = inwards * self.volume * contact_delta(away, CONTACT_WIDTH * scene.domain.cell) * foot
                levers = self.slopes[axis * count : (axis + 1) * count]
                self.gravity[:, axis] += self.weights.T @ force - levers.T @ (inwards * away * force)

    def hold(self, scene: Scene, weights: Any, mass: NDArray[np.int32]) -> None:
        """Find which components of nodes are free, [n, D]; where walls of the box push, 1 towards + and -1 towards -,
        and where barriers hold, [n, D]; and which nodes a rough floor holds completely, [n]."""
        self.walls = walls = np.zeros(self.nodes.shape, np.int8)
        self.behind_barriers = np.zeros(self.nodes.shape, bool)
        covered = covered_at(scene, self.nodes)
        for axis, length in enumerate(scene.domain.size):
            last = PADDING + round(length / scene.domain.cell)
            for side, beyond in enumerate((self.nodes[:, axis] <= PADDING, self.nodes[:, axis] >= last)):
                if DOMAIN_SIDES[2 * axis + side] not in scene.open_sides:
                    # A side that a solid covers pushes nothing.
                    walls[beyond & (covered >> (2 * axis + side) & 1 == 0), axis] = 1 - 2 * side
        self.rough = np.zeros(len(self.nodes), bool)
        for number, body in enumerate(scene.masses):
            if clings(body) and self.friction > 0.0:
                self.rough |= (walls[:, 1] == 1) & (weights.T @ (mass == number).astype(float) > 0.0)
            if body.k0 is not None and (body.release is not None or not clings(body)):
                # Without a release there is no barrier in the run: a solid there takes the thrust.
                pressed = self.contact.pressed() if body.release is None else np.zeros(self.nodes.shape, bool)
                for axis, (low, high) in barriers(scene, body):
                    inside = ((self.nodes >= low) & (self.nodes < high)).all(axis=1)
                    self.behind_barriers[inside & ~pressed[:, axis], axis] = True
        self.check_support(scene, weights, mass)
        self.held = (walls != 0) | self.behind_barriers | self.rough[:, None]
        self.in_solids = self.contact.fixed_components(scene, self.nodes)
        self.free = ~(self.held | self.in_solids)

    def check_support(self, scene: Scene, weights: Any, mass: NDArray[np.int32]) -> None:
        """Raise InputError for a mass with a number for `k0` that neither ground nor masses with a `k0` carry."""
        facing_up = self.contact.touching[self.contact.normal[:, 1] > UPWARD]
        nodes = {number: weights.T @ (mass == number).astype(float) > 0.0 for number in np.unique(mass).tolist()}
        carried = {n for n, own in nodes.items() if (own & (self.walls[:, 1] == 1)).any() or n in mass[facing_up]}
        left = set(nodes) - carried
        while more := {n for n in left if any((nodes[n] & nodes[other]).any() for other in carried)}:
            carried, left = carried | more, left - more
        for number in left:
            expected = "ground or a mass with a k0 beneath the mass, or 'elastic'"
            body = scene.masses[number]
            require(clings(body) or body.k0 is None, f"masses[{number}].k0", expected, body.k0)

    def solution(self, stress: Floats) -> Floats:
        """The stress in equilibrium from the guess `stress`, [N, 3, 3], or the nearest to equilibrium."""
        precondition = None
        best, smallest, patience = stress, np.inf, PATIENCE
        tractions, state = self.contact.traction, (self.free, self.slip)
        for _ in range(ITERATIONS):
            admitted = self.admitted(stress)
            tractions = self.contact.coulomb_limited(admitted, tractions)
            force = np.where(self.free, self.unbalanced(admitted, tractions), 0.0)
            left = float(np.abs(force).sum()) / self.weight
            patience = PATIENCE if left < PROGRESS * smallest else patience - 1
            if left < smallest:
                best, smallest = admitted, left
                self.contact.traction, state = tractions, (self.free.copy(), self.slip.copy())
            if smallest <= BALANCED or patience == 0:
                break
            yielded = np.abs(admitted - stress).max(axis=(1, 2)) > ROUNDING * np.abs(stress).max()
            if yielded.any():
                stress = np.where(yielded[:, None, None], self.admitted(stress, INSIDE), stress)
                force = np.where(self.free, self.unbalanced(stress, tractions), 0.0)
                self.theta[yielded] = np.maximum(SOFTENED * self.theta[yielded], SOFTEST)
            if precondition is None:
                precondition = self.preconditioner()
            displacements, steps = conjugate_gradients(self.stiffness, force, precondition)
            if steps > EXTRA_STEPS:
                precondition = None
            stress = stress + self.elastic(displacements)
            tractions = tractions + self.contact.shear_traction(displacements, self.theta * self.shear)
            pulled = self.pulled(self.unbalanced(stress, tractions))
            if pulled.any() or self.slips(stress, tractions, displacements):
                self.free |= pulled
                precondition = None
        self.free, self.slip = state
        return best

    def settled(self, stress: Floats, traction: Floats) -> Floats:
        """`stress` [Pa], [N, 3, 3], of layers on a slope, after the grains have taken its unbalanced forces.

        traction: shear traction of the ground [Pa], [M, D]. The force that accelerates the layers as a whole stays. The
        friction of the floor of the box on its nodes is the share of their load that `stress` has there."""
        floor, across = self.walls[:, 1] == 1, self.weights.T @ (self.volume[:, None] * stress[:, :, 1])
        share = np.divide(across, -across[:, [1]], out=np.zeros_like(across), where=across[:, [1]] < 0.0)
        self.friction, self.slip[:, self.level] = 1.0, np.where(floor[:, None], share[:, self.level], 0.0)
        self.inertia = self.loose_inertia / INERTIA
        # With that inertia a factorisation gains little, and a wide layer would need too much memory for it.
        self.direct = self.direct[:0]
        precondition = self.preconditioner()
        for _ in range(SETTLING[self.dimension]):
            force = np.where(self.free, self.unbalanced(stress, traction), 0.0)
            displacements, _ = conjugate_gradients(self.stiffness, force, precondition)
            free = stress + self.elastic(displacements)
            stress = self.admitted(free)
            if np.abs(stress - free).max() <= ROUNDING * np.abs(stress).max():
                break
        return stress

    def pulled(self, force: Floats) -> NDArray[np.bool_]:
        """Which components of nodes a wall would have to pull against the unbalanced `force` [N], both [n, D]."""
        return np.asarray(~self.free & (force * self.walls > BALANCED * self.weight))

    def slips(self, stress: Floats, tractions: Floats, displacements: Floats) -> bool:
        """Free the nodes that a rough floor would have to hold by more than its friction; whether any node changes.

        Friction acts against the force on these nodes (`slip`: unit vectors, [n, D]) until the displacements of the
        iterations [m], [n, D], bring them back: then the floor holds them again."""
        force = self.unbalanced(stress, tractions)
        along = np.where(self.free, 0.0, force)
        along[:, 1] = 0.0
        shear = np.linalg.norm(along, axis=1)
        held = self.friction * np.maximum(-force[:, 1], 0.0) + BALANCED * self.weight
        slid = self.slip.any(axis=1)
        new = self.rough & (shear > (1.0 + ACCURACY) * held) & ~slid
        self.slip[new] = along[new] / shear[new, None]
        self.slid[:, self.level] += np.where(slid[:, None], displacements[:, self.level], 0.0)
        back = (self.slid * self.slip).sum(axis=1) < 0.0
        self.slip[back] = self.slid[back] = 0.0
        # Walls beside the floor still hold.
        movable = ~((self.walls != 0) | self.behind_barriers)[:, self.level]
        self.free[:, self.level] = np.where(movable & new[:, None], True, self.free[:, self.level] & ~back[:, None])
        if new.any():
            self.inertia = self.loose_inertia
        return bool(new.any() or back.any())

    def warn(self, stress: Floats) -> None:
        """Warn of the share of the weight that a solution leaves unbalanced, if that is more than single particles.

        It counts unbalanced nodal forces and forces that no wall takes: tension, and shear beyond friction."""
        force = self.unbalanced(stress, self.contact.traction)
        loose = np.abs(force[self.free]).sum()
        push = -force * self.walls
        pulled = np.where((self.walls != 0) & ~self.free, np.maximum(-push, 0.0), 0.0).sum()
        # Walls or barriers take the force along a direction that they hold.
        along = np.where(self.free | (self.walls != 0) | self.behind_barriers, 0.0, force)[:, self.level]
        shear = np.linalg.norm(along, axis=1)
        slips = np.maximum(shear - self.friction * np.maximum(push[:, 1], 0.0), 0.0)[self.rough].sum()
        # Oblique faces hold nodes completely; along all faces solids bear no more than friction, in the sum: single
        # nodes pull.
        borne = np.where(self.in_solids & ~self.held, force, 0.0)
        across = (borne * self.contact.normals).sum(axis=1)
        beside = borne - across[:, None] * self.contact.normals
        along = np.linalg.norm(np.where(self.contact.across_axes, 0.0, beside), axis=1)
        slides = max(float(along.sum() - self.contact.frictions @ np.maximum(-across, 0.0)), 0.0)
        missing = float(loose + pulled + slips + slides) / self.weight
        if missing > UNBALANCED:
            said = f"balances gravity: {missing:.2g} of the weight is unbalanced at the start"
            warnings.warn(f"no initial stress within the yield surface {said}", stacklevel=6)

    def unbalanced(self, stress: Floats, tractions: Floats) -> Floats:
        """r_i = m_i g + f_i(stress, shear tractions) [N], shape [n, D]."""
        normal = self.contact.normal_stress(stress[self.contact.touching])
        push = self.contact.force(np.minimum(normal, 0.0), tractions)
        force = self.gravity + push - self.divergence(stress)
        return np.asarray(force - self.friction * np.maximum(-force[:, 1:2], 0.0) * self.slip)

    def divergence(self, stress: Floats) -> Floats:
        """sum_p w_ip V_p (4 / dx^2) sigma_p x_ip [N], shape [n, D]."""
        return self.nodal(np.moveaxis(stress[:, : self.dimension, : self.dimension], 2, 0))

    def nodal(self, stress: Floats) -> Floats:
        """The same, for columns of the stress one after the other, [D, N, D]."""
        flux = self.volume[:, None] * stress
        return np.asarray(self.slopes_t @ flux.reshape(-1, self.dimension))

    def elastic(self, displacements: Floats) -> Floats:
        """Change of stress [Pa], shape [N, 3, 3], by nodal displacements [m], shape [n, D]."""
        columns, pressure = self.response(displacements)
        change = np.zeros((len(self.volume), 3, 3))
        change[:, 2, 2] = pressure
        change[:, : self.dimension, : self.dimension] = np.moveaxis(columns, 0, 2)
        return change

    def response(self, displacements: Floats) -> tuple[Floats, Floats]:
        """The same in D dimensions, its columns one after the other, [D, N, D]; and theta lambda tr(C), [N].

        It is symmetric: it does not matter that copying exchanges rows and columns."""
        gradient = (self.slopes @ displacements).reshape(self.dimension, -1, self.dimension)
        added = self.contact.gradient(displacements)[:, : self.dimension, : self.dimension]
        gradient[:, self.contact.touching] += np.moveaxis(added, 2, 0)
        change = (self.theta * self.shear)[:, None] * (gradient + gradient.swapaxes(0, 2))
        pressure = self.theta * self.lame * sum(gradient[axis, :, axis] for axis in range(self.dimension))
        for axis in range(self.dimension):
            change[axis, :, axis] += pressure
        return change, pressure

    def stiffness(self, displacements: Floats) -> Floats:
        """(K + inertia) u [N], shape [n, D], zero where a node is held."""
        change, _ = self.response(displacements)
        normal = self.contact.normal_stress(np.moveaxis(change[:, self.contact.touching], 0, 2))
        shear = self.contact.shear_traction(displacements, self.theta * self.shear)
        force = self.nodal(change) - self.contact.force(normal, shear)
        return np.where(self.free, force + self.inertia * displacements, 0.0)

    def admitted(self, stress: Floats, inside: float = 1.0) -> Floats:
        """`stress` cut at the tension limit, then scaled to its mean until its law admits it, and by `inside` more."""
        principal = np.linalg.eigvalsh(stress)
        beyond, stress = principal[:, 2] > self.limit, stress.copy()
        principal = np.minimum(principal, self.limit[:, None])
        stress[beyond] = in_axes(np.linalg.eigh(stress[beyond])[1], principal[beyond])
        mean = principal.mean(axis=1)
        share = self.law.admitted_share(mean, principal - mean[:, None], self.properties)
        yields = beyond | (share < 1.0)
        factor, pressure = inside * np.clip(share[yields], 0.0, 1.0), mean[yields, None, None] * np.eye(3)
        stress[yields] = pressure + factor[:, None, None] * (stress[yields] - pressure)
        return stress

    def preconditioner(self) -> Operator:
        """An approximate inverse of K: its diagonal, and the factorised block of the nodes `direct`."""
        dimension, count = self.dimension, len(self.volume)
        by_axis = [self.slopes[axis * count : (axis + 1) * count] for axis in range(dimension)]
        stiff = self.volume * self.theta
        moduli = np.stack([stiff * self.lame, stiff * self.shear], 1)
        squares = [matrix.multiply(matrix).T @ moduli for matrix in by_axis]
        total = sum(square[:, 1] for square in squares)
        diagonal = np.stack([squares[axis].sum(axis=1) + total for axis in range(dimension)], axis=1)
        contact = self.theta * self.lame, self.theta * self.shear
        diagonal += self.contact.diagonal(*contact) + self.inertia
        inverse = np.where(self.free & (diagonal > 0.0), 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
        if len(self.direct) == 0:
            return lambda force: inverse * force
        parts = [matrix[:, self.direct].tocsr() for matrix in by_axis]
        used = np.flatnonzero(np.diff(parts[0].indptr))
        parts = [part[used] for part in parts]
        lame, shear = (sparse.diags_array((stiff * value)[used]) for value in (self.lame, self.shear))
        axes = range(dimension)
        first = [[(parts[i].T @ (lame @ parts[j])).tocsr() for j in axes] for i in axes]
        second = [[(parts[i].T @ (shear @ parts[j])).tocsr() for j in axes] for i in axes]
        trace = sum(second[axis][axis] for axis in axes)
        rows = [[first[i][j] + second[j][i] + (trace if i == j else 0.0 * trace) for j in axes] for i in axes]
        block = sparse.block_array(rows).tocsr() + self.contact.block(*contact, self.direct)
        block = block + sparse.diags_array(np.tile(self.inertia[self.direct, 0], dimension))
        # Components of a node side by side: the factorisation then orders nodes, not components.
        free = self.free[self.direct].ravel()
        order = np.arange(dimension * len(self.direct)).reshape(dimension, -1).T.ravel()[free]
        scale = np.sqrt(inverse[self.direct].ravel()[free])
        scaled = sparse.diags_array(scale) @ block[order][:, order] @ sparse.diags_array(scale)
        matrix = (scaled + SHIFT * sparse.eye_array(len(order))).tocsc()
        symmetric = {"SymmetricMode": True}
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)

        def precondition(force: Floats) -> Floats:
            result = inverse * force
            part = result[self.direct]
            part[self.free[self.direct]] = scale * factors.solve(scale * force[self.direct].ravel()[free])
            result[self.direct] = part
            return result

        return precondition


def in_axes(axes: Floats, principal: Floats) -> Floats:
    """Tensors, [N, 3, 3], of `principal` values, [N, 3], along the columns of `axes`, [N, 3, 3]."""
    return np.asarray((axes * principal[:, None, :]) @ axes.swapaxes(1, 2))


def conjugate_gradients(
    matrix: Operator, force: Floats, precondition: Operator, accuracy: float = ACCURACY
) -> tuple[Floats, int]:
    """u with matrix(u) = force to a relative residual of `accuracy` (Hestenes & Stiefel 1952), and the steps taken."""
    solution, residual = np.zeros_like(force), force.copy()
    direction = toward = precondition(residual)
    product = float((residual * toward).sum())
    goal = accuracy * np.sqrt(product)
    steps = 0
    while product > goal * goal and steps < MOST_STEPS:
        steps += 1
        image = matrix(direction)
        curvature = float((direction * image).sum())
        if curvature <= 0.0:
            break
        solution = solution + product / curvature * direction
        residual = residual - product / curvature * image
        toward = precondition(residual)
        before, product = product, float((residual * toward).sum())
        direction = toward + product / before * direction
    return solution, steps
