"""Material: the constants of a Mohr-Coulomb sand."""

import math
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.strict import Strict


@dataclass(frozen=True, kw_only=True)
class Material(Strict):
    """Isotropic linear elasticity with a Mohr-Coulomb yield surface and a tension cutoff."""

    friction_deg: float
    """Angle of internal friction [deg], in (0, 90)."""
    density: float = 1800.0
    """Initial bulk density [kg/m^3]."""
    young: float = 2.0e6
    """Young's modulus [Pa]."""
    poisson: float = 0.3
    """Poisson's ratio [-], in [0, 0.5)."""
    dilation_deg: float = 0.0
    """Angle of dilation [deg], in [0, friction_deg]."""
    cohesion: float = 0.0
    """Cohesion [Pa]."""
    tension_cutoff: float = 0.0
    """Largest tensile principal stress [Pa]; the apex c cot(phi) limits it from above."""

    def __post_init__(self) -> None:
        def require(ok: bool, key: str, expected: str) -> None:
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key):g}", key=f"material.{key}")

        require(0.0 < self.friction_deg < 90.0, "friction_deg", "an angle in (0, 90) degrees")
        require(self.density > 0.0, "density", "a positive density in kg/m^3")
        require(self.young > 0.0, "young", "a positive modulus in Pa")
        require(0.0 <= self.poisson < 0.5, "poisson", "a ratio in [0, 0.5)")
        require(0.0 <= self.dilation_deg <= self.friction_deg, "dilation_deg", "an angle in [0, friction_deg]")
        require(self.cohesion >= 0.0, "cohesion", "a cohesion of at least 0 Pa")
        require(self.tension_cutoff >= 0.0, "tension_cutoff", "a tension cutoff of at least 0 Pa")

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
    def tension_limit(self) -> float:
        """The tension cutoff, clamped to the apex of the cone c cot(phi) [Pa]."""
        return min(self.tension_cutoff, self.cohesion / self.friction)
