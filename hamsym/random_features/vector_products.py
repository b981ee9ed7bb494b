"""Vector instructions of the compiled loops: products of rows and tables, eight numbers at a time.

The tables of the march have a multiple of eight columns. The accumulators of up to four rows and
twenty-four columns stay in registers: loops that numba compiles reach a quarter of this speed.
Multiplication and addition are contracted to one rounding where the processor can.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_WIDTH = 8
_REAL, _INDEX = ir.DoubleType(), ir.IntType(64)
_VECTOR = ir.VectorType(_REAL, _WIDTH)
_CONTRACT = ("contract",)


def _constant(value: int) -> ir.Constant:
    return ir.Constant(_INDEX, value)


@contextmanager
def _while(builder: Any, condition: Callable[[], Any]) -> Iterator[None]:
    head, body, end = (builder.append_basic_block(name) for name in ("head", "body", "end"))
    builder.branch(head)
    builder.position_at_end(head)
    builder.cbranch(condition(), body, end)
    builder.position_at_end(body)
    yield
    builder.branch(head)
    builder.position_at_end(end)


def _spread(builder: Any, value: Any) -> Any:
    """Return a vector of equal numbers."""
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, value, _constant(0))
    order = ir.Constant(ir.VectorType(ir.IntType(32), _WIDTH), [0] * _WIDTH)
    return builder.shuffle_vector(first, undefined, order)


def _vector_function(builder: Any, name: str, count: int) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * count)
    return cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{_WIDTH}f64")


class _Rows:
    """Elements of a C-contiguous matrix."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:
        array = context.make_array(kind)(context, builder, value)
        self._builder, self._data = builder, array.data
        self.count, self.length = cgutils.unpack_tuple(builder, array.shape)

    def pointer(self, row: Any, column: Any) -> Any:
        offset = self._builder.add(self._builder.mul(row, self.length), column)
        return self._builder.gep(self._data, [offset])

    def vector(self, row: Any, column: Any) -> Any:
        return self._builder.bitcast(self.pointer(row, column), _VECTOR.as_pointer())


def _multiply(
    builder: Any, table: _Rows, rows: _Rows, finish: Callable[[Any, Any, Any], None]
) -> None:
    """Emit the product; ``finish(row, column, vector)`` emits the use of eight sums."""

    def tile(row: Any, column: Any, height: int, width: int) -> None:
        zero = ir.Constant(_VECTOR, [0.0] * _WIDTH)
        sums = [
            [cgutils.alloca_once(builder, _VECTOR) for _ in range(width)] for _ in range(height)
        ]
        for place in (place for line in sums for place in line):
            builder.store(zero, place)
        with cgutils.for_range(builder, table.count) as loop:
            columns = [
                builder.load(
                    table.vector(loop.index, builder.add(column, _constant(_WIDTH * k))), align=8
                )
                for k in range(width)
            ]
            for k, line in enumerate(sums):
                value = builder.load(rows.pointer(builder.add(row, _constant(k)), loop.index))
                value = _spread(builder, value)
                for place, vector in zip(line, columns, strict=True):
                    term = builder.fmul(value, vector, flags=_CONTRACT)
                    builder.store(builder.fadd(builder.load(place), term, flags=_CONTRACT), place)
        for k, line in enumerate(sums):
            for j, place in enumerate(line):
                at = builder.add(column, _constant(_WIDTH * j))
                finish(builder.add(row, _constant(k)), at, builder.load(place))

    def cover(index: Any, end: Any, steps: tuple[int, ...], unit: int) -> Iterator[int]:
        """Loop over an index in the largest steps that fit."""
        builder.store(_constant(0), index)
        for step in steps:

            def fits(step: int = step) -> Any:
                after = builder.add(builder.load(index), _constant(step * unit))
                return builder.icmp_signed("<=", after, end)

            with _while(builder, fits):
                yield step
                builder.store(builder.add(builder.load(index), _constant(step * unit)), index)

    row, column = (cgutils.alloca_once(builder, _INDEX) for _ in range(2))
    for height in cover(row, rows.count, (4, 2, 1), 1):
        for width in cover(column, table.length, (3, 2, 1), _WIDTH):
            tile(builder.load(row), builder.load(column), height, width)


