"""Material: elastic constants and those of its law of strength; all stresses are in Pa, tension positive.

The law is Mohr's and Coulomb's, with the constants below, unless `law` names another one of `mpm.laws`. Its own keys
are then `constants`, which that law checks when the MPM takes the scene.

docs/theory/return-map.md has the equations of what follows and their sources:

- **Tension**: a crack opens where a principal stress reaches T = `tension_cutoff`, at most the apex c cot(phi) of the
  cone, by default `TENSION_SHARE` c at every depth.
- **Depth**: c(z) = cohesion + strength_gradient z; every particle keeps the cohesion of its depth z at the start.
- **Softening**: sin phi, c cos phi and T are linear in the slip of a band one cell thick, from peak to residual values
  over `softening_length`; sin psi falls to 0. Without that length it dilates **for ever**: wrong for flows.
- **Which angle**: "triaxial" is phi itself, "slope" that on the plane that shears (`sine_of_slope`).
- **Rate of shear**: with a `friction_limit_deg` friction grows with the inertial number (`mpm.physics.inertial`).
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
"""The law of a material that names none."""
USUAL_YOUNG = 2.0e6
"""Young's modulus [Pa] of a material that gives none, at least."""
STIFFEST = 1.0e15
"""Moduli and strengths [Pa] beyond this, a thousand times those of diamond, are none."""
LEAST_VOLUME_CHANGE = 0.4999
"""Largest Poisson's ratio: the bulk modulus is then 5,000 times the shear modulus, and beyond
that single precision loses the shear stress beside the pressure."""
ANGLES = {"triaxial": 90.0, "slope": 45.0}
"""How angles of friction may have been measured, and below which value [deg] each stays."""
TENSION_SHARE = 0.003
"""Tension cutoff over cohesion [-] where a material names none."""
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

SHARED = ("law", "constants", "density", "young", "poisson")  # keys that a material of any law has
SOFTENING = ("friction_deg", "cohesion", "tension_cutoff")  # keys that have a residual value


