"""Laws of strength: one module each, found by its name; a kernel contains only the law of its scenes.

`[material] law = "NAME"` selects the module of that name, with _ for -. A module contains:

    Parameters                        a record of its keys in `[material]`, with units and bounds
    Column                            its columns of `properties`, from `len(mpm.arrays.layout.Property)` on
    OPENS                             whether tension opens it: its fourth strength is then the largest tension [Pa]
    features(materials, stages)       the flags of `mpm.arrays.features.Features` that it sets
    columns(features)                 the columns that a kernel with these features reads
    properties(material, depth, friction_deg)       their values [N, len(Column)]; in NumPy
    strengths(values, strain, cell, dt, features)   arguments of the return, from the values of all columns; in lanes
    return_principal or return_tensor               the admitted stress in place of a trial stress; in lanes
    admitted_share, nearest, limit                  the admitted stress at the start; in NumPy
    weakened(material, factor)        the material with its strength divided by a factor

The functions in lanes are straight-line code, from which `mpm.adjoint` derives their reverse. For a law in principal
stresses it also asks where nothing yields and where two stresses fell alike: `elastic_at`, `fell_alike`.
"""

import pkgutil
from collections.abc import Iterable
from importlib import import_module
from typing import Any

from datasets.errors import keyed, require
from datasets.scene.material import Material
from datasets.schema import from_mapping

LAWS = {each.name.replace("_", "-"): f"{__name__}.{each.name}" for each in pkgutil.iter_modules(__path__)}
"""The modules by the names of their laws."""


def law_named(name: str) -> Any:
    """The module of a law; imported here, because it needs Taichi. Raises InputError for an unknown name."""
    require(name in LAWS, "material.law", f"one of {', '.join(LAWS)}", repr(name))
    return import_module(LAWS[name])


def parameters_of(material: Material) -> Any:
    """The keys of a material's law, its `Parameters`. Raises InputError."""
    law = law_named(material.law)
    with keyed("material"):
        return from_mapping(law.Parameters, material.constants)


def law_of(materials: Iterable[Material]) -> Any:
    """The module of the law of all materials. Raises InputError if their laws differ, and for wrong keys of a law."""
    given = [*materials]
    for material in given:
        parameters_of(material)
    names = sorted({material.law for material in given})
    require(len(names) == 1, "material.law", "masses of one law", " and ".join(names))
    return law_named(names[0])
