"""Records: bounds hold for what a file says and for what Python says, in the same words."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from datasets.errors import OutOfRange
from datasets.schema import FARTHEST, Bounds, Record, changed, from_mapping
from tests.refusals import refused


@dataclass(frozen=True, kw_only=True)
class Limited(Record):
    """A number, a vector and what may be a word, each within bounds."""

    share: Annotated[float, Bounds("a share in (0, 1]", gt=0.0, le=1.0)] = 0.5
    count: int = 1
    kept: Annotated[Literal["some"] | int, Bounds("some or how many", words=("some",))] = 1
    sizes: Annotated[tuple[float, ...], Bounds("positive lengths", gt=0.0)] | None = None
    rows: Annotated[tuple[tuple[float, ...], ...], Bounds("coefficients of at least 0", ge=0.0)] = ()
    friction: Annotated[float | str, Bounds("a coefficient or 'rough'", ge=0.0, words=("rough",))] = 0.0


@dataclass(frozen=True, kw_only=True)
class Holder(Record):
    """Records in a record."""

    parts: tuple[Limited, ...]
    spare: Limited | None = None


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"share": 0.0}, "share: expected a share in (0, 1], got 0.0"),
        ({"share": 1.5}, "share: expected a share in (0, 1], got 1.5"),
        ({"sizes": (0.1, -1.0)}, "sizes: expected positive lengths, got [0.1, -1.0]"),
        ({"sizes": (1.0,) * 999 + (0.0,)}, "sizes: expected positive lengths, got 0.0"),
        ({"rows": ((0.3,), (0.3, -0.5))}, "rows: expected coefficients of at least 0, got [0.3, -0.5]"),
        ({"rows": ((0.3,) * 50, (0.3,) * 50 + (-0.5,))}, "rows: expected coefficients of at least 0, got -0.5"),
        ({"sizes": (2.0 * FARTHEST,)}, "sizes: expected positive lengths, got [2000000000.0]"),
        ({"friction": "smooth"}, "friction: expected a coefficient or 'rough', got 'smooth'"),
    ],
)
def test_a_value_out_of_bounds_is_named_alike(values: dict[str, Any], expected: str) -> None:
    assert str(refused(Limited, **values)) == expected
    of_file = refused(from_mapping, Holder, {"parts": [{}, values]})
    assert (type(of_file), str(of_file)) == (OutOfRange, f"parts[1].{expected}")


@pytest.mark.parametrize("values", [{}, {"share": 1.0}, {"sizes": (1, 2.0)}, {"friction": "rough"}, {"friction": 0}])
def test_a_value_within_is_taken(values: dict[str, Any]) -> None:
    assert from_mapping(Holder, {"parts": [values]}).parts == (Limited(**values),)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"share": None}, "share: expected a valid number, got None"),
        ({"share": True}, "share: expected a valid number, got True"),
        ({"share": float("nan")}, "share: expected a share in (0, 1], got nan"),
        ({"count": np.float32(0.5)}, "count: expected a valid integer, got 0.5"),
        ({"kept": "all"}, "kept: expected some or how many, got 'all'"),
        ({"sizes": 0.1}, "sizes: expected a valid tuple, got 0.1"),
        ({"sizes": np.array([[0.1]])}, "sizes[0]: expected a valid number, got (0.1,)"),
        ({"rows": ((0.3,), 0.3)}, "rows[1]: expected a valid tuple, got 0.3"),
        ({"friction": None}, "friction: expected a coefficient or 'rough', got None"),
    ],
)
def test_another_type_is_named(values: dict[str, Any], said: str) -> None:
    assert str(refused(Limited, **values)) == said
    refused(Holder, parts=(Limited(), values), said="expected an instance of Limited")


def test_numbers_and_arrays_of_numpy_become_those_of_python() -> None:
    made: Any = {"share": np.float32(0.5), "count": np.int64(3), "sizes": np.array([1.0, 2.0], np.float32)}
    record = Limited(**made, rows=[np.array([1, 2]), [3.0]], friction=np.float64(0.25))  # type: ignore[arg-type]
    assert record == Limited(share=0.5, count=3, sizes=(1.0, 2.0), rows=((1.0, 2.0), (3.0,)), friction=0.25)
    assert [type(value) for value in vars(record).values()] == [float, int, int, tuple, tuple, float]
    assert from_mapping(Limited, changed(record)) == record


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"parts": [{"shre": 0.5}]}, "parts[0].shre: expected a known key, did you mean 'share'?"),
        ({"parts": [], "spare": {"size": 0.5}}, "spare.size: expected a known key, did you mean 'sizes'?"),
        ({"parts": [{"spar": 0.5}]}, "parts[0].spar: expected a known key, did you mean 'share'?"),
        ({"parts": [], "share": 0.5}, "share: expected a known key, this one belongs in another table"),
        ({"parts": [], "solver": {}}, "solver: expected a known key: parts or spare"),
    ],
)
def test_what_may_be_meant_is_a_key_of_the_same_table(values: dict[str, Any], said: str) -> None:
    assert str(refused(from_mapping, Holder, values)) == said
