"""From a traced JAX program to LLVM's intermediate representation.

Arrays of a few elements become one LLVM value per element, so that the equations of a node turn into
straight-line code; larger ones lie in a workspace and are processed in loops. Only primitives that the
mechanics uses are supported: any other raises `Untranslatable`, and the caller uses JAX instead.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.extend
import numpy as np
from llvmlite import ir

# Arrays of up to so many elements become one LLVM value per element.
FEW = 24
DOUBLE, LONG, BOOL = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
BYTES = 8  # of every element in the workspace

Values = np.ndarray  # of one LLVM value per element, dtype object


class Untranslatable(NotImplementedError):
    """A primitive, or a use of one, that is not supported here."""


@dataclasses.dataclass(frozen=True)
class Block:
    """A larger array in memory: where it begins, its shape and the type of its elements; row-major."""

    start: Any
    shape: tuple[int, ...]
    kind: ir.Type


Value = Values | Block


def kind_of(dtype: Any) -> ir.Type:
    """LLVM's type of an element."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return BOOL
    if np.issubdtype(dtype, np.floating):
        return DOUBLE
    if np.issubdtype(dtype, np.integer):
        return LONG
    raise Untranslatable(f"elements of type {dtype}")


def _size(shape: Sequence[int]) -> int:
    return int(np.prod(shape, dtype=int))


