"""An unknown field: nodes over the body, a transform that keeps it between its bounds, a prior.

    f = T(u + m),    u Gaussian of mean 0
    T(z) = lower + (upper - lower) / (1 + exp(-z))    with bounds, else T(z) = z

The stated mean is the median of f. Its 95 % band extends on average by 1.96 times the stated deviation to either side:
the standard deviation of a field always means this width over 1.96. The prior of u is smooth:

    (1 - sum_a s_a^2 d^2/dx_a^2) u = white noise,    s_a = length_a / sqrt(8 nu),    nu = 2 - D / 2

Its solution has the Matern covariance (Whittle 1954; Lindgren, Rue & Lindstroem, An explicit link between Gaussian
fields and Gaussian Markov random fields, J. R. Stat. Soc. B 73 (2011) 423-498),

    rho(r) = 2^(1 - nu) / Gamma(nu) (kappa r)^nu K_nu(kappa r),    kappa r = |(x - x') / s|,

0.14 at a distance of `length` in 2D (nu = 1) and in 3D (nu = 1/2). By bilinear elements with lumped mass on the nodes,

    K = M + sum_a s_a^2 G_a,    covariance K^-1 M K^-1 = A A^T,    A = K^-1 M^(1/2)

with M the mass and G_a the stiffness along axis a. A field from white noise w, u = S A w, needs one sparse solution.
The operator extends a correlation length beyond the field; S selects its nodes and scales each to the stated deviation.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq
from scipy.special import expit, logit

from datasets.errors import InputError, naming, require
from datasets.geometry.bodies import filling
from datasets.geometry.contact_surface import has_faces, has_field
from datasets.geometry.ground import ground_grid, interpolated
from datasets.memory import require as require_memory
from datasets.scene import Scene
from datasets.scene.grid_field import FRICTION, THICKNESS, VELOCITIES, Field, Floats, Grid
from datasets.scene.particles import initial_particles
from inverse.parameters import Parameter
from inverse.parameters.field_prior import COLUMNS, FieldPrior, ZonePrior

if TYPE_CHECKING:
    from mpm.adjoint.gradient import Gradient


NODES_PER_LENGTH = 2.0  # least correlation length over the node spacing: below it the covariance is not as stated
BAND = 1.959963984540054  # half-width of a band of 95 %, in standard deviations of a normal distribution
MOST = 0.9  # largest width of the prior's band over the distance of the bounds
WIDEST = 100.0  # deviation of u with which every band is as wide as its bounds
BYTES = 24  # for each node and right-hand side: the side, its solution and their squares
BED = "friction"  # what varies over a terrain: the last part of `solids[0].friction`
UNITS = {FRICTION: "deg", THICKNESS: "m", BED: ""} | dict.fromkeys(VELOCITIES, "m/s")
LABELS = {FRICTION: "friction", THICKNESS: "thickness", BED: "friction of the bed"}
LABELS |= {name: f"velocity along {name[-1]}" for name in VELOCITIES}
BOUNDED = {FRICTION: "friction, in (0, 90) degrees", THICKNESS: "thickness, above 0 m"}
BOUNDED |= {BED: "coefficient, of at least 0"}
"""Quantities that are impossible beyond some values."""
MOST_ZONES = 1000
NEARLY = 1.0e-6  # part of a raster's cell that counts as none
DIGITS, UNEVEN = 9, 1.0e-7
"""Decimals of a coefficient at the posts of a terrain; increment of one post if all would have the same value."""


class UnknownField:
    """One unknown field over the masses or the terrain of a scene; K values, W numbers of the prior. Values are given
    at the nodes of a grid over the particles, in plan for a thickness or the friction of a terrain, or one for each
    zone of a terrain. Raises InputError."""

    def __init__(self, settings: Parameter, scene: Scene, folder: Path = Path()) -> None:
        """folder: to which the path of a raster of zones is relative."""
        self.settings, self.in_plan = settings, settings.quantity in (THICKNESS, BED)
        spacing, lengths, self.mean, deviation = checked(settings, scene)
        self.zones = None if settings.zones is None else Zones(folder / settings.zones, scene, self.posts(scene))
        if self.zones is not None:
            self.grid, lengths = Grid((0.0,), (1.0,), (len(self.zones.numbers),)), ()
        else:
            self.grid = self.laid(scene, np.array(spacing))
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
            # Close to a bound, rounding leaves no band.
            require(ends[0] < stated < ends[1], "deviation", f"one from {ends[0]:.3g} to {ends[1]:.3g}", stated)
            deviation = brentq(lambda width: self.deviation(np.zeros(1), width)[0] - stated, 1e-9, WIDEST)
        independent = self.zones is not None
        self.prior = ZonePrior(self.grid, deviation) if independent else FieldPrior(self.grid, deviation, lengths)
        beside = self.weights(self.posts(scene) if settings.solid is not None else self.places(scene))
        self.inside: NDArray[np.bool_] = np.asarray(abs(beside).sum(axis=0)).ravel() > 0.0
        """Which nodes have a particle next to them or, on a terrain, a post in the box; shape [K]."""

    def laid(self, scene: Scene, step: Floats) -> Grid:
        """Its nodes, at most `step` [m] apart, over its masses or, on a terrain, over the box."""
        masses = scene.masses if self.settings.mass is None else (scene.masses[self.settings.mass],)
        lower = np.min([mass.lower for mass in masses], axis=0)
        upper = np.max([np.add(mass.lower, mass.size) for mass in masses], axis=0)
        if self.settings.solid is not None:
            lower, upper = np.zeros(scene.dimension), np.array(scene.domain.size)
        if self.in_plan:
            lower, upper = lower[::2], upper[::2]
        extent = upper - lower
        flat = step > extent * (1.0 + 1e-6)
        counts = np.where(flat, 0.0, np.ceil(extent / step - 1e-6))
        check_size("spacing", counts + 1.0)
        cells = counts.astype(int)
        return Grid(
            tuple((lower + np.where(flat, 0.5 * extent, 0.0)).tolist()),
            tuple(np.where(flat, step, extent / np.maximum(cells, 1)).tolist()),
            tuple((cells + 1).tolist()),
        )

    def check_bounds(self, scene: Scene) -> None:
        """Raise InputError, which names the key, for a bound at which `scene` could not be simulated."""
        for key, bound in (("lower", self.settings.lower), ("upper", self.settings.upper)):
            try:
                if bound is not None:
                    # The bound itself is never reached.
                    self.put(scene, np.full(self.grid.count, bound + 1e-6 * (self.mean - bound)))
            except InputError as error:
                message = f"expected a bound at which the scene can be simulated, but {error}"
                raise InputError(message, key=key) from None

    @property
    def median(self) -> Floats:
        """Median of its prior, shape [K]."""
        return self.values(np.zeros(self.grid.count))

    @property
    def unit(self) -> str:
        """Unit of its values; empty for a coefficient."""
        return UNITS[self.settings.quantity]

    @property
    def axes(self) -> tuple[str, ...]:
        return ("zone",) if self.zones is not None else ("x", "z") if self.in_plan else ("x", "y", "z")

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
        """Standard deviation of f, from its band, if u is normal about `latent` [K] with deviation `width` [K]."""
        ends = [self.values(latent + sign * BAND * width) for sign in (1.0, -1.0)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * BAND))

    def weights(self, places: Floats) -> Any:
        """Sparse matrix [N, K] that maps values to `places` [m], [N, D], in plan [N, D - 1]."""
        return self.grid.weights(places) if self.zones is None else self.zones.weights(places)

    def posts(self, scene: Scene) -> Floats:
        """Places in plan of the heights of its terrain [m], shape [posts, 2]."""
        solid = scene.solids[self.settings.solid or 0]
        counts = np.array(solid.heights).shape
        rows = zip(solid.origin or (), solid.spacing or (), counts, strict=True)
        axes = np.meshgrid(*(first + step * np.arange(count) for first, step, count in rows), indexing="ij")
        return np.stack(axes, axis=-1).reshape(-1, 2)

    def places(self, scene: Scene) -> Floats:
        """Places at which its particles take their values [m], shape [n, D], in plan [n, D - 1]."""
        if self.settings.quantity != THICKNESS:
            particles = initial_particles(scene)
            places = particles.positions[self.of(particles.mass)]
            return places[:, ::2] if self.in_plan else places
        masses = [mass for index, mass in enumerate(scene.masses) if self.settings.mass in (None, index)]
        return np.concatenate([filling(scene, mass).lattice[:, ::2] for mass in masses])

    def of(self, mass: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which particles have the field, from the index of their mass, both [N]."""
        return np.full(len(mass), True) if self.settings.mass is None else mass == self.settings.mass

    def put(self, scene: Scene, values: Floats) -> Scene:
        """The scene with `values` [K] of the field. Raises InputError."""
        settings, grid = self.settings, self.grid
        if settings.solid is not None:
            solids = list(scene.solids)
            shape = np.array(solids[settings.solid].heights).shape
            rows = np.round(self.weights(self.posts(scene)) @ values, DIGITS).reshape(shape)
            # For equal friction at all posts the solver would use one number, with one derivative.
            rows[0, 0] += UNEVEN if np.ptp(rows) == 0.0 else 0.0
            solids[settings.solid] = replace(solids[settings.solid], friction=tuple(map(tuple, rows.tolist())))
            return replace(scene, solids=tuple(solids))
        place = {"origin": grid.origin, "spacing": grid.spacing, "nodes": grid.nodes, "mass": settings.mass}
        field = Field(quantity=settings.quantity, values=tuple(values.tolist()), **place)  # type: ignore[arg-type]
        others = (other for other in scene.fields if (other.quantity, other.mass) != (settings.quantity, settings.mass))
        return replace(scene, fields=(*others, field))

    def truth(self, scene: Scene) -> Floats | None:
        """The field of `scene` itself at the nodes, for a zone the mean over its posts, NaN without posts, [K]; None
        without a field."""
        settings = self.settings
        if settings.solid is None:
            of_this = settings.quantity, settings.mass
            same = [field for field in scene.fields if (field.quantity, field.mass) == of_this]
            return same[0].weights(self.grid.positions) @ np.array(same[0].values) if same else None
        axes, _, friction = ground_grid(scene.solids[settings.solid], f"solids[{settings.solid}]", scene.domain)
        if self.zones is None:
            return interpolated(axes, friction, self.grid.positions)
        weights = self.weights(posts := self.posts(scene))
        sums, counts = weights.T @ interpolated(axes, friction, posts), weights.sum(axis=0)
        return np.asarray(np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0.0))

    def at_nodes(
        self, gradient: "Gradient", values: Floats, explicit: Floats, slopes_by_name: dict[str, Any]
    ) -> Floats:
        """dJ/df [K] at `values` [K], from the gradient with respect to a run's initial state.
        explicit: derivatives of J with respect to the particles' volumes, if it depends on them directly, [N];
        slopes_by_name: field name -> the part of this run that is the same for every J."""
        scene, settings, particles = gradient.scene, self.settings, gradient.particles
        if not self.in_plan:
            here, places = self.of(particles.mass), particles.positions
            if settings.name not in slopes_by_name:
                slopes_by_name[settings.name] = [self.grid.weights(places), *self.grid.slopes(places)]
            derivatives = [gradient.material(FRICTION)]
            if settings.quantity != FRICTION:
                # The field also sets the affine motion of the particles.
                axis = VELOCITIES.index(settings.quantity)
                derivatives = [gradient.velocities[:, axis], *gradient.velocity_gradients[:, axis].T]
            pairs = zip(slopes_by_name[settings.name], derivatives, strict=False)
            return np.asarray(sum(rows.T @ np.where(here, by_particle, 0.0) for rows, by_particle in pairs))
        relative, places = settings.quantity == THICKNESS, self.places(scene)
        if settings.name not in slopes_by_name:

            def scene_at(change: float) -> Scene:
                return self.put(scene, values * (1.0 + change) if relative else values + change)

            slopes_by_name[settings.name] = gradient.slopes(scene_at, 0.0)
        shares, posts = gradient.shared(slopes_by_name[settings.name])
        if relative:
            # Volumes and heights above the ground are proportional to the thickness.
            weights, here = self.weights(places), self.of(particles.mass)
            nodes = weights.T @ ((shares + explicit * particles.volume)[here] / (weights @ values))
        else:
            nodes = self.at_posts(scene).reshape(-1, self.grid.count).T @ posts
            if shares.any():
                nodes = nodes + self.on_bed(scene, places).T @ shares
        return np.asarray(nodes)

    def at_posts(self, scene: Scene) -> Floats:
        """Shares of the values in the friction at each post of the ground, also beyond the box, shape [X, Z, K]."""
        solid, weights = scene.solids[self.settings.solid or 0], self.weights(self.posts(scene)).toarray()
        # The index of each post, passed instead of its friction, shows where the ground takes it from.
        numbers = np.arange(len(weights)).reshape(np.array(solid.heights).shape)
        numbered = replace(solid, friction=tuple(map(tuple, numbers.astype(float).tolist())))
        return np.asarray(weights[ground_grid(numbered, "solids", scene.domain)[2].astype(int)])

    def on_bed(self, scene: Scene, plan: Floats) -> Floats:
        """Shares of the values in the friction at places in plan [m], [N, 2], bilinear between the posts; [N, K]."""
        axes = ground_grid(scene.solids[self.settings.solid or 0], "solids", scene.domain)[0]
        return np.asarray(RegularGridInterpolator(axes, self.at_posts(scene))(plan))


