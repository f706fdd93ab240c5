"""Converts tables of TOML or JSON into frozen dataclasses: an unknown key, a wrong type or a number out of bounds gives
one error. pydantic checks keys and types of a file. A record also checks itself, for records made in Python.
"""

import difflib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import chain
from typing import Any, ClassVar, TypeVar, cast, get_args, get_type_hints

import numpy as np
from pydantic import ConfigDict, PlainValidator, TypeAdapter, ValidationError

from datasets.errors import InputError, OutOfRange, require
from datasets.files import line_of

T = TypeVar("T")
UNSEEN = ("float", "str", "constants")
"""Parts of an error's path that are not in the file: alternative types of a key, and gathered keys."""
FEW_KEYS = 12  # most keys of a table that the refusal of an unknown key lists
SHORT = 3  # longest vector shown whole if one number is out of bounds: that of a place
FARTHEST = 1.0e9
"""Largest length [m], time [s], speed [m/s] and coefficient; it keeps their powers finite."""
# Building an adapter costs a hundred times as much as a validation with it.
_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


@dataclass(frozen=True)
class Bounds:
    """Bounds of a number, or of each in a vector, in words and in pydantic's terms; annotates the type of a key.
    jitter: Annotated[float, Bounds("a fraction in [0, 1]", ge=0.0, le=1.0)] = 0.8"""

    expected: str
    gt: float = -math.inf
    ge: float = -FARTHEST
    lt: float = math.inf
    le: float = FARTHEST
    words: tuple[str, ...] = ()
    """Words allowed instead of a number."""

    def hold(self, value: Any) -> bool:
        """Whether a value, if given, is within the bounds."""
        if isinstance(value, tuple):
            return all(map(self.hold, value))
        if isinstance(value, str):
            return value in self.words
        return value is None or (self.gt < value < self.lt and self.ge <= value <= self.le)

    def first_beyond(self, value: Any) -> Any:
        """The part of a value outside the bounds: a short vector as a whole, else the first such number."""
        if not isinstance(value, tuple):
            return value
        part = next(part for part in value if not self.hold(part))
        return list(value) if len(value) <= SHORT and not isinstance(part, tuple) else self.first_beyond(part)


@cache
def types_of(kind: type) -> tuple[list[str], TypeAdapter[tuple[Any, ...]]]:
    """The keys of a dataclass, and the checker of a tuple of their values."""
    hints, names = get_type_hints(kind, include_extras=True), [member.name for member in fields(kind)]
    values: Any = tuple.__class_getitem__(tuple(hints[name] for name in names))
    return names, TypeAdapter(values, config=ConfigDict(strict=True))


def plain(value: Any) -> Any:
    """NumPy numbers and arrays as Python's, lists and arrays as tuples, at any depth."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return tuple(map(plain, value)) if isinstance(value, list | tuple) else value


@cache
def bounds_of(kind: type) -> dict[str, Bounds]:
    """Key -> the bounds that annotate its type in a dataclass."""

    def within(hint: Any) -> Iterator[Bounds]:
        yield from (item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Bounds))
        for part in get_args(hint):
            yield from within(part)

    return {name: bounds for name, hint in get_type_hints(kind, include_extras=True).items() for bounds in within(hint)}


def typed(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Key -> value of a dataclass, as Python's own types. Raises InputError for a value of another type."""
    keys, types = types_of(kind)
    values = tuple(given[key] for key in keys)
    try:
        return dict(zip(keys, types.validate_python(values), strict=True))
    except ValidationError:
        values = plain(values)  # few are NumPy's, and large tables take long to walk through
    try:
        return dict(zip(keys, types.validate_python(values), strict=True))
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
        key, *inside = mistake["loc"]
        key = keys[int(key)]
        bounds = bounds_of(kind).get(key)
        # For a key that may also be a word, pydantic's message covers only one alternative.
        said = bounds.expected if bounds is not None and bounds.words else mistake["msg"]
        raise wrong({**mistake, "msg": said, "loc": (key, *inside)}) from None


