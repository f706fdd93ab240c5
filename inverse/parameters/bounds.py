"""Whether a scene can be simulated with its parameters, wherever between their bounds they are."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from datasets.errors import InputError, keyed, require
from datasets.scene import Scene
from inverse.parameters import Parameter, with_kinds

FILLING = 32
"""Points by which the box of the bounds is filled, and corners of it, that are tried."""


def check_parameters(scene: Scene, parameters: Mapping[str, Parameter], key: str) -> None:
    """Raise InputError for parameters that the scene has not, or with bounds at which it could not be simulated.

    parameters: by their keys; key: of all together.
    """
    names = [each.name for each in parameters.values()]
    for place, parameter in parameters.items():
        with keyed(place):
            require(names.count(parameter.name) == 1, "name", "each number once", f"{parameter.name!r} twice")
            parameter.check(scene)
    if numbers := {place: each for place, each in parameters.items() if not each.is_field}:
        check_bounds(scene, numbers, key)


def check_bounds(scene: Scene, numbers: Mapping[str, Parameter], key: str) -> None:
    """Raise InputError for numbers by their keys, between whose bounds not every scene can be simulated.

    key: of all together.
    """
    parameters = [*numbers.values()]
    initial, bounds = [each.start for each in parameters], [each.bounds for each in parameters]
    check_scene(scene, parameters, initial, key)
    lower, upper = np.array(bounds).T
    corners = [*itertools.islice(itertools.product(*bounds), FILLING), upper.tolist()]
    inside = lower + (upper - lower) * qmc.Sobol(len(bounds), seed=0).random(FILLING)
    for values in (*corners, *inside.tolist()):
        try:
            check_scene(scene, parameters, values, key)
        except InputError as error:
            # One bound by itself, if there is such a one, says more.
            for row, (number, parameter) in enumerate(numbers.items()):
                for name, bound in zip(("lower", "upper"), parameter.bounds, strict=True):
                    alone = [*initial[:row], bound, *initial[row + 1 :]]
                    check_scene(scene, parameters, alone, f"{number}.{name}")
            where = ", ".join(f"{each.name} = {value:.4g}" for each, value in zip(parameters, values, strict=True))
            raise InputError(f"{error.message} with {where}, all within their bounds", key=key) from None


def check_scene(scene: Scene, parameters: Sequence[Parameter], values: Sequence[float], key: str) -> None:
    """Raise InputError under `key` unless `scene` can be simulated with these values."""
    try:
        with_kinds(scene, [each.kind for each in parameters], values)
    except InputError as error:
        raise InputError(f"expected a scene that can be simulated, but {error}", key=key) from None