class Zones:
    """Zones of a terrain, by a raster of their numbers. Raises InputError."""

    def __init__(self, path: Path, scene: Scene, posts: Floats) -> None:
        """posts: places in plan of the heights of the terrain [m], [N, 2]; those in the box need a zone."""
        # Imported here: it takes half a second, which problems without rasters do not need.
        from datasets.exchange.rasters import read_raster, same_system
        from datasets.maps import map_corner

        raster, (corner, crs) = read_raster(path, coefficients=True), map_corner(scene)
        self.first, self.spacing = np.subtract((raster.x[0], raster.z[0]), corner), np.array(raster.spacing)
        self.numbers, which = np.unique(raster.values, return_inverse=True)  # of the zones, ascending, shape [K]
        with naming(path):
            require(same_system(crs, raster), "", f"the reference system of the scene, {crs}", raster.crs)
            whole = bool(np.isfinite(self.numbers).all() and (self.numbers == np.round(self.numbers)).all())
            require(whole, "", "the whole number of a zone in every cell", "others")
            require(len(self.numbers) <= MOST_ZONES, "", f"at most {MOST_ZONES} zones", len(self.numbers))
            self.which = which.reshape(raster.values.shape)
            needed = np.clip(posts, 0.0, scene.domain.size[::2]) + corner
            ends = needed.min(axis=0), needed.max(axis=0)
            covered = np.array(raster.corner), raster.corner + self.spacing * self.which.shape
            beyond = np.maximum(covered[0] - ends[0], ends[1] - covered[1])
            box, got = ("x, z of {:.10g}, {:.10g} to {:.10g}, {:.10g} m".format(*a, *b) for a, b in (ends, covered))
            whole = bool((beyond <= (0.5 + NEARLY) * self.spacing).all())
            require(whole, "", f"zones over the terrain in the box, {box}, or to half a cell of it", got)

    def weights(self, plan: Floats) -> Any:
        """Sparse [N, K]: 1 for the zone of the raster cell nearest to each place [m], [N, 2]."""
        # A tie goes up. To even numbers, posts on the edges of cells would leave out every second column.
        cells = np.floor((plan - self.first) / self.spacing + 0.5 + NEARLY)
        nearest = tuple(np.clip(cells, 0, np.array(self.which.shape) - 1).astype(int).T)
        ones = np.ones(len(plan)), (np.arange(len(plan)), self.which[nearest])
        return sparse.csr_array(ones, (len(plan), len(self.numbers)))


