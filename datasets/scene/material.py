"""Material: elastic constants and constants of the strength law; all stresses are in Pa, tension positive.

The law is Mohr-Coulomb, with the constants below, unless `law` names another one of `mpm.laws`. The keys of that law
are then `constants`, which it checks when the MPM takes the scene.

docs/theory/return-map.md gives the following equations and their sources:

- **Tension**: a crack opens where a principal stress reaches T = `tension_cutoff`, at most the apex c cot(phi) of the
  cone, by default `TENSION_SHARE` c at every depth.
- **Depth**: c(z) = cohesion + strength_gradient z; every particle keeps the cohesion of its initial depth z.
- **Softening**: sin phi, c cos phi and T are linear in the slip of a band one cell thick, from peak to residual values
  over `softening_length`; sin psi falls to 0. Without that length dilation **never ends**: wrong for flows.
- **Which angle**: "triaxial" is phi itself, "slope" is the angle on the plane that shears (`sine_of_slope`).
- **Rate of shear**: with a `friction_limit_deg`, friction grows with the inertial number (`mpm.physics.inertial`).
"""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from datasets.errors import InputError, keyed
from datasets.schema import Bounds, Record

Depth = TypeVar("Depth", float, NDArray[np.float64])

MOHR_COULOMB = "mohr-coulomb"
"""The default law of a material."""
USUAL_YOUNG = 2.0e6
"""Smallest default Young's modulus [Pa], for a material that gives none."""
STIFFEST = 1.0e15
"""Largest modulus and strength [Pa]: a thousand times those of diamond."""
LEAST_VOLUME_CHANGE = 0.4999
"""Largest Poisson's ratio: the bulk modulus is then 5,000 times the shear modulus, and beyond
that single precision loses the shear stress beside the pressure."""
ANGLES = {"triaxial": 90.0, "slope": 45.0}
"""How friction angles may have been measured -> upper bound of the angle [deg]."""
TENSION_SHARE = 0.003
"""Default tension cutoff over cohesion [-]."""
Density = Annotated[float, Bounds("a positive density in kg/m^3, 0.001 to 1e6", ge=1.0e-3, le=1.0e6)]
Modulus = Annotated[float, Bounds(f"a positive modulus in Pa, 0.001 to {STIFFEST:g}", ge=1.0e-3, le=STIFFEST)]
Strength = Annotated[float, Bounds(f"a strength of at least 0 Pa, up to {STIFFEST:g}", ge=0.0, le=STIFFEST)]
Growth = Annotated[float, Bounds(f"a growth of at least 0 Pa/m, up to {STIFFEST:g}", ge=0.0, le=STIFFEST)]
Ratio = Annotated[float, Bounds(f"a ratio in [0, {LEAST_VOLUME_CHANGE:g}]", ge=0.0, le=LEAST_VOLUME_CHANGE)]
Slip = Annotated[float, Bounds("a positive slip in m, 1e-9 to 1e9", ge=1.0e-9)]
Diameter = Annotated[float, Bounds("a positive length in m, 1e-9 to 1000", ge=1.0e-9, le=1.0e3)]
Inertial = Annotated[float, Bounds("a positive number, 1e-6 to 1e6", ge=1.0e-6, le=1.0e6)]
Permeability = Annotated[float | None, Bounds("a permeability of at least 0 m/s, up to 100", ge=0.0, le=100.0)]
Diffusivity = Annotated[float | None, Bounds("a coefficient of at least 0 m^2/s, up to 1e6", ge=0.0, le=1.0e6)]

SHARED = ("law", "constants", "density", "young", "poisson")  # keys of a material with any law
SOFTENING = ("friction_deg", "cohesion", "tension_cutoff")  # keys that have a residual value


def sine_of_slope(tangent: Any, psi: float) -> Any:
    """sin(phi) [-] from a slope's tan(angle) = sin phi cos psi / (1 - sin phi sin psi), psi in radians (Davis 1968).
    The tangent is a number, an array or a tensor."""
    return tangent / (math.cos(psi) + tangent * math.sin(psi))


