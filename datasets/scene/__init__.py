"""Scenes: their parts, bounds and checks, their particles, and the shipped scenes."""

from datasets.scene.parts import DOMAIN_SIDES as DOMAIN_SIDES
from datasets.scene.parts import INFLOW as INFLOW
from datasets.scene.parts import NO_SLIP as NO_SLIP
from datasets.scene.parts import ROUGH as ROUGH
from datasets.scene.parts import TOLERANCE as TOLERANCE
from datasets.scene.parts import Baffle as Baffle
from datasets.scene.parts import Channel as Channel
from datasets.scene.parts import Domain as Domain
from datasets.scene.parts import Gate as Gate
from datasets.scene.parts import Mass as Mass
from datasets.scene.parts import Solid as Solid
from datasets.scene.parts import Stage as Stage
from datasets.scene.parts import coefficient as coefficient
from datasets.scene.parts import keyed as keyed
from datasets.scene.scene import Scene as Scene
