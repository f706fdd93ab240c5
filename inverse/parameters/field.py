"""An unknown field: nodes over the body, a transform that keeps it between its bounds, a prior.

    f = T(u + m),    u Gaussian of mean 0
    T(z) = lower + (upper - lower) / (1 + exp(-z))    with bounds, else T(z) = z

The stated mean is the median of f, and its band of 95 % 1.96 times the stated deviation to either side on average:
everywhere the standard deviation of a field stands for this width. The prior of u is smooth:

    (1 - sum_a s_a^2 d^2/dx_a^2) u = white noise,    s_a = length_a / sqrt(8 nu),    nu = 2 - D / 2

Its solution has the Matern covariance (Whittle 1954; Lindgren, Rue & Lindstroem, An explicit link between Gaussian
fields and Gaussian Markov random fields, J. R. Stat. Soc. B 73 (2011) 423-498),

    rho(r) = 2^(1 - nu) / Gamma(nu) (kappa r)^nu K_nu(kappa r),    kappa r = |(x - x') / s|,

0.14 at a distance of `length` in 2D (nu = 1) and in 3D (nu = 1/2). By bilinear elements with lumped mass on the nodes,

    K = M + sum_a s_a^2 G_a,    covariance K^-1 M K^-1 = A A^T,    A = K^-1 M^(1/2)

with M the mass and G_a the stiffness along axis a: a field from white noise w, u = S A w, is one sparse solution. The
operator continues by a correlation length beyond the field; S takes its nodes and scales each to the stated deviation.
"""

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse.linalg import splu
from scipy.special import expit, logit

from datasets.errors import InputError, require
from datasets.memory import require as require_memory
from datasets.scene import Scene
from datasets.scene.grid_field import FRICTION, VELOCITIES, Field, Floats, Grid
from datasets.scene.particles import initial_particles
from inverse.parameters import Parameter

if TYPE_CHECKING:
    from mpm.adjoint.gradient import Gradient


NODES_PER_LENGTH = 2.0
"""Correlation length over the spacing of the nodes, at least: with fewer the covariance is not the stated one."""
BAND = 1.959963984540054
"""Half-width of a band of 95 %, in standard deviations of a normal distribution."""
MOST = 0.9
"""Width of the prior's band over the distance of the bounds, at most."""
WIDEST = 100.0
"""Deviation of u with which every band is as wide as its bounds."""
COLUMNS = 256
"""Right-hand neighbours that are solved for at a time."""
BYTES = 24
"""Of each node and right-hand neighbour: it, its solution and their squares."""
UNITS = {FRICTION: "deg"} | dict.fromkeys(VELOCITIES, "m/s")
LABELS = {FRICTION: "friction"} | {name: f"velocity along {name[-1]}" for name in VELOCITIES}


