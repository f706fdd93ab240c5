"""Observation operators: what is measured of a flow, each kind in a file of its own, and the target that holds it.

>>> from inverse.observations import build
>>> from inverse.settings import ObservationSettings
>>> front = build(ObservationSettings(kind="front"), scene)
>>> front.observe(trajectory)
"""

from datasets.errors import InputError
from datasets.scene import Scene
from inverse.observations.deposit import Deposit
from inverse.observations.front import Front, FrontOverTime
from inverse.observations.gauges import Gauges
from inverse.observations.impulse import Impulse, PeakForce
from inverse.observations.joint import Joint
from inverse.observations.observation import DepositObservation, Observation, Rollout, Values
from inverse.observations.outline import Outline
from inverse.observations.passed import Passed
from inverse.observations.profile import Profile
from inverse.observations.runout import Runout
from inverse.observations.target import Target
from inverse.observations.toe import Toe
from inverse.settings import ObservationSettings

__all__ = ["KINDS", "DepositObservation", "Observation", "Rollout", "Target", "Values", "build"]

KINDS: dict[str, type[Observation]] = {
    each.kind: each
    for each in (
        Front,
        Runout,
        Profile,
        Toe,
        Deposit,
        Passed,
        FrontOverTime,
        Gauges,
        Impulse,
        PeakForce,
        Outline,
        Joint,
    )
}
"""Every kind of observation by its name in TOML."""


def build(settings: ObservationSettings, scene: Scene) -> Observation:
    """The observation operator that `settings` describe, for flows of `scene`. Raises InputError."""
    if settings.kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS)}, got {settings.kind!r}", key="kind")
    return KINDS[settings.kind].build(settings, scene)