@dataclass(frozen=True, kw_only=True)
class Material(Record):
    """Isotropic linear elasticity with a Mohr-Coulomb yield surface and a tension cutoff.

    For example:

        Material(friction_deg=30.0)  # dry sand
        Material(friction_deg=0.0, cohesion=2000.0, density=1900.0)  # undrained clay, by Tresca
        Material(law="von-mises", friction_deg=0.0, constants={"strength": 2000.0}, density=1900.0)
    """

    law: str = MOHR_COULOMB
    """Strength law: Mohr-Coulomb, or the name of another law of `mpm.laws`, whose keys then replace those of
    Mohr-Coulomb beside density and elasticity."""
    constants: dict[str, float] = field(default_factory=dict, hash=False)
    """The keys of another law, given together in Python, with `friction_deg` = 0."""
    friction_deg: float
    """Friction angle [deg], in [0, 90), of a slope in [0, 45); 0 (Tresca) needs a cohesion."""
    angle: Annotated[str, Bounds(f"one of {', '.join(ANGLES)}", words=tuple(ANGLES))] = "triaxial"
    """How friction angles were measured: "triaxial" (phi itself) or "slope" (on the plane that shears)."""
    friction_limit_deg: float | None = None
    """Friction angle at very high shear rates [deg], of the same `angle`; without it, friction is rate-independent."""
    inertial_number: Inertial = 0.279
    """I_0 [-], at which half of that growth is reached; default: glass beads."""
    grain_diameter: Diameter | None = None
    """Diameter of a grain [m], needed with a `friction_limit_deg`."""
    grain_density: Density = 2500.0
    """Density of the grains [kg/m^3], not of the bulk; default: about that of glass and quartz."""
    density: Density = 1800.0
    """Initial bulk density [kg/m^3]."""
    young: Modulus | None = None
    """Young's modulus [Pa]; default: 2 MPa, or more if the thickness and speed of the scene require it
    (`datasets.scene.stiffness`); the scene's material then holds that value."""
    poisson: Ratio = 0.3
    """Poisson's ratio [-], in [0, 0.4999]."""
    dilation_deg: float = 0.0
    """Dilation angle [deg], in [0, friction_deg]; without a `softening_length`, dilation never ends. Saturated material
    needs that length; it contracts if the angle is negative, down to -friction_deg."""
    cohesion: Strength = 0.0
    """Cohesion [Pa]; with a `strength_gradient`, the value at the top of the body."""
    strength_gradient: Growth = 0.0
    """Increase of the cohesion with initial depth below the top of the body [Pa/m]."""
    tension_cutoff: Strength | None = None
    """Largest tensile principal stress [Pa], at which cracks open; default: `TENSION_SHARE` times the cohesion.

    The apex c cot(phi) limits it from above."""
    softening_length: Slip | None = None
    """Slip of a shear band at which the residual values are reached [m]; default: no softening."""
    residual_friction_deg: float | None = None
    """Friction angle after softening [deg], in [0, friction_deg]; default: the peak value."""
    residual_cohesion: float | None = None
    """Cohesion after softening [Pa], at most `cohesion`, and at depth the same share of it; default: the peak value."""
    residual_tension_cutoff: float | None = None
    """Tension cutoff after softening [Pa], at most the peak value at the top; default: the peak value."""
    saturated: bool = False
    """Whether water fills the pores (`mpm.physics.water`): the effective stress then governs strength, and `density`
    includes grains and water."""
    permeability: Permeability = None
    """Permeability k of saturated material [m/s], with a `young`; without it and `consolidation`: undrained."""
    consolidation: Diffusivity = None
    """Coefficient of consolidation c_v of saturated material [m^2/s], instead of the permeability."""

    @model_validator(mode="before")
    @classmethod
    def gathered(cls, data: Any) -> Any:
        """The keys of a file, with the keys of another law moved into `constants`."""
        if not isinstance(data, dict) or data.get("law", MOHR_COULOMB) == MOHR_COULOMB:
            return data
        field_names = {member.name for member in dataclasses.fields(cls)}
        others = {key: value for key, value in data.items() if key not in field_names}
        constants = data.get("constants", {})
        if isinstance(constants, dict):
            for key in others.keys() & constants.keys():
                raise InputError("expected one value, another one stands in constants", key=f"material.{key}")
            constants = {**constants, **others}
        return {"friction_deg": 0.0, **{key: data[key] for key in data if key in field_names}, "constants": constants}

    def __post_init__(self) -> None:
        def require(ok: bool, key: str, expected: str) -> None:
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key):g}", key=f"material.{key}")

        with keyed("material"):
            super().__post_init__()
        if self.law != MOHR_COULOMB:
            for member in dataclasses.fields(self):
                value, usual = getattr(self, member.name), 0.0 if member.name == "friction_deg" else member.default
                if member.name not in SHARED and value != usual:
                    message = f"expected {MOHR_COULOMB} beside {member.name} = {value!r}, got {self.law!r}"
                    raise InputError(message, key="material.law")
        highest = ANGLES[self.angle]
        kind = "an angle" if self.angle == "triaxial" else "the angle of a slope"
        require(0.0 <= self.friction_deg < highest, "friction_deg", f"{kind} in [0, {highest:g}) degrees")
        loosest, span = (-self.friction_deg, "[-friction_deg") if self.saturated else (0.0, "[0")
        require(loosest <= self.dilation_deg <= self.friction_deg, "dilation_deg", f"an angle in {span}, friction_deg]")
        ends = self.dilation_deg == 0.0 or not self.saturated or self.softening_length is not None
        require(ends, "dilation_deg", "0 of saturated material without a softening_length, over which dilation ends")
        strong = self.friction_deg > 0.0 or self.cohesion > 0.0 or self.law != MOHR_COULOMB
        require(strong, "friction_deg", "an angle above 0 degrees where there is no cohesion")
        for key, peak in zip(SOFTENING, (self.friction_deg, self.cohesion, self.cutoff_at(0.0)), strict=True):
            value = getattr(self, f"residual_{key}")
            if value is not None:
                require(0.0 <= value <= peak, f"residual_{key}", f"a value in [0, {key}], at most {peak:g}")
                softens = self.softening_length is not None
                require(softens, f"residual_{key}", "no residual value without a softening_length")
        if self.friction_limit_deg is not None:
            slow = self.friction_deg if self.residual_friction_deg is None else self.residual_friction_deg
            expected = f"{kind} of at least {slow:g} degrees, that of slow shear, and below {highest:g}"
            require(slow <= self.friction_limit_deg < highest, "friction_limit_deg", expected)
            if self.grain_diameter is None:
                raise InputError("expected a value with friction_limit_deg, got none", key="material.grain_diameter")
        for key in ("permeability", "consolidation"):
            if getattr(self, key) is not None:
                require(self.saturated, key, "none of a material that is not saturated")
        if self.permeability is not None:
            require(self.consolidation is None, "permeability", "one of permeability and consolidation")
            require(self.young is not None, "permeability", "a young beside it (consolidation depends on both)")
        if self.residual_friction_deg == 0.0:
            strong = self.residual_cohesion != 0.0 and self.cohesion > 0.0
            require(strong, "residual_friction_deg", "an angle above 0 degrees where no cohesion remains")

    def constant(self, name: str) -> float:
        """A constant of any law, by its key."""
        return float(self.constants[name] if name in self.constants else getattr(self, name))

    def with_constant(self, name: str, value: float) -> "Material":
        """The same material with another value of a constant, of any law."""
        changes: dict[str, Any] = {name: value}
        if name in self.constants:
            changes = {"constants": {**self.constants, name: value}}
        return dataclasses.replace(self, **changes)

    @property
    def phi_deg(self) -> float:
        """Mohr-Coulomb angle of internal friction phi [deg]: `friction_deg` if `angle` is "triaxial"."""
        return self.phi_deg_of(self.friction_deg, self.dilation_deg)

    def phi_deg_of(self, friction_deg: Depth, dilation_deg: float = 0.0) -> Depth:
        """phi [deg] of a friction angle [deg] that was measured as `angle` says; a number or an array."""
        if self.angle == "triaxial":
            return friction_deg
        tangent = np.tan(np.radians(friction_deg))
        phi = np.asarray(np.degrees(np.arcsin(sine_of_slope(tangent, math.radians(dilation_deg)))))
        return phi if isinstance(friction_deg, np.ndarray) else float(phi)

    @property
    def slope_deg(self) -> float:
        """The friction angle on the plane that shears [deg]: `friction_deg` if `angle` is "slope"."""
        sine, psi = math.sin(math.radians(self.phi_deg)), math.radians(self.dilation_deg)
        return math.degrees(math.atan2(sine * math.cos(psi), 1.0 - sine * math.sin(psi)))

    @property
    def friction(self) -> float:
        """tan(phi) [-]."""
        return math.tan(math.radians(self.phi_deg))

    @property
    def sin_phi_limit(self) -> float:
        """sin(phi) [-] at very high shear rates; 0 if friction does not depend on the rate."""
        if self.friction_limit_deg is None:
            return 0.0
        return math.sin(math.radians(self.phi_deg_of(self.friction_limit_deg)))

    @property
    def inertial_rate(self) -> float:
        """Shear rate over the root of the pressure at I = I_0 [1/(s sqrt(Pa))]: I_0 / (d sqrt(rho_s)); else 0."""
        if self.friction_limit_deg is None or self.grain_diameter is None:
            return 0.0
        return self.inertial_number / (self.grain_diameter * math.sqrt(self.grain_density))

    @property
    def modulus(self) -> float:
        """Young's modulus E [Pa]; the usual one if neither the material nor a scene sets it."""
        return USUAL_YOUNG if self.young is None else self.young

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G [Pa]."""
        return self.modulus / (2.0 * (1.0 + self.poisson))

    @property
    def lame(self) -> float:
        """First Lame constant lambda [Pa]."""
        return self.modulus * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))

    @property
    def wave_speed(self) -> float:
        """Speed of the elastic pressure wave sqrt((lambda + 2 G) / rho) [m/s]."""
        return math.sqrt((self.lame + 2.0 * self.shear_modulus) / self.density)

    @property
    def cohesive(self) -> bool:
        """Whether the material has cohesion at any depth."""
        return self.cohesion > 0.0 or self.strength_gradient > 0.0

    @property
    def tension_limit(self) -> float:
        """Largest tension that the material carries at the top [Pa]: `tension_limit_at` depth 0."""
        return self.tension_limit_at(0.0)

    @property
    def residual(self) -> "Material":
        """The material after softening; the same material if it does not soften."""
        if self.softening_length is None:
            return self
        share = 1.0
        if self.residual_cohesion is not None:
            # The sensitivity, peak over residual, is the same as at the top.
            share = self.residual_cohesion / self.cohesion if self.cohesion > 0.0 else 0.0
        given, cohesion, cutoff = self.residual_friction_deg, self.residual_cohesion, self.residual_tension_cutoff
        names = ("friction_limit_deg", "softening_length", *(f"residual_{key}" for key in SOFTENING))
        none: dict[str, Any] = dict.fromkeys(names)
        return dataclasses.replace(
            self,
            angle="triaxial",
            friction_deg=self.phi_deg if given is None else self.phi_deg_of(given),
            dilation_deg=0.0,
            cohesion=self.cohesion if cohesion is None else cohesion,
            strength_gradient=share * self.strength_gradient,
            tension_cutoff=self.cutoff_at(0.0) if cutoff is None else cutoff,
            **none,
        )

    def cohesion_at(self, depth: Depth) -> Depth:
        """Peak cohesion [Pa] at `depth` [m] below the top of the body at the start; a number or an array."""
        return self.cohesion + self.strength_gradient * depth

    def cutoff_at(self, depth: Depth) -> Depth:
        """Peak tension cutoff [Pa] at `depth` [m], before the apex limits it: the given one or the default."""
        if self.tension_cutoff is None:
            return TENSION_SHARE * self.cohesion_at(depth)
        return self.tension_cutoff + 0.0 * depth

    def tension_limit_at(self, depth: Depth, tangent: Depth | None = None) -> Depth:
        """Largest tension [Pa] carried at `depth` [m] before softening; `tangent`: another tan(phi)."""
        return self.up_to_apex(self.cutoff_at(depth), depth, tangent)

    def residual_tension_limit_at(self, depth: Depth, tangent: Depth | None = None) -> Depth:
        """Largest tension [Pa] carried at `depth` [m] after softening; `tangent`: another residual tan(phi)."""
        given = self.residual_tension_cutoff
        return self.residual.up_to_apex(self.cutoff_at(depth) if given is None else given + 0.0 * depth, depth, tangent)

    def up_to_apex(self, tension: Depth, depth: Depth, tangent: Depth | None = None) -> Depth:
        """`tension` [Pa], or the apex of the cone c cot(phi) at `depth` [m] if that is lower; Tresca has no apex."""
        if tangent is None and self.friction_deg == 0.0:
            return tension
        apex = self.cohesion_at(depth) / (self.friction if tangent is None else tangent)
        return min(tension, apex) if isinstance(apex, float) else np.minimum(tension, apex)
