"""Observation operators: the quantities measured in a flow.

>>> from inverse.observations import FrontSettings
>>> front = FrontSettings(noise="1%").operator(scene)
>>> front.observe(trajectory)
"""

from inverse.observations.deposit import DepositSettings, FrontSettings, PassedSettings, RunoutSettings, ToeSettings
from inverse.observations.gauges import GaugesSettings, ImpulseSettings, PeakForceSettings, PorePressureSettings
from inverse.observations.motion import ArrivalSettings, SpeedSettings
from inverse.observations.observation import Observation, Rollout, Values
from inverse.observations.outline import OutlineSettings
from inverse.observations.plan import ThicknessSettings
from inverse.observations.profile import ProfileSettings
from inverse.observations.settings import ObservationSettings

__all__ = ["KINDS", "ArrivalSettings", "DepositSettings", "FrontSettings", "GaugesSettings", "ImpulseSettings"]
__all__ += ["Observation", "ObservationSettings", "OutlineSettings", "PassedSettings", "PeakForceSettings"]
__all__ += ["PorePressureSettings", "ProfileSettings", "Rollout", "RunoutSettings", "SpeedSettings"]
__all__ += ["ThicknessSettings", "ToeSettings", "Values"]

_DEPOSIT = (FrontSettings, RunoutSettings, ToeSettings, DepositSettings, PassedSettings, OutlineSettings)
_HEIGHTS = (ProfileSettings, ThicknessSettings, GaugesSettings)
_INSTRUMENTS = (ImpulseSettings, PeakForceSettings, ArrivalSettings, SpeedSettings, PorePressureSettings)
KINDS: dict[str, type[ObservationSettings]] = {
    settings.operator_type.kind: settings for settings in (*_DEPOSIT, *_HEIGHTS, *_INSTRUMENTS)
}
"""Name of an observation in TOML -> its settings."""