class UnknownField:
    """One unknown field over the masses of a scene; K values at nodes, W numbers of the prior. Raises InputError."""

    def __init__(self, settings: Parameter, scene: Scene) -> None:
        spacing, lengths, self.mean, deviation = checked(settings, scene)
        self.settings = settings
        masses = scene.masses if settings.mass is None else (scene.masses[settings.mass],)
        lower = np.min([mass.lower for mass in masses], axis=0)
        upper = np.max([np.add(mass.lower, mass.size) for mass in masses], axis=0)
        extent, step = upper - lower, np.array(spacing)
        flat = step > extent * (1.0 + 1e-6)
        counts = np.where(flat, 0.0, np.ceil(extent / step - 1e-6))
        check_size("spacing", counts + 1.0)
        cells = counts.astype(int)
        self.grid = Grid(
            tuple((lower + np.where(flat, 0.5 * extent, 0.0)).tolist()),
            tuple(np.where(flat, step, extent / np.maximum(cells, 1)).tolist()),
            tuple((cells + 1).tolist()),
        )
        for length, between, count in zip(lengths, self.grid.spacing, self.grid.nodes, strict=True):
            fine = count == 1 or length >= NODES_PER_LENGTH * between * (1.0 - 1e-9)
            require(fine, "length", f"at least {NODES_PER_LENGTH:g} times the spacing of {between:.3g} m", length)
        nodes, steps = np.array(self.grid.nodes), np.array(self.grid.spacing)
        check_size("length", nodes + 2.0 * np.where(nodes == 1, 0.0, np.ceil(np.array(lengths) / steps)))
        self.offset, low, high = self.mean, settings.lower, settings.upper
        if low is not None and high is not None:
            self.offset = float(logit((self.mean - low) / (high - low)))
            stated = deviation
            ends = [self.deviation(np.zeros(1), width)[0] for width in (1e-9, WIDEST)]
            # Close beside a bound rounding leaves no band.
            require(ends[0] < stated < ends[1], "deviation", f"one from {ends[0]:.3g} to {ends[1]:.3g}", stated)
            deviation = brentq(lambda width: self.deviation(np.zeros(1), width)[0] - stated, 1e-9, WIDEST)
        self.prior = FieldPrior(self.grid, deviation, lengths)
        particles = initial_particles(scene)
        own = np.full(len(particles.mass), True) if settings.mass is None else particles.mass == settings.mass
        self.inside: NDArray[np.bool_] = self.grid.weights(particles.positions).T @ own.astype(np.float64) > 0.0
        """Which nodes some particle lies beside, shape [K]."""

    def check_bounds(self, scene: Scene) -> None:
        """Raise InputError, which names the key, for a bound at which `scene` could not be simulated."""
        others = tuple(each for each in scene.fields if each.quantity != self.settings.quantity)
        for key, bound in (("lower", self.settings.lower), ("upper", self.settings.upper)):
            try:
                if bound is not None:
                    # The bound itself is never reached.
                    values = np.full(self.grid.count, bound + 1e-6 * (self.mean - bound))
                    dataclasses.replace(scene, fields=(*others, self.of_values(values)))
            except InputError as error:
                message = f"expected a bound at which the scene can be simulated, but {error}"
                raise InputError(message, key=key) from None

    @property
    def unit(self) -> str:
        """Of its values."""
        return UNITS[self.settings.quantity]

    def values(self, latent: Floats) -> Floats:
        """f of u, both [..., K]."""
        low, high = self.settings.lower, self.settings.upper
        if low is None or high is None:
            return np.asarray(latent + self.offset)
        return np.asarray(low + (high - low) * expit(latent + self.offset))

    def slope(self, latent: Floats) -> Floats:
        """df/du, shape [K]."""
        low, high = self.settings.lower, self.settings.upper
        if low is None or high is None:
            return np.ones_like(latent)
        share = expit(latent + self.offset)
        return np.asarray((high - low) * share * (1.0 - share))

    def deviation(self, latent: Floats, width: Floats | float) -> Floats:
        """Standard deviation of f where u is normal about `latent` [K] with deviation `width` [K]: that of its band."""
        ends = [self.values(latent + sign * BAND * width) for sign in (1.0, -1.0)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * BAND))

    def field(self, latent: Floats) -> Field:
        """As a scene has it, of u [K]."""
        return self.of_values(self.values(latent))

    def of_values(self, values: Floats) -> Field:
        """A field with `values` [K]."""
        grid, own = self.grid, self.settings
        place = {"origin": grid.origin, "spacing": grid.spacing, "nodes": grid.nodes, "mass": own.mass}
        return Field(quantity=own.quantity, values=tuple(values.tolist()), **place)  # type: ignore[arg-type]

    def at_nodes(self, gradient: "Gradient", latent: Floats) -> Floats:
        """dJ/du [K] from the gradient with respect to what a run begins with."""
        particles, field = gradient.particles, self.field(latent)
        each = gradient.material(FRICTION) if field.quantity == FRICTION else gradient.velocities[:, field.axis]
        if field.mass is not None:
            each = np.where(particles.mass == field.mass, each, 0.0)
        return np.asarray((self.grid.weights(particles.positions).T @ each) * self.slope(latent))


def checked(settings: Parameter, scene: Scene) -> tuple[tuple[float, ...], tuple[float, ...], float, float]:
    """Spacing, correlation lengths, mean and deviation. Raises InputError for a prior that no field can have."""
    spacing, length = cast("tuple[float, ...]", settings.spacing), settings.length
    mean, deviation = cast("float", settings.mean), cast("float", settings.deviation)
    kinds, masses = (FRICTION, *VELOCITIES[: scene.dimension]), range(len(scene.masses))
    plain = settings.name in (settings.quantity, f"masses[{settings.mass}].{settings.quantity}")
    known = f"one of {', '.join(kinds)}, of all masses or as masses[0].{kinds[0]}, for a field"
    require(plain and settings.quantity in kinds, "name", known, repr(settings.name))
    require(settings.mass is None or settings.mass in masses, "name", f"a mass of 0 to {masses[-1]}", settings.mass)
    lengths = length if isinstance(length, tuple) else (cast("float", length),) * scene.dimension
    for key, values in (("spacing", spacing), ("length", lengths)):
        require(len(values) == scene.dimension, key, f"{scene.dimension} lengths", list(values))
    low, high = settings.lower, settings.upper
    require((low is None) == (high is None), "upper" if high is None else "lower", "both bounds or none", "one")
    if settings.quantity == FRICTION:
        require(low is not None, "lower", "bounds in (0, 90) degrees of a friction", "none")
    if low is not None and high is not None:
        most = MOST * (high - low) / (2.0 * BAND)
        message = f"less than {most:.3g}, or the band of 95 % would be all between the bounds"
        require(deviation < most, "deviation", message, deviation)
        require(low < mean < high, "mean", f"a value between the bounds {low:g} and {high:g}", mean)
    return spacing, lengths, mean, deviation


