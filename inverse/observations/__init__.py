"""Observation operators: what is measured of a flow.

>>> from inverse.observations import FrontSettings
>>> front = FrontSettings(noise="1%").operator(scene)
>>> front.observe(trajectory)
"""

from inverse.observations.deposit import (
    DepositSettings,
    FrontSettings,
    OutlineSettings,
    PassedSettings,
    RunoutSettings,
    ToeSettings,
)
from inverse.observations.gauges import GaugesSettings, ImpulseSettings
from inverse.observations.observation import Observation, Rollout, Values
from inverse.observations.profile import ProfileSettings
from inverse.observations.settings import ObservationSettings

__all__ = [
    "KINDS",
    "DepositSettings",
    "FrontSettings",
    "GaugesSettings",
    "ImpulseSettings",
    "Observation",
    "ObservationSettings",
    "OutlineSettings",
    "PassedSettings",
    "ProfileSettings",
    "Rollout",
    "RunoutSettings",
    "ToeSettings",
    "Values",
]

KINDS: dict[str, type[ObservationSettings]] = {
    settings.kind: settings
    for settings in (
        FrontSettings,
        RunoutSettings,
        ProfileSettings,
        ToeSettings,
        DepositSettings,
        PassedSettings,
        GaugesSettings,
        ImpulseSettings,
        OutlineSettings,
    )
}
"""The settings of every kind of observation by its name in TOML."""