def sine_of_slope(tangent: Any, psi: float) -> Any:
    """sin(phi) [-] of a slope's tan(angle) = sin phi cos psi / (1 - sin phi sin psi), psi in radians (Davis 1968). A
    number, an array or a tensor."""
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
    """Law of strength: this one, or the name of another of `mpm.laws`, whose keys then stand beside density and
    elasticity in place of those of Mohr and Coulomb."""
    constants: dict[str, float] = field(default_factory=dict, hash=False)
    """The keys of another law; from Python together, with `friction_deg` = 0."""
    friction_deg: float
    """Angle of friction [deg], in [0, 90), of a slope in [0, 45); 0, Tresca's law, needs a cohesion."""
    angle: Annotated[str, Bounds(f"one of {', '.join(ANGLES)}", words=tuple(ANGLES))] = "triaxial"
    """How angles of friction were measured: "triaxial" (phi itself) or "slope" (on the plane that shears)."""
    friction_limit_deg: float | None = None
    """Angle of friction at very high rates of shear [deg], of the same `angle`; no dependence on them where absent."""
    inertial_number: Inertial = 0.279
    """I_0 [-], at which half of that growth is reached; that of glass beads where absent."""
    grain_diameter: Diameter | None = None
    """Diameter of a grain [m], needed with a `friction_limit_deg`."""
    grain_density: Density = 2500.0
    """Density of the grains [kg/m^3], not of the bulk; that of glass and quartz, about, where absent."""
    density: Density = 1800.0
    """Initial bulk density [kg/m^3]."""
    young: Modulus | None = None
    """Young's modulus [Pa]; where absent 2 MPa, in a scene as much as its thickness and speed need
    (`datasets.scene.stiffness`), which the scene's material then has."""
    poisson: Ratio = 0.3
    """Poisson's ratio [-], in [0, 0.4999]."""
    dilation_deg: float = 0.0
    """Angle of dilation [deg], in [0, friction_deg]; for ever where there is no `softening_length`. Saturated material
    needs one, and contracts where the angle is negative, down to -friction_deg."""
    cohesion: Strength = 0.0
    """Cohesion [Pa], where `strength_gradient` at the top of the body."""
    strength_gradient: Growth = 0.0
    """Growth of the cohesion with the depth below the top of the body at the start [Pa/m]."""
    tension_cutoff: Strength | None = None
    """Largest tensile principal stress [Pa], where cracks open; `TENSION_SHARE` of the cohesion where absent.

    The apex c cot(phi) limits it from above."""
    softening_length: Slip | None = None
    """Slip of a shear band at which the residual values are reached [m]; no softening where absent."""
    residual_friction_deg: float | None = None
    """Angle of friction after softening [deg], in [0, friction_deg]; that of the peak where absent."""
    residual_cohesion: float | None = None
    """Cohesion after softening [Pa], at most `cohesion`, at depth the same share of it; the peak's where absent."""
    residual_tension_cutoff: float | None = None
    """Tension cutoff after softening [Pa], at most that of the peak at the top; that of the peak where absent."""
    saturated: bool = False
    """Whether water fills its pores (`mpm.physics.water`): strength is then that of the effective stress, `density`
    that of grains and water together."""
    permeability: Permeability = None
    """Of saturated material k [m/s], with a `young`; undrained where neither this nor `consolidation` is given."""
    consolidation: Diffusivity = None
    """Its coefficient of consolidation c_v [m^2/s], in place of the permeability."""

    @model_validator(mode="before")
    @classmethod
    def gathered(cls, data: Any) -> Any:
        """The keys of a file, those of another law among its `constants`."""
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
        """A number by its key, of any law."""
        return float(self.constants[name] if name in self.constants else getattr(self, name))

    def with_constant(self, name: str, value: float) -> "Material":
        """The same material with another number for a key, of any law."""
        changes: dict[str, Any] = {name: value}
        if name in self.constants:
            changes = {"constants": {**self.constants, name: value}}
        return dataclasses.replace(self, **changes)

    @property
    def phi_deg(self) -> float:
        """Mohr's and Coulomb's angle of internal friction phi [deg]: `friction_deg` where that is "triaxial"."""
        return self.phi_deg_of(self.friction_deg, self.dilation_deg)

    def phi_deg_of(self, friction_deg: Depth, dilation_deg: float = 0.0) -> Depth:
        """phi [deg] of an angle of friction [deg] that was measured as `angle` says; a number or an array."""
        if self.angle == "triaxial":
            return friction_deg
        tangent = np.tan(np.radians(friction_deg))
        phi = np.asarray(np.degrees(np.arcsin(sine_of_slope(tangent, math.radians(dilation_deg)))))
        return phi if isinstance(friction_deg, np.ndarray) else float(phi)

    @property
    def slope_deg(self) -> float:
        """The angle on the plane that shears [deg]: `friction_deg` where that is of a "slope"."""
        sine, psi = math.sin(math.radians(self.phi_deg)), math.radians(self.dilation_deg)
        return math.degrees(math.atan2(sine * math.cos(psi), 1.0 - sine * math.sin(psi)))

    @property
    def friction(self) -> float:
        """tan(phi) [-]."""
        return math.tan(math.radians(self.phi_deg))

    @property
    def sin_phi_limit(self) -> float:
        """sin(phi) [-] at very high rates of shear; 0 where friction does not depend on them."""
        if self.friction_limit_deg is None:
            return 0.0
        return math.sin(math.radians(self.phi_deg_of(self.friction_limit_deg)))

    @property
    def inertial_rate(self) -> float:
        """Shear rate over the root of the pressure at I = I_0 [1/(s sqrt(Pa))]: I_0 / (d sqrt(rho_s)); 0 if none is."""
        if self.friction_limit_deg is None or self.grain_diameter is None:
            return 0.0
        return self.inertial_number / (self.grain_diameter * math.sqrt(self.grain_density))

    @property
    def modulus(self) -> float:
        """Young's modulus E [Pa], the usual one where neither the material nor a scene says."""
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
        """Whether there is cohesion anywhere."""
        return self.cohesion > 0.0 or self.strength_gradient > 0.0

    @property
    def tension_limit(self) -> float:
        """Largest tension that it carries at the top [Pa], `tension_limit_at` depth 0."""
        return self.tension_limit_at(0.0)

    @property
    def residual(self) -> "Material":
        """The material after softening; itself where it does not soften."""
        if self.softening_length is None:
            return self
        share = 1.0
        if self.residual_cohesion is not None:
            # The sensitivity, peak over residual, is that of the top.
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
        """Largest tension that it carries at `depth` [m] before it softens [Pa]; `tangent`: another tan(phi)."""
        return self.up_to_apex(self.cutoff_at(depth), depth, tangent)

    def residual_tension_limit_at(self, depth: Depth, tangent: Depth | None = None) -> Depth:
        """Largest tension that it carries at `depth` [m] after softening [Pa]; `tangent`: another residual tan(phi)."""
        given = self.residual_tension_cutoff
        return self.residual.up_to_apex(self.cutoff_at(depth) if given is None else given + 0.0 * depth, depth, tangent)

    def up_to_apex(self, tension: Depth, depth: Depth, tangent: Depth | None = None) -> Depth:
        """`tension` [Pa], or the apex of the cone c cot(phi) at `depth` [m] where that is lower; Tresca's has none."""
        if tangent is None and self.friction_deg == 0.0:
            return tension
        apex = self.cohesion_at(depth) / (self.friction if tangent is None else tangent)
        return min(tension, apex) if isinstance(apex, float) else np.minimum(tension, apex)
