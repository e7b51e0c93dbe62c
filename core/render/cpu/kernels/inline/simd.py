"""A vector of eight float32 for numba code.

LLVM does not vectorise the masked blending loops by itself (4-5x slower), so the kernels say what they mean: `Float8`
values with arithmetic between them and float32, comparisons that give masks, loads and stores on flat float32 arrays.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.typing import templates
from numba.extending import intrinsic as _intrinsic
from numba.extending import lower_builtin, models
from numba.extending import register_model as _register_model

from streamlod.core.render.cpu.kernels.inline.constants import LANES

# Numba's own types describe these functions' definitions, not what kernels call.
intrinsic: Any = _intrinsic
register_model: Any = _register_model
infer_global: Any = templates.infer_global
signature: Any = templates.signature

_FLAGS = ("contract", "nsz", "reassoc", "arcp")
_INT, _LONG = ir.IntType(32), ir.IntType(64)
_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_INTS = ir.VectorType(_INT, LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)


class Float8(types.Type):
    """Eight float32 lanes."""

    def __init__(self) -> None:
        super().__init__("float32x8")


class Mask8(types.Type):
    """Eight booleans."""

    def __init__(self) -> None:
        super().__init__("boolx8")


float8: Any = Float8()
mask8: Any = Mask8()


@register_model(Float8)
class _Float8Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLOATS)  # type: ignore[no-untyped-call]


@register_model(Mask8)
class _Mask8Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _BITS)  # type: ignore[no-untyped-call]


def _splat(builder: Any, value: Any) -> Any:
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(_INT, 0))
    return _shuffle(builder, first, first, [0] * LANES)


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(_INTS, lanes))


def _vector(builder: Any, kind: Any, value: Any) -> Any:
    return value if isinstance(kind, Float8) else _splat(builder, value)


# Arithmetic: Float8 with Float8 or float32, in either order.


class _Arithmetic(templates.AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        known = len(args) == 2 and all(isinstance(a, Float8) or a == types.float32 for a in args)
        if known and any(isinstance(a, Float8) for a in args):
            return signature(float8, *args)
        return None


def _register(symbol: Callable[..., Any], instruction: str) -> None:
    infer_global(symbol)(type(f"_{instruction}", (_Arithmetic,), {}))

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_vector(builder, kind, value) for kind, value in zip(sig.args, args, strict=True))
        return getattr(builder, instruction)(a, b, flags=_FLAGS)

    for kinds in ((Float8, Float8), (Float8, types.Float), (types.Float, Float8)):
        lower_builtin(symbol, *kinds)(lower)  # type: ignore[no-untyped-call]


for _symbol, _instruction in (
    (operator.add, "fadd"),
    (operator.iadd, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register(_symbol, _instruction)


# Functions of one, two or three vectors; float32 arguments are spread over the lanes.


def _unary(result: Any, emit: Callable[[Any, Any], Any]) -> Any:
    @intrinsic
    def function(typing_context: Any, a: Any) -> Any:
        return result(a), lambda context, builder, sig, args: emit(builder, args[0])

    return function


def _binary(result: Any, emit: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic
    def function(typing_context: Any, a: Any, b: Any) -> Any:
        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return emit(builder, _vector(builder, sig.args[0], args[0]), _vector(builder, sig.args[1], args[1]))

        return result(a, b), lower

    return function


def _compare(relation: str) -> Any:
    return _binary(mask8, lambda builder, a, b: builder.fcmp_ordered(relation, a, b))


def _lane_sum(builder: Any, a: Any) -> Any:
    for step in (4, 2, 1):
        rotated = _shuffle(builder, a, a, [(lane + step) % LANES for lane in range(LANES)])
        a = builder.fadd(a, rotated, flags=_FLAGS)
    return builder.extract_element(a, ir.Constant(_INT, 0))


def _set_sign(builder: Any, a: Any) -> Any:
    sign = ir.Constant(_INTS, [-(2**31)] * LANES)
    return builder.bitcast(builder.or_(builder.bitcast(a, _INTS), sign), _FLOATS)


splat = _unary(float8, _splat)
lane_sum = _unary(types.float32, _lane_sum)
minus_magnitude = _unary(float8, _set_sign)
at_least = _compare(">=")
above = _compare(">")
lower_of = _binary(float8, lambda builder, a, b: builder.select(builder.fcmp_ordered("<", a, b), a, b))
higher_of = _binary(float8, lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b))


@intrinsic
def both(typing_context: Any, a: Any, b: Any) -> Any:
    """Mask: a and b."""
    return mask8(a, b), lambda context, builder, sig, args: builder.and_(*args)


@intrinsic
def keep_where(typing_context: Any, mask: Any, a: Any) -> Any:
    """`a` where the mask holds, otherwise 0."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(args[0], args[1], ir.Constant(_FLOATS, [0.0] * LANES))

    return float8(mask, a), lower


@intrinsic
def choose(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask holds, otherwise `b`."""
    return float8(mask, a, b), lambda context, builder, sig, args: builder.select(*args)


@intrinsic
def lane_numbers(typing_context: Any) -> Any:
    """0, 1, ... 7."""
    return float8(), lambda context, builder, sig, args: ir.Constant(_FLOATS, [float(i) for i in range(LANES)])


@intrinsic
def lane_sums(typing_context: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any) -> Any:
    """The lane sums of eight vectors as one vector, by a transposing tree (a third of the work of eight sums)."""

    def halve(builder: Any, x: Any, y: Any, even: list[int], odd: list[int]) -> Any:
        return builder.fadd(_shuffle(builder, x, y, even), _shuffle(builder, x, y, odd), flags=_FLAGS)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        for even, odd in (
            ([0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]),
            ([0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]),
            ([0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]),
        ):
            args = [halve(builder, args[i], args[i + 1], even, odd) for i in range(0, len(args), 2)]
        return args[0]

    return float8(a, b, c, d, e, f, g, h), lower


# Memory: index counts floats from the array's start, whatever its shape; arrays must be C-contiguous float32.


def _address(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array = context.make_array(sig.args[0])(context, builder, args[0])
    index = builder.sext(args[1], _LONG) if args[1].type.width < 64 else args[1]
    return builder.gep(array.data, [index])


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """Eight floats from `index` on."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = builder.bitcast(_address(context, builder, sig, args), _FLOATS.as_pointer())
        value = builder.load(pointer)
        value.align = 4
        return value

    return float8(array, index), lower


@intrinsic
def store(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
    """Write eight floats from `index` on."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = builder.bitcast(_address(context, builder, sig, args), _FLOATS.as_pointer())
        builder.store(args[2], pointer).align = 4
        return context.get_dummy_value()

    return types.none(array, index, value), lower


@intrinsic
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line that holds float `index`."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        function = builder.module.globals.get("llvm.prefetch.p0")
        if function is None:
            kind = ir.FunctionType(ir.VoidType(), [byte, _INT, _INT, _INT])
            function = ir.Function(builder.module, kind, "llvm.prefetch.p0")
        read, keep, data = ir.Constant(_INT, 0), ir.Constant(_INT, 3), ir.Constant(_INT, 1)
        builder.call(function, [builder.bitcast(_address(context, builder, sig, args), byte), read, keep, data])
        return context.get_dummy_value()

    return types.none(array, index), lower
