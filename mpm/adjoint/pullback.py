"""Reverse mode by overloaded operators (Griewank & Walther 2008, chapter 6), while Taichi compiles a kernel.

    step = ti.static([Pullback(function, (stress, moduli), (dimension,))])[0]
    step.values                                         # result of function(stress, moduli, dimension), a flat list
    adj_stress, adj_moduli = ti.static(step(adjoints))  # of the arguments, in their shapes, from those of values

A function of `mpm.physics` that is straight-line code (+ - * /, ti.sqrt, ti.select, comparisons, and calls of other
such functions) is run once more as plain Python, on numbers that add their operations to the kernel and remember their
operands; then, backwards, the share of each operand in the adjoint of its result is added, too. So a term and its
reverse have one source, and at a kink the reverse takes the side that the step took. The derivative of a root at 0 is
set to 0.
"""

from collections.abc import Callable, Sequence
from functools import cache
from operator import eq, ge, gt, le, lt
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any

import taichi as ti
from taichi.lang.expr import Expr
from taichi.lang.impl import expr_init

Rule = Callable[[Any], Any]  # the adjoint of an operand from that of the result


def compared(relation: Callable[[Any, Any], Any]) -> Any:
    """A comparison as a method of `Number`; its result has no adjoint."""
    return lambda number, other: expr_init(relation(number.value, plain(other)))


class Number:
    """A number of the traced function, or a vector of lanes of such numbers: a variable of the kernel."""

    def __init__(self, tape: list["Number"], value: Any, *operands: tuple[Any, Rule], active: bool = False) -> None:
        self.tape, self.value = tape, expr_init(value)
        self.operands = [(operand, rule) for operand, rule in operands if getattr(operand, "active", False)]
        self.active: bool = active or bool(self.operands)  # whether it depends on an argument that has an adjoint
        self.adj: Any = None
        tape.append(self)

    def __add__(self, other: Any) -> "Number":
        return Number(self.tape, self.value + plain(other), (self, lambda adj: adj), (other, lambda adj: adj))

    def __sub__(self, other: Any) -> "Number":
        return Number(self.tape, self.value - plain(other), (self, lambda adj: adj), (other, lambda adj: 0.0 - adj))

    def __rsub__(self, other: float) -> "Number":
        return Number(self.tape, other - self.value, (self, lambda adj: 0.0 - adj))

    def __mul__(self, other: Any) -> "Number":
        factor = plain(other)
        if isinstance(other, float) and other == 0.0:
            return Number(self.tape, 0.0 * self.value)
        operand = (self, lambda adj: adj * factor)
        return Number(self.tape, self.value * factor, operand, (other, lambda adj: adj * self.value))

    def __truediv__(self, other: Any) -> "Number":
        divisor = plain(other)
        per = cache(lambda: expr_init(1.0 / divisor))
        numerator, divided = (self, lambda adj: adj * per()), (other, lambda adj: 0.0 - adj * result.value * per())
        result: Number = Number(self.tape, self.value / divisor, numerator, divided)
        return result

    def __rtruediv__(self, other: float) -> "Number":
        operand = (self, lambda adj: 0.0 - adj * result.value / self.value)
        result: Number = Number(self.tape, other / self.value, operand)
        return result

    def __pow__(self, power: int) -> "Number":
        return Number(self.tape, self.value**power, (self, lambda adj: power * adj * self.value ** (power - 1)))

    __radd__, __rmul__ = __add__, __mul__

    __hash__ = object.__hash__

    __eq__, __gt__, __ge__, __lt__, __le__ = map(compared, (eq, gt, ge, lt, le))


def plain(number: Any) -> Any:
    """The expression of a `Number`; other numbers unchanged."""
    return number.value if isinstance(number, Number) else number


def root(a: Number) -> Number:
    """Like `ti.sqrt`."""
    operand = (a, lambda adj: ti.select(result.value > 0.0, 0.5 * adj / result.value, 0.0))
    result: Number = Number(a.tape, ti.sqrt(a.value), operand)
    return result


def selected(condition: Any, a: Any, b: Any) -> Number:
    """Like `ti.select`; at least one value is a `Number`."""
    tape = a.tape if isinstance(a, Number) else b.tape
    first, second = (a, lambda adj: ti.select(condition, adj, 0.0)), (b, lambda adj: ti.select(condition, 0.0, adj))
    return Number(tape, ti.select(condition, plain(a), plain(b)), first, second)


OPERATIONS = SimpleNamespace(static=lambda value: value, sqrt=root, select=selected)  # `ti` in traced functions


@cache
def traceable(function: Callable[..., Any]) -> Callable[..., Any]:
    """The Python of a Taichi function, with `OPERATIONS` for Taichi's and the Python of the functions it calls."""
    python: Any = getattr(function, "__wrapped__", function)
    used = {name: value for name, value in python.__globals__.items() if name in names_in(python.__code__)}
    used = {name: traceable(value) if isinstance(value, FunctionType) else value for name, value in used.items()}
    names = {**used, "ti": OPERATIONS, "__builtins__": python.__builtins__}
    return FunctionType(python.__code__, names, python.__name__, python.__defaults__, python.__closure__)


def names_in(code: CodeType) -> set[str]:
    """The names that a function uses, including its comprehensions."""
    inner = (names_in(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def mapped(change: Callable[[Any], Any], values: Any) -> Any:
    """`values`, nested in lists and tuples, each changed."""
    return [mapped(change, value) for value in values] if isinstance(values, list | tuple) else change(values)


def flat(values: Any) -> list[Any]:
    """Values nested in lists and tuples, one after the other."""
    return [one for value in values for one in flat(value)] if isinstance(values, list | tuple) else [values]


class Pullback:
    """A function at arguments, expressions of Taichi nested in lists, and constants without adjoints; its reverse."""

    _data_oriented = True  # tells Taichi that a kernel may hold it as a Python object of compile time

    def __init__(self, function: Callable[..., Any], arguments: Sequence[Any], constants: Sequence[Any] = ()) -> None:
        self.tape: list[Number] = []
        self.arguments = mapped(lambda value: Number(self.tape, value, active=True), arguments)
        others = mapped(lambda value: Number(self.tape, value) if isinstance(value, Expr) else value, constants)
        self.results = flat(traceable(function)(*self.arguments, *others))
        self.values = [plain(result) for result in self.results]

    def __call__(self, adjoints: Sequence[Any]) -> list[Any]:
        """Adjoints of the arguments from those of the values; None stands for no adjoint."""
        for result, adj in zip(self.results, adjoints, strict=True):
            if isinstance(result, Number):
                result.adj = expr_init(adj if result.adj is None else result.adj + adj)
        for number in reversed(self.tape):
            for operand, rule in number.operands if number.adj is not None else ():
                share = rule(number.adj)
                operand.adj = expr_init(share if operand.adj is None else operand.adj + share)
        none = expr_init(0.0 * adjoints[0])
        gradients: list[Any] = mapped(lambda argument: none if argument.adj is None else argument.adj, self.arguments)
        return gradients