@intrinsic
def products(_: Any, table: Any, rows: Any, out: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right, target = (
            _Rows(context, builder, kind, value)
            for kind, value in zip(signature.args, arguments, strict=True)
        )

        def finish(row: Any, column: Any, sums: Any) -> None:
            builder.store(sums, target.vector(row, column), align=8)

        _multiply(builder, left, right, finish)
        return context.get_dummy_value()

    return types.void(table, rows, out), generate


@intrinsic
def advance(_: Any, table: Any, rows: Any, base: Any, h: Any, states: Any, changes: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right, start, target, moved = (
            _Rows(context, builder, signature.args[k], arguments[k]) for k in (0, 1, 2, 4, 5)
        )
        factor = _spread(builder, arguments[3])
        size = _vector_function(builder, "llvm.fabs", 1)
        maximum = _vector_function(builder, "llvm.maximum", 2)  # NaN if one argument is

        def finish(row: Any, column: Any, sums: Any) -> None:
            first = builder.load(start.vector(row, column), align=8)
            new = builder.fmul(factor, sums, flags=_CONTRACT)
            new = builder.fadd(first, new, flags=_CONTRACT)
            place = target.vector(row, column)
            change = builder.call(size, [builder.fsub(new, builder.load(place, align=8))])
            builder.store(new, place, align=8)
            place = moved.vector(row, _constant(0))
            change = builder.call(maximum, [change, builder.load(place, align=8)])
            builder.store(change, place, align=8)

        with cgutils.for_range(builder, target.count) as loop:
            zero = ir.Constant(_VECTOR, [0.0] * _WIDTH)
            builder.store(zero, moved.vector(loop.index, _constant(0)), align=8)
        _multiply(builder, left, right, finish)
        return context.get_dummy_value()

    return types.void(table, rows, base, h, states, changes), generate


@intrinsic
def maxima(_: Any, rows: Any, out: Any) -> Any:
    """Eight magnitudes for each row, the largest of which is that of the row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values, target = (
            _Rows(context, builder, kind, value)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        size = _vector_function(builder, "llvm.fabs", 1)
        maximum = _vector_function(builder, "llvm.maximum", 2)
        largest = cgutils.alloca_once(builder, _VECTOR)
        blocks = builder.udiv(values.length, _constant(_WIDTH))
        with cgutils.for_range(builder, values.count) as row:
            builder.store(ir.Constant(_VECTOR, [0.0] * _WIDTH), largest)
            with cgutils.for_range(builder, blocks) as block:
                column = builder.mul(block.index, _constant(_WIDTH))
                vector = builder.load(values.vector(row.index, column), align=8)
                vector = builder.call(size, [vector])
                builder.store(builder.call(maximum, [vector, builder.load(largest)]), largest)
            builder.store(builder.load(largest), target.vector(row.index, _constant(0)), align=8)
        return context.get_dummy_value()

    return types.void(rows, out), generate


@intrinsic
def ratios(_: Any, changes: Any, scale: Any, out: Any) -> Any:
    """Eight ratios of changes, shape (dim, 8), to the scale; the largest of them is that of all."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        values = _Rows(context, builder, kinds[0], arguments[0])
        units, target = (
            context.make_array(kinds[k])(context, builder, arguments[k]).data for k in (1, 2)
        )
        maximum = _vector_function(builder, "llvm.maximum", 2)
        largest = cgutils.alloca_once(builder, _VECTOR)
        builder.store(ir.Constant(_VECTOR, [0.0] * _WIDTH), largest)
        with cgutils.for_range(builder, values.count) as row:
            vector = builder.load(values.vector(row.index, _constant(0)), align=8)
            unit = _spread(builder, builder.load(builder.gep(units, [row.index])))
            vector = builder.fdiv(vector, unit)
            builder.store(builder.call(maximum, [vector, builder.load(largest)]), largest)
        place = builder.bitcast(target, _VECTOR.as_pointer())
        builder.store(builder.load(largest), place, align=8)
        return context.get_dummy_value()

    return types.void(changes, scale, out), generate


@intrinsic
def add_products(
    _: Any,
    weights: Any,
    entry: Any,
    factor: Any,
    rows: Any,
    source: Any,
    out: Any,
    target: Any,
    count: Any,
) -> Any:
    """Add factor weights[entry] rows[source + k] to out[target + k] for k < count."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        left, right, sums = (_Rows(context, builder, kinds[k], arguments[k]) for k in (0, 3, 5))
        entry, source, target, count = (arguments[k] for k in (1, 4, 6, 7))
        factor = _spread(builder, arguments[2])
        blocks = builder.udiv(sums.length, _constant(_WIDTH))
        with cgutils.for_range(builder, blocks) as block:
            column = builder.mul(block.index, _constant(_WIDTH))
            weight = builder.load(left.vector(entry, column), align=8)
            weight = builder.fmul(factor, weight)
            with cgutils.for_range(builder, count) as row:
                value = builder.load(right.vector(builder.add(source, row.index), column), align=8)
                place = sums.vector(builder.add(target, row.index), column)
                term = builder.fmul(weight, value, flags=_CONTRACT)
                total = builder.fadd(builder.load(place, align=8), term, flags=_CONTRACT)
                builder.store(total, place, align=8)
        return context.get_dummy_value()

    return types.void(weights, entry, factor, rows, source, out, target, count), generate
