"""Vectors of 16 float32 in kernels: one row of a tile, one register of 512 bits.

LLVM makes vectors of loops by itself, but not of every loop, and keeps nothing of them in registers
from one step of an outer loop to the next. Here a kernel says what it wants: values of the type
`f32x16`, which LLVM splits where registers are shorter (AVX2, NEON). They exist inside of kernels
only: `fill`, `load`, `store`, the operators + - *, and the functions below.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel.models import PrimitiveModel
from numba.extending import intrinsic, overload, register_model

# isort: split

from gaga_core.kernels import HAS_FMA

LANES = 16
_FLOAT, _INT, _LONG = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VECTOR, _BITS = ir.VectorType(_FLOAT, LANES), ir.VectorType(_INT, LANES)
_NOTHING = ir.Constant(_VECTOR, ir.Undefined)
_PAIR: Any = types.UniTuple(types.int64, 2)  # type: ignore[no-untyped-call]
_declared: Any = cgutils.get_or_insert_function
_Generate = Callable[[Any, Any, Any, Any], Any]


class F32x16(types.Type):
    """Numba's type of 16 float32 that are worked on at once."""

    def __init__(self) -> None:
        super().__init__(name="f32x16")


f32x16 = F32x16()


def _generated(function: Callable[..., Any]) -> Any:
    """`numba.extending.intrinsic`: a kernel calls it without the context of typing."""
    return intrinsic(function)


@register_model(F32x16)
class _Model(PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)  # type: ignore[no-untyped-call]


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any, target: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), target.as_pointer())


def _constant(value: float) -> Any:
    return ir.Constant(_VECTOR, [value] * LANES)


def _filled(builder: Any, value: Any) -> Any:
    one = builder.insert_element(_NOTHING, value, _INT(0))
    return _shuffled(builder, one, _NOTHING, [0] * LANES)