class Translator:
    """Writes one function.

    Args:
        module: what it belongs to.
        function: the function being written; the workspace is its argument `workspace`.
    """

    def __init__(self, module: ir.Module, function: ir.Function, workspace: ir.Value):
        self.module, self.function, self.workspace = module, function, workspace
        self.entry = function.append_basic_block("entry")
        self.at = ir.IRBuilder(self.entry)
        self.taken = 0  # bytes of the workspace

    # --- memory -------------------------------------------------------------------------------------------

    def room(self, shape: tuple[int, ...], kind: ir.Type) -> Block:
        """A new array in the workspace."""
        start = self.at.gep(self.workspace, [LONG(self.taken)], source_etype=ir.IntType(8))
        self.taken += BYTES * max(_size(shape), 1)
        return Block(start, shape, kind)

    def slot(self, kind: ir.Type) -> ir.Value:
        """Room for one value on the stack, which LLVM turns into registers."""
        with self.at.goto_entry_block():
            return self.at.alloca(kind)

    def load(self, block: Block, index: Any) -> Any:
        """Element of a block at a linear index."""
        held = LONG if block.kind == BOOL else block.kind
        value = self.at.load(self.at.gep(block.start, [_long(index)], source_etype=held), typ=held)
        return self.at.trunc(value, BOOL) if block.kind == BOOL else value

    def store(self, value: Any, block: Block, index: Any) -> None:
        """Write an element."""
        held = LONG if block.kind == BOOL else block.kind
        value = self.at.zext(value, LONG) if block.kind == BOOL else value
        self.at.store(value, self.at.gep(block.start, [_long(index)], source_etype=held))

    def loop(self, count: Any, body: Callable[[Any], None]) -> None:
        """body(i) for i from 0 to count - 1."""
        i = self.slot(LONG)
        self.at.store(LONG(0), i)
        head, inside, after = (self.function.append_basic_block(n) for n in ("head", "body", "after"))
        self.at.branch(head)
        self.at.position_at_end(head)
        now = self.at.load(i, typ=LONG)
        self.at.cbranch(self.at.icmp_signed("<", now, _long(count)), inside, after)
        self.at.position_at_end(inside)
        body(now)
        self.at.store(self.at.add(now, LONG(1)), i)
        self.at.branch(head)
        self.at.position_at_end(after)

    def filled(self, shape: tuple[int, ...], kind: ir.Type, element: Callable[[list[Any]], Any]) -> Value:
        """An array from a function that gives the element at indices, one per axis."""
        if _size(shape) <= FEW:
            out = np.empty(shape, dtype=object)
            for index in np.ndindex(*shape):
                out[index] = element([LONG(i) for i in index])
            return out
        block = self.room(shape, kind)

        def nested(axis: int, index: list[Any], linear: Any) -> None:
            if axis == len(shape):
                self.store(element(index), block, linear)
                return

            def body(i: Any) -> None:
                nested(axis + 1, [*index, i], self.at.add(self.at.mul(linear, LONG(shape[axis])), i))

            self.loop(shape[axis], body)

        nested(0, [], LONG(0))
        return block

    def element(self, value: Value, index: Sequence[Any]) -> Any:
        """The element of an array at indices, one per axis."""
        index = [LONG(0) if n == 1 else i for i, n in zip(index, value.shape, strict=True)]
        if isinstance(value, np.ndarray):
            if all(isinstance(i, ir.Constant) for i in index):
                return value[tuple(i.constant for i in index)]
            value = self.spilled(value)
        linear: Any = LONG(0)
        for i, extent in zip(index, value.shape, strict=True):
            linear = self.at.add(self.at.mul(linear, LONG(extent)), i)
        return self.load(value, linear)

    def spilled(self, values: Values) -> Block:
        """A small array, stored in the workspace."""
        flat = values.ravel()
        block = self.room(values.shape, flat[0].type)
        for i, value in enumerate(flat):
            self.store(value, block, i)
        return block

    def gathered(self, block: Block) -> Value:
        """A small array, loaded from memory; a larger one stays there."""
        if _size(block.shape) > FEW:
            return block
        out = np.empty(block.shape, dtype=object)
        for i, index in enumerate(np.ndindex(*block.shape)):
            out[index] = self.load(block, i)
        return out

    def constant(self, array: Any) -> Value:
        """A constant array."""
        array = np.asarray(array)
        kind = kind_of(array.dtype)
        plain = array.astype({DOUBLE: float, LONG: int, BOOL: int}[kind])
        if array.size <= FEW:
            out = np.empty(array.shape, dtype=object)
            for index in np.ndindex(*array.shape):
                out[index] = ir.Constant(kind, plain[index].item())
            return out
        stored = LONG if kind == BOOL else kind
        whole = ir.ArrayType(stored, array.size)
        known = ir.GlobalVariable(self.module, whole, self.module.get_unique_name("known"))
        known.linkage, known.global_constant = "internal", True
        known.initializer = ir.Constant(  # pyright: ignore[reportAttributeAccessIssue]
            whole, [ir.Constant(stored, v.item()) for v in plain.ravel()]
        )
        return Block(self.at.bitcast(known, ir.PointerType()), array.shape, kind)

    def copied(self, value: Value, into: Block) -> None:
        """Write an array over a block."""
        if isinstance(value, np.ndarray):
            for i, one in enumerate(value.ravel()):
                self.store(one, into, i)
            return
        self.loop(_size(into.shape), lambda i: self.store(self.load(value, i), into, i))

    # --- programs -----------------------------------------------------------------------------------------

    def run(self, jaxpr: Any, known: Sequence[Any], given: Sequence[Value]) -> list[Value]:
        """Write a traced program.

        Args:
            jaxpr: the program.
            known: its constants.
            given: its arguments.

        Returns:
            What it returns.
        """
        values: dict[Any, Value] = {}
        for variable, array in zip(jaxpr.constvars, known, strict=True):
            values[variable] = (
                array
                if isinstance(array, np.ndarray | Block) and _is_value(array)
                else (self.constant(array))
            )
        values.update(zip(jaxpr.invars, given, strict=True))

        def read(atom: Any) -> Value:
            return self.constant(atom.val) if isinstance(atom, jax.extend.core.Literal) else values[atom]

        for eqn in jaxpr.eqns:
            found = self.written(eqn, [read(v) for v in eqn.invars])
            values.update(zip(eqn.outvars, found, strict=True))
        return [read(v) for v in jaxpr.outvars]

    def written(self, eqn: Any, given: list[Value]) -> list[Value]:
        """Write one operation."""
        name, params = eqn.primitive.name, eqn.params
        shapes = [v.aval.shape for v in eqn.outvars]
        if name in ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "core_call", "remat"):
            inner = params.get("jaxpr", params.get("call_jaxpr", params.get("fun_jaxpr")))
            return self.run(inner.jaxpr, inner.consts, given)
        if name == "scan":
            return self.scan(params, given)
        if name == "while":
            return self.while_loop(params, given)
        if name == "cond":
            return self.branched(params, given)
        if name in ELEMENTWISE:
            kinds = [kind_of(v.aval.dtype) for v in eqn.invars]
            write = ELEMENTWISE[name]

            def one(index: list[Any]) -> Any:
                return write(
                    self, params, kinds, *[self.element(v, index if _rank(v) else []) for v in given]
                )

            return [self.filled(shapes[0], kind_of(eqn.outvars[0].aval.dtype), one)]
        if name in SHAPES:
            return [SHAPES[name](self, params, shapes[0], *given)]
        raise Untranslatable(name)

    def kept(self, value: Value) -> tuple[Any, Callable[[], Value], Callable[[Value], None]]:
        """Storage of a value that a loop carries, and how to read and write it."""
        if isinstance(value, np.ndarray):
            first: Any = value
            slots = np.empty(value.shape, dtype=object)
            for index in np.ndindex(*value.shape):
                slots[index] = self.slot(first[index].type)
                self.at.store(value[index], slots[index])

            def read() -> Value:
                out = np.empty(slots.shape, dtype=object)
                for index in np.ndindex(*slots.shape):
                    out[index] = self.at.load(slots[index], typ=first[index].type)
                return out

            def write(new: Value) -> None:
                assert isinstance(new, np.ndarray)
                for index in np.ndindex(*slots.shape):
                    self.at.store(new[index], slots[index])

            return slots, read, write
        block = self.room(value.shape, value.kind)
        self.copied(value, block)
        return block, lambda: block, lambda new: self.copied(new, block)

    def exchanged(self, kept: Sequence[Any], new: Sequence[Value]) -> None:
        """Write all carried values at once; a new value that lies in another's storage is copied first."""
        saved = []
        homes = {id(place.start) for place, _, _ in kept if isinstance(place, Block)}
        for (place, _, _), value in zip(kept, new, strict=True):
            moved = isinstance(value, Block) and id(value.start) in homes and value is not place
            if moved:
                assert isinstance(value, Block)
                other = self.room(value.shape, value.kind)
                self.copied(value, other)
                value = other
            saved.append(value)
        for (place, _, write), value in zip(kept, saved, strict=True):
            if not (isinstance(value, Block) and isinstance(place, Block) and value.start is place.start):
                write(value)

    def scan(self, params: Any, given: list[Value]) -> list[Value]:
        """Write a scan."""
        consts, carries = params["num_consts"], params["num_carry"]
        inner, length = params["jaxpr"], params["length"]
        fixed, first, rows = given[:consts], given[consts : consts + carries], given[consts + carries :]
        if params["reverse"]:
            raise Untranslatable("a scan in reverse")
        kept = [self.kept(value) for value in first]
        rows = [self.spilled(v) if isinstance(v, np.ndarray) and v.size else v for v in rows]
        out = [self.room(v.aval.shape, kind_of(v.aval.dtype)) for v in _outs(inner, carries, length)]

        def body(i: Any) -> None:
            slices = [self.row(v, i) for v in rows]
            found = self.run(inner.jaxpr, inner.consts, [*fixed, *[read() for _, read, _ in kept], *slices])
            for block, value in zip(out, found[carries:], strict=True):
                self.copied(value, self.row_of(block, i))
            self.exchanged(kept, found[:carries])

        self.loop(length, body)
        return [*[read() for _, read, _ in kept], *[self.gathered(b) for b in out]]

    def row_of(self, block: Block, i: Any) -> Block:
        """Entry i of a block along its first axis."""
        start = self.at.mul(_long(i), LONG(_size(block.shape[1:])))
        return Block(self.at.gep(block.start, [start], source_etype=LONG), block.shape[1:], block.kind)

    def row(self, value: Value, i: Any) -> Value:
        """Entry i of an array along its first axis, loaded from memory where it is small."""
        if isinstance(value, np.ndarray):  # of no elements
            return np.empty(value.shape[1:], dtype=object)
        return self.gathered(self.row_of(value, i))

    def while_loop(self, params: Any, given: list[Value]) -> list[Value]:
        """Write a while loop."""
        a, b = params["cond_nconsts"], params["body_nconsts"]
        kept = [self.kept(value) for value in given[a + b :]]
        head, inside, after = (self.function.append_basic_block(n) for n in ("again", "turn", "done"))
        self.at.branch(head)
        self.at.position_at_end(head)
        cond, body = params["cond_jaxpr"], params["body_jaxpr"]
        (on,) = self.run(cond.jaxpr, cond.consts, [*given[:a], *[read() for _, read, _ in kept]])
        assert isinstance(on, np.ndarray)
        self.at.cbranch(on.reshape(())[()], inside, after)
        self.at.position_at_end(inside)
        found = self.run(body.jaxpr, body.consts, [*given[a : a + b], *[read() for _, read, _ in kept]])
        self.exchanged(kept, found)
        self.at.branch(head)
        self.at.position_at_end(after)
        return [read() for _, read, _ in kept]

    def branched(self, params: Any, given: list[Value]) -> list[Value]:
        """Write a choice between two branches, of which only the one that is taken is executed."""
        which, *operands = given
        branches = params["branches"]
        if len(branches) != 2 or not isinstance(which, np.ndarray):
            raise Untranslatable("a choice between more than two branches")
        out = [self.room(v.shape, kind_of(v.dtype)) for v in branches[0].out_avals]
        blocks = [self.function.append_basic_block(n) for n in ("first", "second")]
        after = self.function.append_basic_block("chosen")
        index: Any = which.reshape(())[()]
        second = self.at.icmp_signed("!=", index, ir.Constant(index.type, 0))
        self.at.cbranch(second, blocks[1], blocks[0])
        for block, branch in zip(blocks, branches, strict=True):
            self.at.position_at_end(block)
            found = self.run(branch.jaxpr, branch.consts, operands)
            for place, value in zip(out, found, strict=True):
                self.copied(value, place)
            self.at.branch(after)
        self.at.position_at_end(after)
        return [self.gathered(place) for place in out]

    # --- elements -----------------------------------------------------------------------------------------

    def call(self, name: str, *args: Any) -> Any:
        """A function of the C library's mathematics, or one of LLVM's own."""
        known = self.module.globals.get(name)
        if known is None:
            known = ir.Function(self.module, ir.FunctionType(DOUBLE, [DOUBLE] * len(args)), name)
            known.attributes.add("nounwind")
            known.attributes.add("readnone")
        return self.at.call(known, args)


