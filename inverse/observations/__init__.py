"""Observation operators: what is measured of a flow.

>>> from inverse.observations import build
>>> from inverse.settings import ObservationSettings
>>> front = build(ObservationSettings(kind="front"), scene)
>>> front.observe(trajectory)
"""

from datasets.scene import Scene
from inverse.observations.deposit import Deposit, Front, Outline, Passed, Runout, Toe
from inverse.observations.gauges import Gauges, Impulse
from inverse.observations.observation import Observation, Rollout, Values
from inverse.observations.profile import Profile
from inverse.settings import ObservationSettings

__all__ = ["KINDS", "Observation", "Rollout", "Values", "build"]

KINDS: dict[str, type[Observation]] = {
    each.kind: each for each in (Front, Runout, Profile, Toe, Deposit, Passed, Gauges, Impulse, Outline)
}
"""Every kind of observation by its name in TOML."""


def build(settings: ObservationSettings, scene: Scene) -> Observation:
    """The observation operator that `settings` describe, for flows of `scene`. Raises InputError."""
    return KINDS[settings.kind](settings, scene)