def _shuffled(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    kind = ir.VectorType(_INT, len(lanes))
    return builder.shuffle_vector(a, b, ir.Constant(kind, lanes))


@_generated
def fill(typing_context: Any, value: Any) -> Any:
    """The float32 ``value`` in every lane."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _filled(builder, args[0])

    return f32x16(types.float32), generate


@_generated
def lane_numbers(typing_context: Any) -> Any:
    """0, 1, ... 15."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return ir.Constant(_VECTOR, [float(k) for k in range(LANES)])

    return f32x16(), generate


@_generated
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """16 numbers of a C-contiguous float32 ``array`` from the flat ``index`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1], _VECTOR)
        return builder.load(place, align=4)

    return f32x16(array, types.intp), generate


@_generated
def store(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
    """Write ``value`` to a C-contiguous float32 ``array`` from the flat ``index`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1], _VECTOR)
        builder.store(args[2], place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, f32x16), generate


@_generated
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c of float32 or of vectors, rounded once: the same bits on every processor.

    Compilers contract a product and a sum where the processor can, and round twice elsewhere. A
    processor that cannot has it from float64: the product is exact there, and rounding the sum to
    float64 first changes one result in 2^29.
    """

    is_vector = any(isinstance(one, F32x16) for one in (a, b, c))

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = zip(args, signature.args, strict=True)
        lanes = [
            _filled(builder, value) if is_vector and kind == types.float32 else value
            for value, kind in kinds
        ]
        if HAS_FMA:
            number = lanes[0].type
            kind = ir.FunctionType(number, [number] * 3)
            name = f"llvm.fma.v{LANES}f32" if is_vector else "llvm.fma.f32"
            return builder.call(_declared(builder.module, kind, name), lanes)
        double = ir.VectorType(ir.DoubleType(), LANES) if is_vector else ir.DoubleType()
        x, y, z = (builder.fpext(value, double) for value in lanes)
        return builder.fptrunc(builder.fadd(builder.fmul(x, y), z), lanes[0].type)

    takes = [one if isinstance(one, F32x16) else types.float32 for one in (a, b, c)]
    return (f32x16 if is_vector else types.float32)(*takes), generate


@_generated
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line of the element at the flat ``index`` of a C-contiguous ``array``.

    For rows that are far apart and known before they are needed: processors guess streams only. An
    index beyond the array does no harm.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1], ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, _INT, _INT, _INT])
        call = _declared(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(call, [place, _INT(0), _INT(3), _INT(1)])  # to read, to keep, data
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


def _binary(generate: _Generate) -> Any:
    """An intrinsic of two vectors."""

    def typed(typing_context: Any, a: Any, b: Any) -> Any:
        return f32x16(f32x16, f32x16), generate

    return _generated(typed)


def _compared(sign: str) -> _Generate:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(sign, args[0], args[1]), args[0], args[1])

    return generate


_add = _binary(lambda context, builder, signature, args: builder.fadd(*args))
_sub = _binary(lambda context, builder, signature, args: builder.fsub(*args))
_mul = _binary(lambda context, builder, signature, args: builder.fmul(*args))
smaller = _binary(_compared("<"))  # of two vectors, in each lane
larger = _binary(_compared(">"))


@_generated
def where_at_least(typing_context: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """In each lane ``yes`` if a >= b, else ``no``."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">=", args[0], args[1]), args[2], args[3])

    return f32x16(f32x16, f32x16, f32x16, f32x16), generate


@_generated
def minus_abs(typing_context: Any, a: Any) -> Any:
    """-abs(a) in each lane."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        sign = ir.Constant(_BITS, [-(1 << 31)] * LANES)
        bits = builder.or_(builder.bitcast(args[0], _BITS), sign)
        return builder.bitcast(bits, _VECTOR)

    return f32x16(f32x16), generate


@_generated
def run_at_least(typing_context: Any, a: Any, b: Any) -> Any:
    """The first lane where a >= b, and the one behind the last: (16, 0) if there is none."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        is_set = builder.fcmp_ordered(">=", args[0], args[1])
        bits = builder.bitcast(is_set, ir.IntType(LANES))
        zero_counts = ir.IntType(1)(0)  # no bit set: all of them are counted
        first = builder.zext(builder.cttz(bits, zero_counts), _LONG)
        after = builder.zext(builder.ctlz(bits, zero_counts), _LONG)
        found = [first, builder.sub(_LONG(LANES), after)]
        return context.make_tuple(builder, signature.return_type, found)

    return _PAIR(f32x16, f32x16), generate


@_generated
def reciprocal(typing_context: Any, a: Any) -> Any:
    """1 / a in each lane, for normal positive ``a``, relative error 1e-5.

    A guess from the bits of ``a``, made better twice: a division takes several times as long.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        guess = ir.Constant(_BITS, [0x7EF311C3] * LANES)
        x = builder.bitcast(builder.sub(guess, builder.bitcast(args[0], _BITS)), _VECTOR)
        for _ in range(2):
            rest = builder.fsub(_constant(1.0), builder.fmul(args[0], x))
            x = builder.fadd(x, builder.fmul(x, rest))
        return x

    return f32x16(f32x16), generate


@_generated
def log2_above(typing_context: Any, a: Any) -> Any:
    """log2 of a normal positive float32 or up to 0.09 more, from its bits."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = builder.sitofp(builder.bitcast(args[0], _INT), _FLOAT)
        return builder.fadd(builder.fmul(bits, _FLOAT(2.0**-23)), _FLOAT(0.09 - 127.0))

    return types.float32(types.float32), generate


@_generated
def total(typing_context: Any, a: Any) -> Any:
    """Sum of the lanes: float32."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(_FLOAT, [_FLOAT, _VECTOR])
        name = f"llvm.vector.reduce.fadd.v{LANES}f32"
        call = _declared(builder.module, kind, name)
        return builder.call(call, [_FLOAT(0.0), args[0]], fastmath=("reassoc",))

    return types.float32(f32x16), generate


@_generated
def store_totals(typing_context: Any, array: Any, index: Any, a: Any) -> Any:
    """Write the sums of the lanes of a tuple of 8 vectors to ``array`` from ``index`` on.

    Halves of two vectors become one, four times: a third of the steps of 8 calls of `total`.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        parts = [builder.extract_value(args[2], k) for k in range(8)]
        width = LANES  # lanes of a sum in each part
        while len(parts) > 1:
            half = width // 2
            low = [k for k in range(2 * LANES) if k % width < half]
            high = [k + half for k in low]
            parts = [
                builder.fadd(_shuffled(builder, a, b, low), _shuffled(builder, a, b, high))
                for a, b in zip(parts[::2], parts[1::2], strict=True)
            ]
            width = half
        even = _shuffled(builder, parts[0], _NOTHING, list(range(0, LANES, 2)))
        odd = _shuffled(builder, parts[0], _NOTHING, list(range(1, LANES, 2)))
        found = builder.fadd(even, odd)
        place = _address(context, builder, signature.args[0], args[0], args[1], found.type)
        builder.store(found, place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, a), generate


def _operator(of: Any, does: Any) -> None:
    """Let ``of`` of two vectors, or of a vector and a number, be ``does``."""

    @overload(of, strict=False)
    def choose(a: Any, b: Any) -> Any:
        if isinstance(a, F32x16) and isinstance(b, F32x16):
            return lambda a, b: does(a, b)  # noqa: PLW0108  (numba wants a function of Python)
        if isinstance(a, F32x16) and b == types.float32:
            return lambda a, b: does(a, fill(b))
        if a == types.float32 and isinstance(b, F32x16):
            return lambda a, b: does(fill(a), b)
        return None


_operator(operator.add, _add)
_operator(operator.sub, _sub)
_operator(operator.mul, _mul)