def _is_value(array: Any) -> bool:
    return isinstance(array, Block) or array.dtype == object


def _rank(value: Value) -> int:
    return len(value.shape)


def _long(index: Any) -> Any:
    return LONG(index) if isinstance(index, int) else index


def _outs(inner: Any, carries: int, length: int) -> list[Any]:
    """The outputs that a scan stacks, with the shapes of the stacks."""

    @dataclasses.dataclass
    class Stacked:
        aval: Any

    return [
        Stacked(jax.ShapeDtypeStruct((length, *v.aval.shape), v.aval.dtype))
        for v in inner.jaxpr.outvars[carries:]
    ]


# --- operations element by element ------------------------------------------------------------------------


def _arithmetic(of_doubles: str, of_longs: str | None) -> Callable[..., Any]:
    def write(t: Translator, params: Any, kinds: list[ir.Type], a: Any, b: Any) -> Any:
        if a.type == DOUBLE:
            return getattr(t.at, of_doubles)(a, b, flags=("contract",))
        if of_longs is None or a.type != LONG:
            raise Untranslatable(f"{of_doubles} of {a.type}")
        return getattr(t.at, of_longs)(a, b)

    return write


def _comparison(sign: str) -> Callable[..., Any]:
    def write(t: Translator, params: Any, kinds: list[ir.Type], a: Any, b: Any) -> Any:
        if a.type == DOUBLE:
            compare = t.at.fcmp_unordered if sign == "!=" else t.at.fcmp_ordered
            return compare(sign, a, b)
        return t.at.icmp_signed(sign, a, b) if a.type == LONG else t.at.icmp_unsigned(sign, a, b)

    return write


