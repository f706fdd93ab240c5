"""Observation operators: the quantities measured in a flow.

>>> from inverse.observations import FrontSettings
>>> front = FrontSettings(noise="1%").operator(scene)
>>> front.observe(trajectory)
"""

from inverse.observations.deposit import DepositSettings as DepositSettings
from inverse.observations.deposit import FrontSettings as FrontSettings
from inverse.observations.deposit import PassedSettings as PassedSettings
from inverse.observations.deposit import RunoutSettings as RunoutSettings
from inverse.observations.deposit import ToeSettings as ToeSettings
from inverse.observations.gauges import GaugesSettings as GaugesSettings
from inverse.observations.gauges import ImpulseSettings as ImpulseSettings
from inverse.observations.gauges import PeakForceSettings as PeakForceSettings
from inverse.observations.gauges import PorePressureSettings as PorePressureSettings
from inverse.observations.motion import ArrivalSettings as ArrivalSettings
from inverse.observations.motion import SpeedSettings as SpeedSettings
from inverse.observations.observation import Observation as Observation
from inverse.observations.observation import Rollout as Rollout
from inverse.observations.observation import Values as Values
from inverse.observations.outline import OutlineSettings as OutlineSettings
from inverse.observations.plan import ThicknessSettings as ThicknessSettings
from inverse.observations.profile import ProfileSettings as ProfileSettings
from inverse.observations.settings import ObservationSettings as ObservationSettings

_DEPOSIT = (FrontSettings, RunoutSettings, ToeSettings, DepositSettings, PassedSettings, OutlineSettings)
_HEIGHTS = (ProfileSettings, ThicknessSettings, GaugesSettings)
_INSTRUMENTS = (ImpulseSettings, PeakForceSettings, ArrivalSettings, SpeedSettings, PorePressureSettings)
KINDS: dict[str, type[ObservationSettings]] = {
    settings.operator_type.kind: settings for settings in (*_DEPOSIT, *_HEIGHTS, *_INSTRUMENTS)
}
"""Name of an observation in TOML -> its settings."""
