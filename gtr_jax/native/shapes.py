"""Operations of JAX on the shape of arrays, and along their axes, as LLVM instructions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from llvmlite import ir

from .elementwise import ELEMENTWISE
from .values import (
    BOOL,
    DOUBLE,
    FEW,
    LONG,
    Block,
    Computed,
    Untranslatable,
    Value,
    Writer,
    kind_in,
    kind_of,
    plain,
    size_of,
)


def _reshaped(w: Writer, params: Any, shape: tuple[int, ...], a: Computed) -> Value:
    if isinstance(a, np.ndarray):
        return a.reshape(shape)
    return dataclasses.replace(a, shape=shape)


def _broadcast(w: Writer, params: Any, shape: tuple[int, ...], a: Computed, *rest: Computed) -> Value:
    axes = params["broadcast_dimensions"]
    if isinstance(a, np.ndarray) and a.size > 1 and size_of(shape) > FEW:
        a = w.spilled(a)

    def element(index: list[Any]) -> Any:
        own = [LONG(0) if a.shape[k] == 1 else index[axis] for k, axis in enumerate(axes)]
        return w.element(a, own)

    return w.filled(shape, kind_in(a), element)


def _sliced(w: Writer, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    starts, strides = params["start_indices"], params["strides"] or (1,) * len(shape)
    if isinstance(a, np.ndarray):
        limits = params["limit_indices"]
        return a[tuple(slice(*three) for three in zip(starts, limits, strides, strict=True))]

    def element(index: list[Any]) -> Any:
        own = [w.add(w.scaled(i, k), LONG(s)) for i, s, k in zip(index, starts, strides, strict=True)]
        return w.element(a, own)

    return w.filled(shape, a.kind, element)


def _transposed(w: Writer, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    order = params["permutation"]
    if isinstance(a, np.ndarray):
        return a.transpose(order)
    if isinstance(a, Block) and sum(extent > 1 for extent in shape) <= 1:
        return dataclasses.replace(a, shape=shape)

    def element(index: list[Any]) -> Any:
        own: list[Any] = [None] * len(order)
        for axis, source in enumerate(order):
            own[source] = index[axis]
        return w.element(a, own)

    return w.filled(shape, a.kind, element)


def _joined(w: Writer, params: Any, shape: tuple[int, ...], *parts: Value) -> Value:
    axis = params["dimension"]
    kind = next((kind_in(part) for part in parts if size_of(part.shape)), DOUBLE)
    kind = w.wide_of(kind, *parts)
    if all(isinstance(part, np.ndarray) for part in parts) and size_of(shape) <= FEW:
        return np.concatenate([_spread(w, part, kind) for part in parts], axis=axis)
    out = w.room(shape, kind)
    before = 0
    for part in parts:
        if not size_of(part.shape):
            continue
        shift = before
        if isinstance(part, np.ndarray) and part.size > 1:
            part = w.spilled(part)

        _over(
            w,
            part.shape,
            lambda index, part=part, shift=shift: w.store(
                w.element(part, index),
                out,
                w.linear([*index[:axis], w.at.add(index[axis], LONG(shift)), *index[axis + 1 :]], shape),
            ),
        )
        before += part.shape[axis]
    return out


def _spread(w: Writer, part: Any, kind: ir.Type) -> Any:
    """A small array with elements of a type."""
    out = np.empty(part.shape, dtype=object)
    for index in np.ndindex(*part.shape):
        out[index] = w.spread(part[index], kind)
    return out


def _stacked(w: Writer, params: Any, shape: tuple[int, ...], *parts: Computed) -> Value:
    axis = params.get("axis", params.get("dimension", 0))
    whole = [_reshaped(w, None, (*p.shape[:axis], 1, *p.shape[axis:]), p) for p in parts]
    return _joined(w, {"dimension": axis}, shape, *whole)


def _over(w: Writer, shape: Sequence[int], body: Callable[[list[Any]], None]) -> None:
    """body(indices) for all indices of a shape."""

    def nested(axis: int, index: list[Any]) -> None:
        if axis == len(shape):
            body(index)
        elif shape[axis] <= 4:
            for i in range(shape[axis]):
                nested(axis + 1, [*index, LONG(i)])
        else:
            w.loop(shape[axis], lambda i: nested(axis + 1, [*index, i]))

    nested(0, [])


def _reduction(fold: Callable[..., Any], start: Callable[[ir.Type], Any]) -> Callable[..., Value]:
    def write(w: Writer, params: Any, shape: tuple[int, ...], a: Value) -> Value:
        axes = params["axes"]
        kind = kind_in(a)
        first = w.spread(start(plain(kind)), kind)
        if isinstance(a, np.ndarray) and size_of(shape) <= FEW:
            moved = np.moveaxis(a, axes, range(len(axes)))
            rows = moved.reshape(-1, *shape)
            out = np.empty(shape, dtype=object)
            for index in np.ndindex(*shape):
                values = [rows[(k, *index)] for k in range(len(rows))]
                total = values[0] if values else first
                for value in values[1:]:
                    total = fold(w, None, total, value)
                out[index] = total
            return out
        kept = [axis for axis in range(len(a.shape)) if axis not in axes]

        def element(index: list[Any]) -> Any:
            total = w.slot(kind)
            w.at.store(first, total)

            def one(inner: list[Any]) -> None:
                own: list[Any] = [None] * len(a.shape)
                for axis, i in zip(kept, index, strict=True):
                    own[axis] = i
                for axis, i in zip(axes, inner, strict=True):
                    own[axis] = i
                w.at.store(fold(w, None, w.at.load(total, typ=kind), w.element(a, own)), total)

            _over(w, [a.shape[axis] for axis in axes], one)
            return w.at.load(total, typ=kind)

        return w.filled(shape, kind, element)

    return write


def _cumulative(w: Writer, params: Any, shape: tuple[int, ...], a: Computed) -> Value:
    axis, reverse = params["axis"], params["reverse"]
    whole = w.spilled(a) if isinstance(a, np.ndarray) else a
    out = w.room(shape, whole.kind)
    others = [extent for k, extent in enumerate(shape) if k != axis]

    def along(rest: list[Any]) -> None:
        total = w.slot(whole.kind)
        w.at.store(w.spread(DOUBLE(0.0), whole.kind), total)

        def step(i: Any) -> None:
            k = w.at.sub(LONG(shape[axis] - 1), i) if reverse else i
            linear = w.linear([*rest[:axis], k, *rest[axis:]], shape)
            w.at.store(w.at.fadd(w.at.load(total, typ=whole.kind), w.load(whole, linear)), total)
            w.store(w.at.load(total, typ=whole.kind), out, linear)

        w.loop(shape[axis], step)

    _over(w, others, along)
    return w.gathered(out)


def _largest_at(w: Writer, params: Any, shape: tuple[int, ...], a: Computed) -> Value:
    (axis,) = params["axes"]
    if not isinstance(a, np.ndarray) or a.ndim != 1 or axis != 0:
        raise Untranslatable("argmax of a large array")
    best, where = a[0], LONG(0)
    for i in range(1, len(a)):
        over = w.at.fcmp_ordered(">", a[i], best)
        best, where = w.select(over, a[i], best), w.select(over, LONG(i), where)
    out = np.empty((), dtype=object)
    out[()] = where
    return out


def _counted(w: Writer, params: Any, shape: tuple[int, ...]) -> Value:
    kind, axis = kind_of(params["dtype"]), params["dimension"]

    def element(index: list[Any]) -> Any:
        if kind == LONG:
            return index[axis]
        if isinstance(index[axis], ir.Constant):
            return DOUBLE(float(index[axis].constant))
        return w.at.sitofp(index[axis], DOUBLE)

    return w.filled(shape, kind, element)


def _empty(w: Writer, params: Any, shape: tuple[int, ...]) -> Value:
    """An array whose elements are written before they are read."""
    kind = kind_of(params["dtype"])
    return w.filled(shape, kind, lambda index: ir.Constant(kind, 0))


def _reversed(w: Writer, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    axes = params["dimensions"]
    if isinstance(a, np.ndarray):
        return np.flip(a, axes)

    def element(index: list[Any]) -> Any:
        return w.element(
            a, [w.at.sub(LONG(shape[k] - 1), i) if k in axes else i for k, i in enumerate(index)]
        )

    return w.filled(shape, a.kind, element)


def _padded(w: Writer, params: Any, shape: tuple[int, ...], a: Value, filler: Value) -> Value:
    edges = [[int(width) for width in edge] for edge in params["padding_config"]]
    if any(low < 0 or high < 0 or between for low, high, between in edges):
        raise Untranslatable("pad that cuts or spreads")
    if all(low == high == 0 for low, high, _ in edges):
        return a
    parts, kind = a, w.wide_of(kind_in(a), a, filler)
    for axis, (low, high, _) in enumerate(edges):
        sides = [(*parts.shape[:axis], n, *parts.shape[axis + 1 :]) for n in (low, high)]
        before, after = (w.filled(side, kind, lambda index: w.element(filler, [])) for side in sides)
        whole = (*parts.shape[:axis], low + parts.shape[axis] + high, *parts.shape[axis + 1 :])
        parts = _joined(w, {"dimension": axis}, whole, before, parts, after)
    return parts


def _rows(w: Writer, params: Any, shape: tuple[int, ...], a: Value, places: Value) -> Value:
    """Rows of an array along one axis, at places of any shape; where it is a batch, of each its own."""
    where = params["dimension_numbers"]
    along, batch = where.start_index_map, where.operand_batching_dims
    sizes = tuple(1 if d in (*along, *batch) else n for d, n in enumerate(a.shape))
    single = len(along) == 1 and where.collapsed_slice_dims == along
    if not single or tuple(params["slice_sizes"]) != sizes:
        raise Untranslatable("gather of other than rows")
    kind = kind_in(a)
    fills = params["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP and plain(kind) == DOUBLE
    kind = w.wide_of(kind, places)
    length = a.shape[along[0]]

    def element(index: list[Any]) -> Any:
        within = iter([index[k] for k in where.offset_dims])
        at = [i for k, i in enumerate(index) if k not in where.offset_dims]
        row = w.element(places, [*at, LONG(0)])
        zero, end = (w.spread(LONG(k), row.type) for k in (0, length))
        low, high = w.at.icmp_signed("<", row, zero), w.at.icmp_signed(">=", row, end)
        inside = w.select(high, LONG(length - 1), w.select(low, LONG(0), row))
        own = dict(zip(batch, (at[k] for k in where.start_indices_batching_dims), strict=True))
        own[along[0]] = inside
        value = w.element(a, [own[d] if d in own else next(within) for d in range(len(a.shape))])
        return w.select(w.at.or_(low, high), DOUBLE(math.nan), value) if fills else value

    return w.filled(shape, kind, element)


def _replaced(w: Writer, params: Any, shape: tuple[int, ...], a: Value, places: Value, rows: Value) -> Value:
    """An array with one of its rows along the first axis replaced."""
    where = params["dimension_numbers"]
    single = where.inserted_window_dims == where.scatter_dims_to_operand_dims == (0,)
    if not single or where.operand_batching_dims or places.shape != (1,) or rows.shape != shape[1:]:
        raise Untranslatable("scatter of other than one row")
    kind = w.wide_of(kind_in(a), a, places, rows)
    row = w.element(places, [LONG(0)])

    def element(index: list[Any]) -> Any:
        here = w.at.icmp_signed("==", *w.alike(index[0], row))
        return w.select(here, w.element(rows, index[1:]), w.element(a, index))

    return w.filled(shape, kind, element)


SHAPES: dict[str, Callable[..., Value]] = {
    "reshape": _reshaped,
    "squeeze": _reshaped,
    "expand_dims": _reshaped,
    "broadcast_in_dim": _broadcast,
    "slice": _sliced,
    "transpose": _transposed,
    "concatenate": _joined,
    "stack": _stacked,
    "rev": _reversed,
    "pad": _padded,
    "gather": _rows,
    "scatter": _replaced,
    "iota": _counted,
    "empty2": _empty,
    "argmax": _largest_at,
    "cumsum": _cumulative,
    "reduce_sum": _reduction(ELEMENTWISE["add"], lambda kind: DOUBLE(0.0) if kind == DOUBLE else LONG(0)),
    "reduce_max": _reduction(
        ELEMENTWISE["max"], lambda kind: DOUBLE(-math.inf) if kind == DOUBLE else LONG(-(2**63))
    ),
    "reduce_min": _reduction(
        ELEMENTWISE["min"], lambda kind: DOUBLE(math.inf) if kind == DOUBLE else LONG(2**63 - 1)
    ),
    "reduce_and": _reduction(ELEMENTWISE["and"], lambda kind: BOOL(1)),
    "reduce_or": _reduction(ELEMENTWISE["or"], lambda kind: BOOL(0)),
}