def _function(name: str) -> Callable[..., Any]:
    return lambda t, params, kinds, *args: t.call(name, *args)


def _larger(sign: str) -> Callable[..., Any]:
    """max or min; NaN if either argument is NaN."""

    def write(t: Translator, params: Any, kinds: list[ir.Type], a: Any, b: Any) -> Any:
        if a.type != DOUBLE:
            return t.at.select(t.at.icmp_signed(sign, a, b), a, b)
        first = t.at.or_(t.at.fcmp_ordered(sign, a, b), t.at.fcmp_unordered("uno", a, a))
        return t.at.select(first, a, b)

    return write


def _sign(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    one = t.at.select(t.at.fcmp_ordered("<", a, DOUBLE(0.0)), DOUBLE(-1.0), a)
    return t.at.select(t.at.fcmp_ordered(">", a, DOUBLE(0.0)), DOUBLE(1.0), one)


def _power(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    exponent = abs(params["y"])
    out, square = None, a
    while exponent:
        if exponent & 1:
            out = square if out is None else t.at.fmul(out, square)
        exponent >>= 1
        square = t.at.fmul(square, square) if exponent else square
    out = DOUBLE(1.0) if out is None else out
    return t.at.fdiv(DOUBLE(1.0), out) if params["y"] < 0 else out


def _converted(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    to = kind_of(params["new_dtype"])
    if a.type == to:
        return a
    if to == DOUBLE:
        return t.at.uitofp(a, DOUBLE) if a.type == BOOL else t.at.sitofp(a, DOUBLE)
    if to == LONG:
        return t.at.zext(a, LONG) if a.type == BOOL else t.at.fptosi(a, LONG)
    zero = DOUBLE(0.0) if a.type == DOUBLE else LONG(0)
    return t.at.fcmp_unordered("!=", a, zero) if a.type == DOUBLE else t.at.icmp_signed("!=", a, zero)


def _selected(t: Translator, params: Any, kinds: list[ir.Type], which: Any, *cases: Any) -> Any:
    if len(cases) != 2 or which.type != BOOL:
        raise Untranslatable("select_n of more than two")
    return t.at.select(which, cases[1], cases[0])


def _negated(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    return t.at.fneg(a) if a.type == DOUBLE else t.at.neg(a)


def _finite(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    return t.at.fcmp_ordered("<", t.call("llvm.fabs.f64", a), DOUBLE(math.inf))


def _absolute(t: Translator, params: Any, kinds: list[ir.Type], a: Any) -> Any:
    if a.type == DOUBLE:
        return t.call("llvm.fabs.f64", a)
    return t.at.select(t.at.icmp_signed("<", a, LONG(0)), t.at.neg(a), a)


ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "add": _arithmetic("fadd", "add"),
    "add_any": _arithmetic("fadd", "add"),
    "sub": _arithmetic("fsub", "sub"),
    "mul": _arithmetic("fmul", "mul"),
    "div": _arithmetic("fdiv", None),
    "max": _larger(">"),
    "min": _larger("<"),
    "neg": _negated,
    "abs": _absolute,
    "sign": _sign,
    "square": lambda t, params, kinds, a: t.at.fmul(a, a, flags=("contract",)),
    "integer_pow": _power,
    "sqrt": _function("llvm.sqrt.f64"),
    "exp": _function("exp"),
    "expm1": _function("expm1"),
    "log": _function("log"),
    "log1p": _function("log1p"),
    "sin": _function("sin"),
    "cos": _function("cos"),
    "tanh": _function("tanh"),
    "atan2": _function("atan2"),
    "pow": _function("pow"),
    "eq": _comparison("=="),
    "ne": _comparison("!="),
    "lt": _comparison("<"),
    "le": _comparison("<="),
    "gt": _comparison(">"),
    "ge": _comparison(">="),
    "and": lambda t, params, kinds, a, b: t.at.and_(a, b),
    "or": lambda t, params, kinds, a, b: t.at.or_(a, b),
    "xor": lambda t, params, kinds, a, b: t.at.xor(a, b),
    "not": lambda t, params, kinds, a: t.at.not_(a),
    "is_finite": _finite,
    "select_n": _selected,
    "convert_element_type": _converted,
    "stop_gradient": lambda t, params, kinds, a: a,
    "copy": lambda t, params, kinds, a: a,
}


# --- operations on shapes ---------------------------------------------------------------------------------


def _reshaped(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    if isinstance(a, np.ndarray):
        return a.reshape(shape)
    return dataclasses.replace(a, shape=shape)


def _broadcast(t: Translator, params: Any, shape: tuple[int, ...], a: Value, *rest: Value) -> Value:
    axes = params["broadcast_dimensions"]
    if isinstance(a, np.ndarray) and a.size > 1 and _size(shape) > FEW:
        a = t.spilled(a)

    def element(index: list[Any]) -> Any:
        own = [LONG(0) if a.shape[k] == 1 else index[axis] for k, axis in enumerate(axes)]
        return t.element(a, own)

    return t.filled(shape, _kind(a), element)


def _kind(value: Value) -> ir.Type:
    if isinstance(value, Block):
        return value.kind
    return value.ravel()[0].type if value.size else DOUBLE


def _sliced(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    starts, strides = params["start_indices"], params["strides"] or (1,) * len(shape)
    if isinstance(a, np.ndarray):
        limits = params["limit_indices"]
        return a[tuple(slice(*three) for three in zip(starts, limits, strides, strict=True))]

    def element(index: list[Any]) -> Any:
        own = [
            t.at.add(t.at.mul(i, LONG(k)), LONG(s)) for i, s, k in zip(index, starts, strides, strict=True)
        ]
        return t.element(a, own)

    return t.filled(shape, a.kind, element)


def _transposed(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    order = params["permutation"]
    if isinstance(a, np.ndarray):
        return a.transpose(order)
    if sum(extent > 1 for extent in shape) <= 1:
        return dataclasses.replace(a, shape=shape)

    def element(index: list[Any]) -> Any:
        own: list[Any] = [None] * len(order)
        for axis, source in enumerate(order):
            own[source] = index[axis]
        return t.element(a, own)

    return t.filled(shape, a.kind, element)


def _joined(t: Translator, params: Any, shape: tuple[int, ...], *parts: Value) -> Value:
    axis = params["dimension"]
    if all(isinstance(part, np.ndarray) for part in parts) and _size(shape) <= FEW:
        return np.concatenate(parts, axis=axis)  # pyright: ignore[reportCallIssue, reportArgumentType]
    out = t.room(shape, next(_kind(part) for part in parts if _size(part.shape)))
    before = 0
    for part in parts:
        if not _size(part.shape):
            continue
        shift = before
        if isinstance(part, np.ndarray) and part.size > 1:
            part = t.spilled(part)

        _over(
            t,
            part.shape,
            lambda index, part=part, shift=shift: t.store(
                t.element(part, index),
                out,
                _linear(t, [*index[:axis], t.at.add(index[axis], LONG(shift)), *index[axis + 1 :]], shape),
            ),
        )
        before += part.shape[axis]
    return out


def _stacked(t: Translator, params: Any, shape: tuple[int, ...], *parts: Value) -> Value:
    axis = params.get("axis", params.get("dimension", 0))
    whole = [_reshaped(t, None, (*p.shape[:axis], 1, *p.shape[axis:]), p) for p in parts]
    return _joined(t, {"dimension": axis}, shape, *whole)


def _over(t: Translator, shape: Sequence[int], body: Callable[[list[Any]], None]) -> None:
    """body(indices) for all indices of a shape."""

    def nested(axis: int, index: list[Any]) -> None:
        if axis == len(shape):
            body(index)
        elif shape[axis] <= 4:
            for i in range(shape[axis]):
                nested(axis + 1, [*index, LONG(i)])
        else:
            t.loop(shape[axis], lambda i: nested(axis + 1, [*index, i]))

    nested(0, [])


def _linear(t: Translator, index: Sequence[Any], shape: Sequence[int]) -> Any:
    linear: Any = LONG(0)
    for i, extent in zip(index, shape, strict=True):
        linear = t.at.add(t.at.mul(linear, LONG(extent)), i)
    return linear


def _reduction(fold: Callable[..., Any], start: Callable[[ir.Type], Any]) -> Callable[..., Value]:
    def write(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
        axes = params["axes"]
        kind = _kind(a)
        if isinstance(a, np.ndarray) and _size(shape) <= FEW:
            moved = np.moveaxis(a, axes, range(len(axes)))
            rows = moved.reshape(-1, *shape)
            out = np.empty(shape, dtype=object)
            for index in np.ndindex(*shape):
                values = [rows[(k, *index)] for k in range(len(rows))]
                total = values[0] if values else start(kind)
                for value in values[1:]:
                    total = fold(t, None, [], total, value)
                out[index] = total
            return out
        kept = [axis for axis in range(len(a.shape)) if axis not in axes]

        def element(index: list[Any]) -> Any:
            total = t.slot(kind)
            t.at.store(start(kind), total)

            def one(inner: list[Any]) -> None:
                own: list[Any] = [None] * len(a.shape)
                for axis, i in zip(kept, index, strict=True):
                    own[axis] = i
                for axis, i in zip(axes, inner, strict=True):
                    own[axis] = i
                t.at.store(fold(t, None, [], t.at.load(total, typ=kind), t.element(a, own)), total)

            _over(t, [a.shape[axis] for axis in axes], one)
            return t.at.load(total, typ=kind)

        return t.filled(shape, kind, element)

    return write


def _cumulative(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    axis, reverse = params["axis"], params["reverse"]
    whole = t.spilled(a) if isinstance(a, np.ndarray) else a
    out = t.room(shape, whole.kind)
    others = [extent for k, extent in enumerate(shape) if k != axis]

    def along(rest: list[Any]) -> None:
        total = t.slot(whole.kind)
        t.at.store(DOUBLE(0.0), total)

        def step(i: Any) -> None:
            k = t.at.sub(LONG(shape[axis] - 1), i) if reverse else i
            linear = _linear(t, [*rest[:axis], k, *rest[axis:]], shape)
            t.at.store(t.at.fadd(t.at.load(total, typ=DOUBLE), t.load(whole, linear)), total)
            t.store(t.at.load(total, typ=DOUBLE), out, linear)

        t.loop(shape[axis], step)

    _over(t, others, along)
    return t.gathered(out)


def _largest_at(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    (axis,) = params["axes"]
    if not isinstance(a, np.ndarray) or a.ndim != 1 or axis != 0:
        raise Untranslatable("argmax of a large array")
    best, where = a[0], LONG(0)
    for i in range(1, len(a)):
        over = t.at.fcmp_ordered(">", a[i], best)
        best, where = t.at.select(over, a[i], best), t.at.select(over, LONG(i), where)
    out = np.empty((), dtype=object)
    out[()] = where
    return out


def _counted(t: Translator, params: Any, shape: tuple[int, ...]) -> Value:
    kind, axis = kind_of(params["dtype"]), params["dimension"]

    def element(index: list[Any]) -> Any:
        if kind == LONG:
            return index[axis]
        if isinstance(index[axis], ir.Constant):
            return DOUBLE(float(index[axis].constant))
        return t.at.sitofp(index[axis], DOUBLE)

    return t.filled(shape, kind, element)


def _reversed(t: Translator, params: Any, shape: tuple[int, ...], a: Value) -> Value:
    axes = params["dimensions"]
    if isinstance(a, np.ndarray):
        return np.flip(a, axes)

    def element(index: list[Any]) -> Any:
        return t.element(
            a, [t.at.sub(LONG(shape[k] - 1), i) if k in axes else i for k, i in enumerate(index)]
        )

    return t.filled(shape, a.kind, element)


def _padded(t: Translator, params: Any, shape: tuple[int, ...], a: Value, filler: Value) -> Value:
    edges = params["padding_config"]
    if any(low < 0 or high < 0 or between for low, high, between in edges):
        raise Untranslatable("pad that cuts or spreads")
    if all(low == high == 0 for low, high, _ in edges):
        return a
    parts = a
    for axis, (low, high, _) in enumerate(edges):
        sides = [(*parts.shape[:axis], n, *parts.shape[axis + 1 :]) for n in (low, high)]
        before, after = (t.filled(side, _kind(a), lambda index: t.element(filler, [])) for side in sides)
        whole = (*parts.shape[:axis], low + parts.shape[axis] + high, *parts.shape[axis + 1 :])
        parts = _joined(t, {"dimension": axis}, whole, before, parts, after)
    return parts


def _rows(t: Translator, params: Any, shape: tuple[int, ...], a: Value, places: Value) -> Value:
    """Rows of an array along one axis, at places of any shape; where it is a batch, of each its own."""
    where = params["dimension_numbers"]
    along, batch = where.start_index_map, where.operand_batching_dims
    sizes = tuple(1 if d in (*along, *batch) else n for d, n in enumerate(a.shape))
    plain = len(along) == 1 and where.collapsed_slice_dims == along
    if not plain or tuple(params["slice_sizes"]) != sizes:
        raise Untranslatable("gather of other than rows")
    fills = params["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP and _kind(a) == DOUBLE
    length = a.shape[along[0]]

    def element(index: list[Any]) -> Any:
        within = iter([index[k] for k in where.offset_dims])
        at = [i for k, i in enumerate(index) if k not in where.offset_dims]
        row = t.element(places, [*at, LONG(0)])
        low, high = t.at.icmp_signed("<", row, LONG(0)), t.at.icmp_signed(">=", row, LONG(length))
        inside = t.at.select(high, LONG(length - 1), t.at.select(low, LONG(0), row))
        own = dict(zip(batch, (at[k] for k in where.start_indices_batching_dims), strict=True))
        own[along[0]] = inside
        value = t.element(a, [own[d] if d in own else next(within) for d in range(len(a.shape))])
        return t.at.select(t.at.or_(low, high), DOUBLE(math.nan), value) if fills else value

    return t.filled(shape, _kind(a), element)


def _replaced(
    t: Translator, params: Any, shape: tuple[int, ...], a: Value, places: Value, rows: Value
) -> Value:
    """An array with one of its rows along the first axis replaced."""
    where = params["dimension_numbers"]
    plain = where.inserted_window_dims == where.scatter_dims_to_operand_dims == (0,)
    if not plain or where.operand_batching_dims or places.shape != (1,) or rows.shape != shape[1:]:
        raise Untranslatable("scatter of other than one row")
    row = t.element(places, [LONG(0)])

    def element(index: list[Any]) -> Any:
        here = t.at.icmp_signed("==", index[0], row)
        return t.at.select(here, t.element(rows, index[1:]), t.element(a, index))

    return t.filled(shape, _kind(a), element)


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
