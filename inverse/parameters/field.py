"""An unknown field: nodes over the body, a transform that keeps it between its bounds, a prior.

    f = T(u + m),    u Gaussian of mean 0 (`inverse.parameters.prior`)
    T(z) = lower + (upper - lower) / (1 + exp(-z))    with bounds, else T(z) = z

m and the deviation of u are such that the stated mean is the median of f, and the band of 95 % about it 1.96 times the
stated deviation to either side on average. Everywhere the standard deviation of a field stands for this width.
"""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import expit, logit

from datasets.errors import InputError
from datasets.field import FRICTION, VELOCITIES, Field, Grid
from datasets.particles import initial_particles
from datasets.scene import Scene
from inverse.parameters.parameter import Parameter
from inverse.parameters.prior import Prior

if TYPE_CHECKING:
    from mpm.adjoint.gradient import Gradient

Floats = NDArray[np.float64]

NODES_PER_LENGTH = 2.0
"""Correlation length over the spacing of the nodes, at least: with fewer the covariance is not the stated one."""
BAND = 1.959963984540054
"""Half-width of a band of 95 %, in standard deviations of a normal distribution."""
MOST = 0.9
"""Width of the prior's band over the distance of the bounds, at most."""
WIDEST = 100.0
"""Deviation of u with which every band is as wide as its bounds."""
UNITS = {FRICTION: "deg"} | dict.fromkeys(VELOCITIES, "m/s")
LABELS = {FRICTION: "friction"} | {name: f"velocity along {name[-1]}" for name in VELOCITIES}


class UnknownField:
    """One unknown field over the masses of a scene; K values at nodes, W numbers of the prior. Raises InputError."""

    def __init__(self, settings: Parameter, scene: Scene) -> None:
        spacing, lengths, mean, deviation = checked(settings, scene)
        self.settings = settings
        masses = scene.masses if settings.mass is None else (scene.masses[settings.mass],)
        lower = np.min([mass.lower for mass in masses], axis=0)
        upper = np.max([np.add(mass.lower, mass.size) for mass in masses], axis=0)
        cells = [
            0 if step > length * (1.0 + 1e-6) else math.ceil(length / step - 1e-6)
            for length, step in zip(upper - lower, spacing, strict=True)
        ]
        self.grid = Grid(
            tuple((lower + np.where(np.array(cells) == 0, 0.5 * (upper - lower), 0.0)).tolist()),
            tuple(
                float(length / count) if count else step
                for length, count, step in zip(upper - lower, cells, spacing, strict=True)
            ),
            tuple(count + 1 for count in cells),
        )
        for length, step, count in zip(lengths, self.grid.spacing, self.grid.nodes, strict=True):
            if count > 1 and length < NODES_PER_LENGTH * step * (1.0 - 1e-9):
                message = f"expected at least {NODES_PER_LENGTH:g} times the spacing of {step:.3g} m, got {length:g}"
                raise InputError(message, key="length")
        self.offset, low, high = mean, settings.lower, settings.upper
        if low is not None and high is not None:
            self.offset = float(logit((mean - low) / (high - low)))
            stated = deviation
            deviation = brentq(lambda width: self.deviation(np.zeros(1), width)[0] - stated, 1e-9, WIDEST)
        self.prior = Prior(self.grid, deviation, lengths)
        self.inside: NDArray[np.bool_] = self.support(scene) > 0.0
        """Which nodes some particle lies beside, shape [K]."""

    @property
    def name(self) -> str:
        """In files and reports."""
        return self.settings.name

    @property
    def unit(self) -> str:
        """Of its values."""
        return UNITS[self.settings.quantity]

    def support(self, scene: Scene) -> Floats:
        """Particles of the initial body that each node stands for, shape [K]."""
        particles = initial_particles(scene)
        every, own = np.full(len(particles.mass), True), self.settings.mass
        here = every if own is None else particles.mass == own
        return np.asarray(self.grid.weights(particles.positions).T @ here.astype(np.float64))

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
        grid, settings = self.grid, self.settings
        values = tuple(self.values(latent).tolist())
        return Field(
            quantity=settings.quantity,
            origin=grid.origin,
            spacing=grid.spacing,
            nodes=grid.nodes,
            values=values,
            mass=settings.mass,
        )

    def at_nodes(self, gradient: "Gradient", latent: Floats) -> Floats:
        """dJ/du [K] from the gradient with respect to what a run begins with."""
        particles, field = gradient.particles, self.field(latent)
        each = gradient.material(FRICTION) if field.quantity == FRICTION else gradient.velocities[:, field.axis]
        if field.mass is not None:
            each = np.where(particles.mass == field.mass, each, 0.0)
        return np.asarray((self.grid.weights(particles.positions).T @ each) * self.slope(latent))

    def check_bounds(self, scene: Scene) -> None:
        """Raise InputError where `scene` cannot have the field at one of its bounds."""
        settings = self.settings
        for value, key in ((settings.lower, "lower"), (settings.upper, "upper")):
            if value is None or settings.mean is None:
                continue
            # The bound itself is never reached.
            near = (value + 1e-6 * (settings.mean - value),) * self.grid.count
            others = tuple(each for each in scene.fields if each.quantity != settings.quantity)
            try:
                uniform = dataclasses.replace(self.field(np.zeros(self.grid.count)), values=near)
                dataclasses.replace(scene, fields=(*others, uniform))
            except InputError as error:
                message = f"expected a bound at which the scene can be simulated, but {error}"
                raise InputError(message, key=key) from None


def checked(settings: Parameter, scene: Scene) -> tuple[tuple[float, ...], tuple[float, ...], float, float]:
    """Spacing, correlation lengths, mean and deviation. Raises InputError for a prior that no field can have."""

    def require(ok: bool, key: str, expected: str, got: object) -> None:
        if not ok:
            raise InputError(f"expected {expected}, got {got}", key=key)

    spacing, length, mean, deviation = settings.spacing, settings.length, settings.mean, settings.deviation
    assert spacing is not None, "a number has no nodes"
    assert length is not None, "`inverse.checks` asks for it"
    assert mean is not None, "`inverse.checks` asks for it"
    assert deviation is not None, "`inverse.checks` asks for it"
    kinds, masses = (FRICTION, *VELOCITIES[: scene.dimension]), range(len(scene.masses))
    plain = settings.name in (settings.quantity, f"masses[{settings.mass}].{settings.quantity}")
    known = f"one of {', '.join(kinds)}, of all masses or as masses[0].{kinds[0]}, for a field"
    require(plain and settings.quantity in kinds, "name", known, repr(settings.name))
    require(settings.mass is None or settings.mass in masses, "name", f"a mass of 0 to {masses[-1]}", settings.mass)
    lengths = length if isinstance(length, tuple) else (length,) * scene.dimension
    for key, values in (("spacing", spacing), ("length", lengths)):
        positive = len(values) == scene.dimension and min(values) > 0.0
        require(positive, key, f"{scene.dimension} positive lengths in m", list(values))
    require(deviation > 0.0, "deviation", "a positive standard deviation", deviation)
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
