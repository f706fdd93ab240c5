"""The transfers and the law of `mpm.physics.contact` as sparse operators on nodes, for the initial stress.

With the M chosen particles that touch a solid, their foot operator F = W - sum_k d n_k S_k of weights W and slopes S:

    strain along n   delta n . F u,      shear traction   q = -theta mu_s delta (I - n n^T) F u   where it is rough,
    nodal force      F^T V delta t,      t = -sigma_nn n + q
"""

from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from datasets.geometry.contact_surface import contact_surface_of
from datasets.scene import Mass, Scene
from datasets.scene.particles import Particles
from mpm.arrays.layout import Contact, node_shape
from mpm.output.smoothing import support
from mpm.solids.obstacles import bed_holds_at, holds_at, initial_contacts

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HELD, HALF = 1.0 - 1.0e-9, 0.5 - 1.0e-9  # shares from which solids hold a node completely, and by half


def gradient_matrices(scene: Scene, positions: Floats) -> tuple[Any, Any, Integers]:
    """Weights w_ip, shape [N, n]; slopes (4 / dx^2) w_ip x_ip, axis by axis, [D N, n]; nodes, [n, D].

    Only the n nodes in the support of particles; indices count from the first padding node, as in the kernel."""
    nodes, weight, offset = support(scene, positions)
    cell, shape = scene.domain.cell, node_shape(scene.domain)
    supports = np.zeros(np.prod(shape), bool)
    supports[nodes.ravel()] = True
    touched, column = np.flatnonzero(supports), (np.cumsum(supports) - 1).astype(np.int32)[nodes].ravel()

    def matrix(values: Floats) -> Any:
        starts = np.arange(0, values.size + 1, nodes.shape[1], dtype=np.int32)
        columns = np.resize(column, values.size)
        return sparse.csr_array((values.ravel(), columns, starts), (len(starts) - 1, len(touched)))

    slopes = 4.0 / cell * np.moveaxis(weight[:, :, None] * offset, -1, 0)
    return matrix(weight), matrix(slopes), np.stack(np.unravel_index(touched, shape), axis=1)


def clings(mass: Mass) -> bool:
    """Whether rough ground holds `mass` tangentially: all but geostatic boxes, whose sides smooth barriers hold."""
    return mass.kind == "layer" or isinstance(mass.k0, str)