def check_size(key: str, nodes: Floats) -> None:
    """Raise InputError where a field with so many nodes along each axis, those beyond it included, fits no memory."""
    count = float(np.prod(nodes))
    require_memory(BYTES * COLUMNS * count, "an unknown field", f"{count:.3g} nodes are too many", key=key)


class FieldPrior:
    """A Gaussian field of mean 0 on the K nodes of a grid, as a linear function of W independent normal numbers."""

    def __init__(self, grid: Grid, deviation: float, lengths: Sequence[float]) -> None:
        """deviation: standard deviation at every node; lengths: of correlation along each axis [m]."""
        self.grid, self.deviation = grid, deviation
        # Along an axis with one node the field does not vary.
        dimension = sum(count > 1 for count in grid.nodes)
        scales = np.array(lengths) / math.sqrt(8.0 * (2.0 - 0.5 * dimension))  # nu
        margins = [
            0 if count == 1 else math.ceil(length / step)
            for count, length, step in zip(grid.nodes, lengths, grid.spacing, strict=True)
        ]
        shape = [count + 2 * margin for count, margin in zip(grid.nodes, margins, strict=True)]
        masses = [lumped_mass(count, step) for count, step in zip(shape, grid.spacing, strict=True)]
        operator = mass = reduce(sparse.kron, masses)
        for axis, (count, step) in enumerate(zip(shape, grid.spacing, strict=True)):
            factors = [stiffness(count, step) if other == axis else each for other, each in enumerate(masses)]
            operator = operator + scales[axis] ** 2 * reduce(sparse.kron, factors)
        self.root_mass: Floats = np.sqrt(mass.diagonal())
        self.operator = sparse.csc_array(operator)
        self.factor = splu(self.operator)
        inner = [slice(margin, margin + count) for margin, count in zip(margins, grid.nodes, strict=True)]
        self.inner: NDArray[np.int64] = np.arange(math.prod(shape)).reshape(shape)[tuple(inner)].ravel()
        """The nodes of the field among those of the operator, shape [K]."""

    @property
    def size(self) -> int:
        """W."""
        return len(self.root_mass)

    @cached_property
    def scale(self) -> Floats:
        """Of S: the stated deviation over that of A w at each node, shape [K]."""
        found = np.empty(self.grid.count)
        for first in range(0, len(found), COLUMNS):
            nodes = self.inner[first : first + COLUMNS]
            units = np.zeros((self.size, len(nodes)))
            units[nodes, np.arange(len(nodes))] = 1.0
            rows = self.root_mass[:, None] * self.factor.solve(units)
            found[first : first + COLUMNS] = self.deviation / np.sqrt((rows**2).sum(axis=0))
        return found

    def field(self, white: Floats) -> Floats:
        """u [K, ...] of w [W, ...]."""
        flat = white.reshape(self.size, -1)
        found = self.factor.solve(self.root_mass[:, None] * flat)[self.inner] * self.scale[:, None]
        return np.asarray(found.reshape(-1, *white.shape[1:]))

    def white(self, adjoint: Floats) -> Floats:
        """The transpose of `field`: derivatives with respect to w [W, ...] of those with respect to u [K, ...]."""
        flat = adjoint.reshape(self.grid.count, -1)
        full = np.zeros((self.size, flat.shape[1]))
        full[self.inner] = flat * self.scale[:, None]
        found = self.root_mass[:, None] * self.factor.solve(full)
        return np.asarray(found.reshape(-1, *adjoint.shape[1:]))


def lumped_mass(count: int, step: float) -> Any:
    """Of linear elements along a line, half of one at its ends; sparse."""
    lengths = np.full(count, step)
    if count > 1:
        lengths[[0, -1]] *= 0.5
    return sparse.diags_array(lengths)


def stiffness(count: int, step: float) -> Any:
    """int phi_i' phi_j' of linear elements along a line; sparse."""
    slopes = sparse.diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1], shape=(count - 1, count))
    return slopes.T @ slopes / step