class Record:
    """Base of every dataclass that is read from a file: no unknown keys, no silent conversions, no inf or nan. A record
    made in Python also accepts NumPy numbers and arrays, and inf unless bounds forbid it."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for key, value in typed(kind, vars(self)).items():
            object.__setattr__(self, key, value)
        for key, bounds in bounds_of(kind).items():
            value = getattr(self, key)
            if not bounds.hold(value):
                got = bounds.first_beyond(value)
                said = repr(got) if isinstance(got, str) else got
                raise InputError(f"expected {bounds.expected}, got {said}", key=key)


def from_mapping(kind: type[T], data: Mapping[str, Any]) -> T:
    """Build the dataclass `kind` from nested mappings; an integer may stand for a float. Raises InputError with the
    path of the first wrong key, such as `masses[1].velocity`; OutOfRange where keys and types are right."""
    try:
        # JSON mode converts nothing either, but still accepts an array for a tuple.
        text = json.dumps(data, default=str)
    except (ValueError, RecursionError) as error:
        # Numbers of thousands of digits, or deeply nested tables.
        raise InputError(f"expected tables of finite numbers, {line_of(error)}") from None
    adapter = _adapter(kind)
    try:
        record: T = adapter.validate_json(text)
        return record
    except ValidationError as error:
        mistakes = error.errors(include_url=False)
        # A misspelt key is also a missing one; "did you mean" helps more.
        first = next((mistake for mistake in mistakes if mistake["type"] == "unexpected_keyword_argument"), mistakes[0])
        if first["type"] == "unexpected_keyword_argument":
            name, schema = str(first["loc"][-1]), adapter.json_schema()
            raise InputError(unknown_key(name, *keys_of(schema, first["loc"][:-1])), key=seen(first)) from None
        raise wrong(first) from None


def seen(mistake: Mapping[str, Any]) -> str:
    """The path of pydantic's error, as in the file."""
    # If a key accepts several types, pydantic names the type that it tried last.
    return dotted(tuple(part for part in mistake["loc"] if part not in UNSEEN and "[" not in str(part)))


def wrong(mistake: Mapping[str, Any]) -> InputError:
    """The InputError for pydantic's error."""
    path, cause = seen(mistake), mistake.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        # The check of a part uses its own keys: `material.density` inside `masses[0].material`.
        key = cause.key.removeprefix(path.split(".")[-1] + ".") if path else cause.key
        return OutOfRange(cause.message, key=".".join(part for part in (path, key) if part))
    if mistake["type"] == "missing":
        return InputError("expected a value, the key is missing", key=path)
    expected = mistake["msg"].removeprefix("Input should be ")
    return InputError(f"expected {expected}, got {mistake['input']!r}", key=path)


def keys_of(schema: dict[str, Any], place: Sequence[int | str]) -> tuple[list[str], list[str]]:
    """The keys of the table at a place, and those of all tables, from the JSON schema of a record."""
    tables: dict[str, Any] = schema.get("$defs", {})
    here, everywhere = schema, [key for each in (schema, *tables.values()) for key in each.get("properties", {})]
    for part in place:
        here = here.get("properties", {}).get(part, {}) if isinstance(part, str) else here.get("items", {})
        # An optional table is an alternative to null.
        here = next((each for each in here.get("anyOf", ()) if each.get("type") != "null"), here)
        here = tables.get(str(here.get("$ref")).rsplit("/", 1)[-1], here)
    return [*here.get("properties", {})] or everywhere, everywhere


def unknown_key(name: str, names: Sequence[str], elsewhere: Sequence[str] = ()) -> str:
    """The message for an unknown key, which may belong in another table."""
    if name in elsewhere:
        return "expected a known key, this one belongs in another table"
    near = difflib.get_close_matches(name, names, n=1)
    if near:
        return f"expected a known key, did you mean {near[0]!r}?"
    return "expected a known key" + (f": {' or '.join(names)}" if 0 < len(names) <= FEW_KEYS else "")


def one_of(kinds: Mapping[str, type[T]]) -> PlainValidator:
    """The validator that reads a table into the record of its key `kind`: a union by `kind`.

    >>> observations: tuple[Annotated[ObservationSettings, one_of(KINDS)], ...]

    For a key of another kind, the error names that kind.
    """

    def read(table: Any) -> T:
        if isinstance(table, tuple(kinds.values())):
            return cast(T, table)
        require(isinstance(table, dict), "", "a table", repr(table))
        keys = {kind: ["kind", *(field.name for field in fields(record))] for kind, record in kinds.items()}  # type: ignore[arg-type]
        users = {name: [kind for kind in kinds if name in keys[kind]] for name in table}
        for name in table:
            if not users[name]:
                raise InputError(unknown_key(name, [*chain(*keys.values())]), key=name)
        require("kind" in table, "kind", "a value, the key is missing")
        kind = table["kind"]
        require(kind in kinds, "kind", f"one of {', '.join(kinds)}", repr(kind))
        for name in table:
            if kind not in users[name]:
                raise InputError(f"expected it with kind {' or '.join(users[name])} alone, not with {kind}", key=name)
        return from_mapping(kinds[kind], {name: value for name, value in table.items() if name != "kind"})

    return PlainValidator(read, json_schema_input_type=dict[str, Any])


def changed(record: Record) -> dict[str, Any]:
    """The keys of a record, and of nested records, that differ from their defaults, as `from_mapping` accepts them."""
    kind: Any = type(record)
    return dict(_adapter(kind).dump_python(record, exclude_defaults=True, warnings=False))


def fraction(text: str) -> float:
    """`2%` or `0.02` as a number, 0.02; nan for other text."""
    number = text.strip()
    try:
        return float(number.removesuffix("%")) / (100.0 if number.endswith("%") else 1.0)
    except ValueError:
        return math.nan


def dotted(location: tuple[int | str, ...]) -> str:
    """`("masses", 1, "velocity")` as `masses[1].velocity`."""
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return path