class ContactOperator:
    """Contact of the particles `chosen` of a scene; n nodes, D dimensions, M of N chosen particles touch a solid."""

    def __init__(
        self, scene: Scene, particles: Particles, positions: Floats, chosen: Integers, weights: Any, slopes: Any
    ) -> None:
        count, dimension = positions.shape
        contacts = initial_contacts(scene, positions)
        self.touching = np.flatnonzero(contacts[:, Contact.DELTA] > 0.0)
        here = contacts[self.touching]
        self.delta = here[:, Contact.DELTA]
        self.normal = here[:, Contact.NORMAL : Contact.NORMAL + dimension]
        rough = np.array([clings(mass) for mass in scene.masses])[particles.mass[chosen]]
        self.friction = np.where(rough[self.touching], here[:, Contact.FRICTION], 0.0)
        self.share = particles.volume[chosen][self.touching] * self.delta
        self.distance = here[:, Contact.DISTANCE]
        lever = self.distance[:, None] * self.normal
        foot = weights.tocsr()[self.touching]
        for axis in range(dimension):
            rows = slopes[axis * count : (axis + 1) * count].tocsr()[self.touching]
            foot = foot - sparse.diags_array(lever[:, axis]) @ rows
        self.foot = foot.tocsr()
        self.traction = np.zeros((len(self.touching), dimension))  # shear traction q [Pa], shape [M, D]
        # Of the nodes that solids hold normals and frictions, [n, D] and [n], and the components that faces across an
        # axis hold, [n, D]; `fixed_components` finds them.
        self.normals, self.frictions = np.zeros((weights.shape[1], dimension)), np.zeros(weights.shape[1])
        self.across_axes = np.zeros((weights.shape[1], dimension), bool)

    def gradient(self, displacements: Floats) -> Floats:
        """Part of contact in the displacement gradient [-], [M, 3, 3], for nodal displacements [m], shape [n, D]."""
        strain = self.delta * (self.normal * (self.foot @ displacements)).sum(axis=1)
        space = np.pad(self.normal, ((0, 0), (0, 3 - self.normal.shape[1])))
        return np.asarray(strain[:, None, None] * space[:, :, None] * space[:, None, :])

    def shear_traction(self, displacements: Floats, stiffness: Floats) -> Floats:
        """Change of q [Pa], shape [M, D]; stiffness: theta mu_s of all chosen particles [Pa], shape [N]."""
        slip = self.foot @ displacements
        slip = slip - (slip * self.normal).sum(axis=1)[:, None] * self.normal
        rough = np.where(self.friction > 0.0, stiffness[self.touching] * self.delta, 0.0)
        return np.asarray(-rough[:, None] * slip)

    def normal_stress(self, stress: Floats) -> Floats:
        """sigma_nn [Pa], shape [M], of the stress of the particles that touch a solid [Pa], shape [M, 3 or D, ...]."""
        size = self.normal.shape[1]
        return np.asarray(np.einsum("mi,mij,mj->m", self.normal, stress[:, :size, :size], self.normal))

    def force(self, normal_stress: Floats, traction: Floats) -> Floats:
        """Nodal force [N], shape [n, D], of -sigma_nn n + q."""
        return np.asarray(self.foot.T @ (self.share[:, None] * (traction - normal_stress[:, None] * self.normal)))

    def pressed(self) -> NDArray[np.bool_]:
        """Components of nodes that contact pushes, up to rounding, shape [n, D]."""
        push = np.abs(self.force(-np.ones(len(self.touching)), 0.0 * self.traction))
        return np.asarray(push > 1.0e-9 * push.max(initial=0.0))

    def coulomb_limited(self, stress: Floats, traction: Floats) -> Floats:
        """Shear tractions [Pa], shape [M, D], within Coulomb's bound for the `stress` [Pa]."""
        bound = self.friction * np.maximum(-self.normal_stress(stress[self.touching]), 0.0)
        length = np.linalg.norm(traction, axis=1)
        scale = np.divide(bound, length, out=np.ones_like(length), where=length > bound)
        return np.asarray(scale[:, None] * traction)

    def fixed_components(self, scene: Scene, nodes: Integers) -> NDArray[np.bool_]:
        """The components of `nodes`, indices of shape [n, D], that solids hold, shape [n, D].

        Faces across an axis hold that component if they hold it completely: held in part, it gives way in the run until
        its particles bear it. Oblique faces hold all components from a share of half on, since such a node lies deep,
        in the support of only the first row; a body may also slide on them, and force beyond friction remains."""
        solid = contact_surface_of(scene)
        if solid is None:
            return np.zeros(nodes.shape, bool)
        window, first, holds, directions = holds_at(scene, solid, nodes)
        node, (share, normals, frictions) = window.numbers(nodes), bed_holds_at(scene, solid, nodes)
        size = nodes.shape[1]

        def across(normal: Floats) -> Floats:
            along = np.abs(normal).max(axis=1, initial=0.0, keepdims=True) > 1.0 - 1.0e-9
            return np.asarray(np.where(along, np.abs(normal) > 0.5, 0.0))

        def described(normal: Floats, friction: Floats) -> Floats:
            axes, ones = across(normal), np.ones((len(normal), 1))
            oblique = 1.0 - axes.max(axis=1, initial=0.0, keepdims=True)
            return np.concatenate([axes, oblique, normal, friction[:, None], ones], axis=1)

        def of_nodes(values: Floats) -> Floats:
            total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
            return np.asarray(total[first[node + 1]] - total[first[node]])

        sums = of_nodes(holds[:, [2]] * described(directions, holds[:, 1]))
        sums += share[:, None] * described(normals, frictions)
        axes, oblique, normal, friction, ones = np.split(sums, np.cumsum([size, 1, size, 1]), axis=1)
        length = np.linalg.norm(normal, axis=1)[:, None]
        self.normals = np.divide(normal, length, out=self.normals, where=length > 0.0)
        self.frictions = friction[:, 0] / np.maximum(ones[:, 0], 1.0)
        self.across_axes = axes >= HELD
        return np.asarray(axes + oblique >= np.where(oblique > axes, HALF, HELD))

    def diagonal(self, lame: Floats, shear: Floats) -> Floats:
        """Diagonal of contact's part of the stiffness [N/m], [n, D]; theta lambda, theta mu_s of all particles, [N]."""
        stiff = self.share * self.delta
        normal = (lame + 2.0 * shear)[self.touching]
        rough = np.where(self.friction > 0.0, shear[self.touching], 0.0)
        along = stiff[:, None] * (normal[:, None] * self.normal**2 + rough[:, None] * (1.0 - self.normal**2))
        return np.asarray(self.foot.multiply(self.foot).T @ along)

    def block(self, lame: Floats, shear: Floats, nodes: Integers) -> Any:
        """Block of `nodes` in contact's part of the stiffness, component after component, [D K, D K]."""
        size, part = self.normal.shape[1], self.foot[:, nodes].tocsr()
        stiff = self.share * self.delta
        normal = stiff * (lame + 2.0 * shear)[self.touching]
        rough = stiff * np.where(self.friction > 0.0, shear[self.touching], 0.0)

        def each(i: int, j: int) -> Any:
            value = (normal - rough) * self.normal[:, i] * self.normal[:, j] + (rough if i == j else 0.0)
            return (part.T @ (sparse.diags_array(value) @ part)).tocsr()

        return sparse.block_array([[each(i, j) for j in range(size)] for i in range(size)]).tocsr()
