"""The keys of an observation in a problem's file; each kind adds the keys of its operator."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np

from datasets.errors import InputError, require
from datasets.exchange import spreadsheet
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.schema import Record
from inverse.observations.errors import Covariance, Noise, StatedNoise, Student
from inverse.observations.observation import Between, Observation, Values
from inverse.observations.target import Target

FILES = ("csv", "file")
SOURCES = ("value", "values", *FILES)  # keys under which measured numbers stand: of those that name a file, and all


@dataclass(frozen=True, kw_only=True)
class ObservationSettings(Record):
    """A measurement: its noise and, depending on the kind, its places, times and results. Raises InputError."""

    name: str | None = None  # name in reports; default: its kind
    noise: StatedNoise = 0.0
    """Standard deviation of each number, for a profile of each height: in their unit, or a percentage such as "3%"."""

    robust: ClassVar[bool] = True  # whether errors of its numbers are independent, so that one may be an outlier
    operator_type: ClassVar[type[Observation]]
    places: ClassVar[dict[str, int | None]] = {}
    """Keys that hold coordinates -> their axis of the scene; None: a whole vector."""

    def __post_init__(self) -> None:
        super().__post_init__()
        Noise.stated(self.noise)
        plain = self.robust or not isinstance(self.noise, Student)
        require(plain, "noise", "a number or a percentage for numbers whose errors depend on each other", "student")
        for each in fields(self):
            require(getattr(self, each.name) != (), each.name, "at least one number", "none")
        require(len(self.given) < 2, "", f"one of {', '.join(self.sources)}", " and ".join(self.given))

    def in_box(self, corner: Floats, keys: Sequence[str] | None = None) -> Self:
        """The settings with map coordinates converted to box coordinates; corner: of the box on the map [m], shape [D].
        keys: the keys in map coordinates; default: all. Raises InputError, which names the key."""
        moved: dict[str, Any] = {}
        for key, axis in self.places.items():
            if (given := getattr(self, key)) is not None and (keys is None or key in keys):
                size = len(corner)
                fits = axis < size if axis is not None else np.shape(given) == (size,)
                require(fits, key, f"{size} coordinates" if axis is None else f"none in {size}D", given)
                places = np.subtract(given, corner if axis is None else corner[axis]).tolist()
                moved[key] = places if isinstance(places, float) else tuple(places)
        return replace(self, **moved)

    def operator(self, scene: Scene) -> Observation:
        """The operator for flows of `scene`. Raises InputError, which names the key."""
        return self.operator_type(scene, self)

    @property
    def kind(self) -> str:
        """A key of `inverse.observations.KINDS`."""
        return self.operator_type.kind

    @property
    def sources(self) -> list[str]:
        """Keys that may hold its numbers."""
        return [key for key in SOURCES if hasattr(self, key)]

    @property
    def given(self) -> dict[str, Any]:
        """Key -> the measured numbers or their file; empty for a twin."""
        return {key: getattr(self, key) for key in self.sources if getattr(self, key) is not None}

    def stated(self, operator: Observation) -> Values:
        """The numbers in the settings themselves, shape [M]. Raises InputError for impossible ones."""
        ((key, given),) = self.given.items()
        values = np.atleast_1d(np.array(given))
        require(len(values) == operator.count, key, f"{operator.count} numbers", len(values))
        low, high = operator.limits
        between = " to ".join(str(np.asarray(end).tolist()) for end in operator.limits)
        possible = bool(np.all((low <= values) & (values <= high)))
        require(possible, key, f"{between} {operator.unit or '(a share)'}", values.tolist())
        return values

    def compared(self, operator: Observation, values: Values) -> Target:
        """The target of `values` [M] with independent errors."""
        errors = Covariance(Noise.stated(self.noise).of(values))
        self.warn_of_noise(values, float(np.max(operator.limits[1]) - np.min(operator.limits[0])))
        dof = np.full(len(values), self.noise.dof) if isinstance(self.noise, Student) else None
        return Target(observation=operator, values=values, errors=errors, dof=dof)

    def warn_of_noise(self, values: Values, span: float) -> None:
        """Warn of a noise that looks like a percentage without its sign; span: range of possible values."""
        noise, largest = Noise.stated(self.noise).deviation, float(np.nanmax(np.abs(values)))
        if noise > span or max(1.0, largest) <= noise < 100.0:
            than = f"the range of what is possible, {span:g}" if noise > span else f"every number, at most {largest:g}"
            said = f"a noise of {noise:g} is more than {than}"
            warnings.warn(f'{self.name or self.kind}: {said}; a percentage is written "{noise:g}%"', stacklevel=3)

    def read(self, scene: Scene, folder: Path, released: Between) -> Target:
        """The target of the measured numbers. Raises InputError, which names the key or the table.
        folder: of relative paths; released: volume of the masses over the width [m^2] within the bounds."""
        operator = self.operator(scene)
        return self.compared(operator, self.stated(operator))

    def of_run(self, scene: Scene, run: Trajectory) -> Target:
        """The target from a run. Raises InputError if the run has not recorded the quantity."""
        operator = self.operator(scene)
        return self.compared(operator, operator.observe(run))


@dataclass(frozen=True, kw_only=True)
class TabulatedSettings(ObservationSettings):
    """Settings of an observation whose numbers may be in a table."""

    csv: str | None = None  # a table with the `columns` of the kind and possibly others

    blanks: ClassVar[bool] = False  # whether rows of it may be empty
    columns: ClassVar[dict[str, str]] = {}  # column -> the key that it replaces
    optional: ClassVar[tuple[str, ...]] = ()  # columns that may be absent

    @property
    def count(self) -> int:
        """The number of `values`."""
        return len(getattr(self, "values", None) or ())

    @property
    def metres(self) -> float:
        """The unit of lengths in its table [m]."""
        return 1.0

    def table(
        self, path: Path, needed: Sequence[str], optional: Sequence[str] = (), dimension: int = 3
    ) -> dict[str, Floats]:
        """Columns of a CSV in SI units, each of shape [R], and `optional` ones that it has. Raises InputError."""
        described: dict[str, Any] = {"metres": self.metres, "blanks": self.blanks, "dimension": dimension}
        table = spreadsheet.read_columns(path, needed, optional, others=True, **described)
        if len(table[needed[0]]) < 2:
            raise InputError(f"expected the columns {' and '.join(needed)} and at least two rows", where=str(path))
        factors = {name: 1.0 if name in spreadsheet.UNITS else self.metres for name in table}
        return {name: table[name] * factors[name] for name in (*needed, *optional) if name in table}

    def read(self, scene: Scene, folder: Path, released: Between) -> Target:
        if self.csv is None:
            return super().read(scene, folder, released)
        path = folder / self.csv
        needed = [name for name in self.columns if name not in self.optional]
        table = self.table(path, needed, self.optional, scene.dimension)
        numbers: dict[str, Any] = {self.columns[name]: tuple(column.tolist()) for name, column in table.items()}
        try:
            read = replace(self, csv=None, **numbers).in_box(scene.domain.corner, [*numbers])
            return read.read(scene, folder, released)
        except InputError as error:
            # An error in a column concerns the table, not the problem's file.
            raise error.at(str(path)) if error.key in ("", *numbers) else error from None


@dataclass(frozen=True, kw_only=True)
class SeriesSettings(TabulatedSettings):
    """Settings of an observation of one number, by default at the end, or of one number at each of several times."""

    value: float | None = None  # in the unit of the kind
    values: tuple[float, ...] | None = None  # one for each of `times`
    times: tuple[float, ...] | None = None  # times [s] after the start


@dataclass(frozen=True, kw_only=True)
class LengthsSettings(TabulatedSettings):
    """Settings of an observation whose table has lengths."""

    unit: Literal["m", "cm", "mm", "ft"] = "m"  # of the lengths in a table

    @property
    def metres(self) -> float:
        return spreadsheet.UNITS["length"][self.unit]
