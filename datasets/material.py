"""Material: the constants of a Mohr-Coulomb soil.

A cohesive soil carries **no tension by default**: `tension_cutoff` is 0, a crack opens where a principal stress reaches
it, and the stress beside the crack relaxes by elastic coupling. The height of a vertical cut that stands depends on it:
gamma H / c is 2 tan(45 + phi/2) for soil that cracks freely (Drucker 1953), and up to 3.83 tan(45 + phi/2) for soil
that carries tension (Chen 1975; 4 for a plane slip, Fellenius 1927). A cutoff above the apex of the cone c cot(phi) is
that apex. All stresses are in Pa, tension positive.

`friction_deg` = 0 with a cohesion is Tresca's law, undrained clay, whose cohesion is the undrained shear strength s_u;
`strength_gradient` [Pa/m] lets it grow with depth, c(z) = cohesion + strength_gradient z, as it does in normally
consolidated clay (Davis & Booker 1973). Every particle keeps the cohesion of its depth at the start.

With a `softening_length` the strength falls from these peak values to the residual ones, linearly in the slip

    w = max(0, 1 - gamma_p h / softening_length),     gamma_p = sqrt(3) e_p

of a shear band one cell h thick, e_p = int sqrt(2/3 de : de) the accumulated deviatoric plastic strain: in simple shear
by gamma it is gamma / sqrt(3), so gamma_p h is the displacement across the band. sin phi, c cos phi and the tension
limit are interpolated by w; the shear stress of a band at normal stress s, s sin phi + c cos phi for psi = 0 (Davis
1968), then falls linearly, and the work per area beyond the residual strength, (peak - residual) softening_length / 2,
does not depend on the cell (crack band: Bazant & Oh 1983; in shear Palmer & Rice 1973). Opening counts with 2 / sqrt(3)
of its width. Cells must be smaller than G softening_length / (peak - residual shear strength), or the band snaps back.
The step uses the strength of the plastic strain at its start.

Dilation: psi(w) with sin psi(w) = w sin psi. A dense sand dilates until it has reached its critical state (Rowe 1962;
Bolton 1986: phi - phi_crit = 0.8 psi), which `residual_friction_deg` and `softening_length` describe. Without a
`softening_length` a material with `dilation_deg` **dilates for ever**: fine for small strains, wrong for flows.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.strict import Strict

Depth = TypeVar("Depth", float, NDArray[np.float64])


@dataclass(frozen=True, kw_only=True)
class Material(Strict):
    """Isotropic linear elasticity with a Mohr-Coulomb yield surface and a tension cutoff."""

    friction_deg: float
    """Angle of internal friction [deg], in [0, 90); 0, Tresca's law, needs a cohesion."""
    density: float = 1800.0
    """Initial bulk density [kg/m^3]."""
    young: float = 2.0e6
    """Young's modulus [Pa]."""
    poisson: float = 0.3
    """Poisson's ratio [-], in [0, 0.5)."""
    dilation_deg: float = 0.0
    """Angle of dilation [deg], in [0, friction_deg]; for ever where there is no `softening_length`."""
    cohesion: float = 0.0
    """Cohesion [Pa], where `strength_gradient` at the top of the body."""
    strength_gradient: float = 0.0
    """Growth of the cohesion with the depth below the top of the body at the start [Pa/m]."""
    tension_cutoff: float = 0.0
    """Largest tensile principal stress [Pa], where cracks open; the apex c cot(phi) limits it from above."""
    softening_length: float | None = None
    """Slip of a shear band at which the residual values are reached [m]; no softening where absent."""
    residual_friction_deg: float | None = None
    """Angle of friction after softening [deg], in [0, friction_deg]; that of the peak where absent."""
    residual_cohesion: float | None = None
    """Cohesion after softening [Pa], at most `cohesion`, at depth the same share of it; the peak's where absent."""
    residual_tension_cutoff: float | None = None
    """Tension cutoff after softening [Pa], at most `tension_cutoff`; that of the peak where absent."""

    def __post_init__(self) -> None:
        def require(ok: bool, key: str, expected: str) -> None:
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key):g}", key=f"material.{key}")

        require(0.0 <= self.friction_deg < 90.0, "friction_deg", "an angle in [0, 90) degrees")
        require(self.density > 0.0, "density", "a positive density in kg/m^3")
        require(self.young > 0.0, "young", "a positive modulus in Pa")
        require(0.0 <= self.poisson < 0.5, "poisson", "a ratio in [0, 0.5)")
        require(0.0 <= self.dilation_deg <= self.friction_deg, "dilation_deg", "an angle in [0, friction_deg]")
        require(self.cohesion >= 0.0, "cohesion", "a cohesion of at least 0 Pa")
        strong = self.friction_deg > 0.0 or self.cohesion > 0.0
        require(strong, "friction_deg", "an angle above 0 degrees where there is no cohesion")
        require(self.strength_gradient >= 0.0, "strength_gradient", "a growth of at least 0 Pa/m")
        require(self.tension_cutoff >= 0.0, "tension_cutoff", "a tension cutoff of at least 0 Pa")
        if self.softening_length is not None:
            require(self.softening_length > 0.0, "softening_length", "a positive slip in m")
        for key in ("friction_deg", "cohesion", "tension_cutoff"):
            value = getattr(self, f"residual_{key}")
            if value is not None:
                require(0.0 <= value <= getattr(self, key), f"residual_{key}", f"a value in [0, {key}]")
                known = self.softening_length is not None
                require(known, f"residual_{key}", "no residual value without a softening_length")
        if self.residual_friction_deg == 0.0:
            strong = self.residual_cohesion != 0.0 and self.cohesion > 0.0
            require(strong, "residual_friction_deg", "an angle above 0 degrees where no cohesion remains")

    @property
    def friction(self) -> float:
        """tan(phi) [-]."""
        return math.tan(math.radians(self.friction_deg))

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G [Pa]."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def lame(self) -> float:
        """First Lame constant lambda [Pa]."""
        return self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))

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
        """The tension cutoff, clamped to the apex of the cone c cot(phi) [Pa]; Tresca's prism, phi = 0, has none."""
        if self.friction_deg == 0.0:
            return self.tension_cutoff
        return min(self.tension_cutoff, self.cohesion / self.friction)

    @property
    def residual(self) -> "Material":
        """The material after softening; itself where it does not soften."""
        if self.softening_length is None:
            return self
        share = 1.0
        if self.residual_cohesion is not None:
            # The sensitivity, peak over residual, is that of the top.
            share = self.residual_cohesion / self.cohesion if self.cohesion > 0.0 else 0.0

        def or_peak(value: float | None, peak: float) -> float:
            return peak if value is None else value

        return dataclasses.replace(
            self,
            friction_deg=or_peak(self.residual_friction_deg, self.friction_deg),
            dilation_deg=0.0,
            cohesion=or_peak(self.residual_cohesion, self.cohesion),
            strength_gradient=share * self.strength_gradient,
            tension_cutoff=or_peak(self.residual_tension_cutoff, self.tension_cutoff),
            softening_length=None,
            residual_friction_deg=None,
            residual_cohesion=None,
            residual_tension_cutoff=None,
        )

    def cohesion_at(self, depth: Depth) -> Depth:
        """Peak cohesion [Pa] at `depth` [m] below the top of the body at the start; a number or an array."""
        return self.cohesion + self.strength_gradient * depth
