"""A user's own definition: a scene in TOML in which any number may be a distribution, those of docs/formats.md."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from datasets import errors
from datasets.definitions.definition import Definition, Split
from datasets.errors import InputError, OutOfRange, naming, require
from datasets.files import read_toml
from datasets.scene import TOLERANCE, Scene, keyed
from datasets.scene.library import scene_from
from datasets.schema import Bounds, Record, dotted, from_mapping

Key = tuple[int | str, ...]
Draws = dict[str, Any]

LARGEST, LEAST_STEP = 1.0e15, 1.0e-15  # of a number of a distribution; of a step over the range
DIGITS = 12  # decimals of a length: without the rounding of a product, so that whole cells stay whole
MOST_COPIES = 4096  # largest `count` of a mass or a baffle
TRIES = 1000
"""Draws of a scene before the definition is refused: the chance of a valid one is then below one in a hundred."""
MANY = 20  # bodies and solids of a scene above which the draws are proportionally fewer, because each takes time
MOST_SCENES = 1_000_000  # of a dataset
NAME = re.compile(r"[A-Za-z][\w-]{0,60}", re.ASCII)
PAIRS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "uniform": ("two numbers, the smaller first", lambda low, high: low <= high),
    "log_uniform": ("two numbers above 0, the smaller first", lambda low, high: 0 < low <= high),
    "normal": ("two numbers, the mean and a deviation of at least 0", lambda _, deviation: deviation >= 0),
    "integer": ("two whole numbers, the smaller first", lambda a, b: type(a) is type(b) is int and a <= b),
}
"""Distribution of two numbers -> their description and check."""
OPTIONS = {name: set[str]() for name in PAIRS}
OPTIONS |= {"uniform": {"step"}, "choice": {"weights"}, "variable": {"factor", "offset"}}
"""Distribution -> its optional keys."""


@dataclass(frozen=True, kw_only=True)
class DefinitionFile(Record):
    """The keys of a definition in TOML."""

    scene: dict[str, Any]
    """A scene (`datasets.scene`), whose numbers may be distributions; masses and baffles may have a `count`."""
    variables: dict[str, Any] = field(default_factory=dict)
    """Values on which more than one key of a scene depends."""
    count: Annotated[int, Bounds(f"at least 1, at most {MOST_SCENES} scenes", ge=1, le=MOST_SCENES)] = 100
    """Number of scenes in the whole dataset."""
    split_period: Annotated[int, Bounds("at least 3", ge=3)] = 10
    """In each group of so many scenes, the second is for validation and the third for the test."""
    baffle_gap: Annotated[float, Bounds("a length of at least 0 m", ge=0.0)] = 0.0
    """Least distance of a baffle from other baffles and from masses along some axis [m]."""


def definition_from_file(path: Path) -> Definition:
    """The definition in the TOML file at `path`, with the name of the file. Raises InputError."""
    expected = "a file name of letters, digits, - and _, which names the trajectories"
    require(NAME.fullmatch(path.stem) is not None, "", expected, where=str(path))
    with naming(path):
        content = from_mapping(DefinitionFile, read_toml(path))

    def draw(stream: np.random.Generator, _: int) -> Scene:
        with naming(path):
            return draw_scene(content, stream, path.parent)

    # A trial draw finds errors before anything is simulated.
    draw(np.random.default_rng([0, 0]), 0)
    return Definition(
        name=path.stem,
        size=content.count,
        split=lambda index: {1: Split.VALID, 2: Split.TEST}.get(index % content.split_period, Split.TRAIN),
        draw=draw,
    )


def draw_scene(content: DefinitionFile, stream: np.random.Generator, folder: Path) -> Scene:
    """A scene that can be simulated: an invalid draw is repeated, up to `TRIES` times, less often for more than `MANY`
    bodies. Raises the InputError of the last draw."""
    tries, bodies = 0, 0
    while bodies < TRIES * MANY:
        variables = {name: drawn(value, stream, {}, ("variables", name)) for name, value in content.variables.items()}
        data = {key: drawn(value, stream, variables, ("scene", key)) for key, value in content.scene.items()}
        data.setdefault("seed", int(stream.integers(2**31)))
        tries += 1
        bodies += max(MANY, sum(len(part) for part in data.values() if isinstance(part, list)))
        try:
            with errors.keyed("scene"):
                scene = scene_from(data, folder)
                check_gaps(scene, content.baffle_gap)
            return scene
        except OutOfRange as error:
            last = error
    raise InputError(f"{last.message} (in each of {tries} draws)", where=last.where, key=last.key)


def drawn(value: Any, stream: np.random.Generator, variables: Draws, key: Key) -> Any:
    """`value` with every distribution in it replaced by a draw. Raises InputError."""
    if isinstance(value, Mapping):
        kinds = OPTIONS.keys() & value.keys()
        if kinds:
            return draw_value(value, min(kinds), stream, variables, key)
        return {name: drawn(entry, stream, variables, (*key, name)) for name, entry in value.items() if name != "count"}
    if isinstance(value, list):
        items = []
        for number, item in enumerate(value):
            where = (*key, number)
            given = item.get("count", 1) if isinstance(item, Mapping) else 1
            repeats = drawn(given, stream, variables, (*where, "count"))
            counts = isinstance(repeats, int) and 0 <= repeats <= MOST_COPIES
            expected = f"a whole number of at least 0, up to {MOST_COPIES}"
            require(counts, dotted((*where, "count")), expected, repr(repeats))
            items += [drawn(item, stream, variables, where) for _ in range(repeats)]
        return items
    return value


def draw_value(value: Mapping[str, Any], kind: str, stream: np.random.Generator, variables: Draws, key: Key) -> Any:
    """A draw from one distribution. Raises InputError."""
    given, where = value[kind], dotted((*key, kind))
    extra = value.keys() - OPTIONS[kind] - {kind}
    require(not extra, where, f"no other key beside it than {sorted(OPTIONS[kind]) or 'it'}", ", ".join(sorted(extra)))
    if kind == "choice":
        require(isinstance(given, list) and len(given) > 0, where, "a list of values", value)
        weights = value.get("weights", [1] * len(given))
        fit = isinstance(weights, list) and len(weights) == len(given)
        fit = fit and all(type(weight) is int and weight > 0 for weight in weights)
        require(fit, where, "weights, a positive whole number for each value", value)
        chosen = int(np.searchsorted(np.cumsum(weights), stream.integers(sum(weights)), side="right"))
        return drawn(given[chosen], stream, variables, key)
    if kind == "variable":
        defined = isinstance(given, str) and given in variables
        require(defined, where, f"one of the variables {sorted(variables)}", repr(given))
        if not OPTIONS[kind] & value.keys():
            return variables[given]
        terms = [variables[given], value.get("factor", 1.0), value.get("offset", 0.0)]
        require(all(map(usable, terms)), where, "numbers, variable, factor and offset", terms)
        return round(float(terms[0] * terms[1] + terms[2]), DIGITS)
    expected, hold = PAIRS[kind]
    fit = isinstance(given, list) and len(given) == 2 and all(map(usable, given)) and hold(*given)
    require(fit, where, expected, value)
    low, high = given
    if kind == "integer":
        return int(stream.integers(low, high, endpoint=True))
    if "step" in value:
        fit = usable(value["step"]) and value["step"] > LEAST_STEP * (high - low)
        require(fit, where, "a positive step that is not too small beside the range", value)
        steps = int((high - low) / value["step"] + 1e-9)
        return round(float(low + value["step"] * int(stream.integers(steps, endpoint=True))), DIGITS)
    if kind == "log_uniform":
        return float(np.exp(stream.uniform(*np.log(given))))
    return float(stream.normal(low, high) if kind == "normal" else stream.uniform(low, high))


def usable(number: Any) -> bool:
    """Whether a TOML value is a number allowed in a distribution."""
    return type(number) in (int, float) and abs(number) <= LARGEST


def check_gaps(scene: Scene, gap: float) -> None:
    """Raise InputError if a baffle is nearer than `gap` [m] to another or to a mass along every axis."""
    for (_, a), (name, b) in combinations(keyed(scene, "masses", "baffles").items(), 2):
        low, size, other, other_size = (np.array(vector) for vector in (a.lower, a.size, b.lower, b.size))
        distance = float(np.maximum(low - other - other_size, other - low - size).max())
        if name.startswith("baffles") and distance < gap - TOLERANCE:
            raise OutOfRange(f"expected a gap of at least {gap:g} m, got {distance:.3g}", key=name)