def checked(settings: Parameter, scene: Scene) -> tuple[tuple[float, ...], tuple[float, ...], float, float]:
    """Spacing, correlation lengths, mean and deviation. Raises InputError for a prior that no field can have."""
    spacing, length = settings.spacing or (), settings.length
    mean, deviation = cast("float", settings.mean), cast("float", settings.deviation)
    kinds, masses = (FRICTION, THICKNESS, *VELOCITIES[: scene.dimension]), range(len(scene.masses))
    name, quantity, solid = settings.name, settings.quantity, settings.solid
    dimension = scene.dimension
    if solid is not None:
        check_bed(settings, scene)
        dimension -= 1
    else:
        plain = name in (quantity, f"masses[{settings.mass}].{quantity}")
        listed = ", ".join(kinds)
        expected = f"one of {listed}, of all masses or as masses[0].{kinds[0]}, or solids[0].friction, for a field"
        require(plain and quantity in kinds, "name", expected, repr(name))
        require(settings.mass is None or settings.mass in masses, "name", f"a mass of 0 to {masses[-1]}", settings.mass)
        require(settings.zones is None, "zones", "none but of the friction of a terrain", settings.zones)
    if quantity == THICKNESS:
        dimension -= 1
        for index, mass in enumerate(scene.masses):
            layer = mass.kind == "layer" or settings.mass not in (None, index)
            require(layer, "name", "a mass of kind layer", f"masses[{index}], a {mass.kind}")
    lengths = length if isinstance(length, tuple) else (cast("float", length),) * dimension
    for key, values in (("spacing", spacing), ("length", lengths)) if settings.zones is None else ():
        require(len(values) == dimension, key, f"{dimension} lengths", list(values))
    low, high = settings.lower, settings.upper
    require((low is None) == (high is None), "upper" if high is None else "lower", "both bounds or none", "one")
    if quantity in BOUNDED:
        require(low is not None, "lower", f"bounds of a {BOUNDED[quantity]}", "none")
    if low is not None and high is not None:
        most = MOST * (high - low) / (2.0 * BAND)
        message = f"less than {most:.3g}, or the band of 95 % would be all between the bounds"
        require(deviation < most, "deviation", message, deviation)
        require(low < mean < high, "mean", f"a value between the bounds {low:g} and {high:g}", mean)
    return spacing, lengths, mean, deviation


def check_bed(settings: Parameter, scene: Scene) -> None:
    """Raise InputError if the friction of a terrain cannot be a field."""
    index, count = settings.solid or 0, len(scene.solids)
    require(settings.name == f"solids[{index}].friction", "name", f"solids[{index}].friction", repr(settings.name))
    require(index < count, "name", f"an index below {count}, the number of solids in the scene", index)
    alone = has_field(scene) and not has_faces(scene)
    require(alone, "name", "a terrain in 3D that is the only solid, for a field of its friction", settings.name)
    slides = scene.solids[index].contact == "coulomb"
    require(slides, "name", "a terrain on which material slides", f"one with contact {scene.solids[index].contact!r}")


def check_size(key: str, nodes: Floats) -> None:
    """Raise InputError if a field with `nodes` along each axis, including those beyond it, exceeds the memory."""
    count = float(np.prod(nodes))
    require_memory(BYTES * COLUMNS * count, "an unknown field", f"{count:.3g} nodes are too many", key=key)
