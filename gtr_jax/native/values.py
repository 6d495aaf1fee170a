"""Values of LLVM's intermediate representation: numbers, arrays, and lanes of them side by side.

Arrays of a few elements are one LLVM value per element, so that the equations of a node turn into
straight-line code; larger ones lie in a workspace and are processed in loops. Where a program runs several
lanes at once, an element that differs between them is an LLVM vector, and one that does not is a number.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

# Arrays of up to so many elements become one LLVM value per element.
FEW = 24
DOUBLE, LONG, BOOL = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
BYTES = 8  # of every number in the workspace

Values = np.ndarray  # of one LLVM value per element, all of one type, dtype object


class Untranslatable(NotImplementedError):
    """A primitive, or a use of one, that is not supported here."""


@dataclasses.dataclass(frozen=True)
class Block:
    """A larger array in memory: where it begins, its shape and the type of its elements; row-major."""

    start: Any
    shape: tuple[int, ...]
    kind: ir.Type


@dataclasses.dataclass(frozen=True)
class Later:
    """A larger array whose elements are computed where the one operation that uses it needs them.

    Attributes:
        shape: of it.
        kind: type of its elements.
        element: writes the element at indices, one per axis.
        depth: how many operations it takes one inside another.
    """

    shape: tuple[int, ...]
    kind: ir.Type
    element: Callable[[Sequence[Any]], Any]
    depth: int


Computed = Values | Block
Value = Computed | Later


def kind_of(dtype: Any) -> ir.Type:
    """LLVM's type of a number."""
    dtype = np.dtype(dtype)
    if dtype.kind == "b":
        return BOOL
    if np.issubdtype(dtype, np.floating):
        return DOUBLE
    if np.issubdtype(dtype, np.integer):
        return LONG
    raise Untranslatable(f"elements of type {dtype}")


def size_of(shape: Sequence[int]) -> int:
    """Number of elements."""
    return int(np.prod(shape, dtype=int))


def plain(kind: ir.Type) -> ir.Type:
    """The type of the number in each lane."""
    return kind.element if isinstance(kind, ir.VectorType) else kind


def kind_in(value: Value) -> ir.Type:
    """The type of the elements of an array."""
    if not isinstance(value, np.ndarray):
        return value.kind
    return value.ravel()[0].type if value.size else DOUBLE


def varies(value: Value) -> bool:
    """Whether the elements differ between lanes."""
    return isinstance(kind_in(value), ir.VectorType)


class Writer:
    """Writes the instructions of one function that deal with numbers and memory.

    Args:
        module: what the function belongs to.
        function: the function being written.
        workspace: its argument that says where its workspace begins; None of a function without.
        lanes: how many lanes it runs at once.

    Attributes:
        at: where the next instruction goes.
        taken: bytes of the workspace.
    """

    def __init__(self, module: ir.Module, function: ir.Function, workspace: ir.Value | None, lanes: int = 1):
        self.module, self.function, self.workspace, self.lanes = module, function, workspace, lanes
        self.entry = function.append_basic_block("entry")
        self.at = ir.IRBuilder(self.entry)
        self.taken = 0

    # --- lanes --------------------------------------------------------------------------------------------

    def wide(self, kind: ir.Type) -> ir.Type:
        """The type of an element that differs between lanes."""
        return kind if self.lanes == 1 or isinstance(kind, ir.VectorType) else ir.VectorType(kind, self.lanes)

    def wide_of(self, kind: ir.Type, *values: Value) -> ir.Type:
        """The type of elements that come from those of arrays."""
        return self.wide(kind) if any(map(varies, values)) else kind

    def spread(self, value: Any, kind: ir.Type) -> Any:
        """An element as a value of a type: in all lanes, where this has several and the element is one."""
        if value.type == kind or not isinstance(kind, ir.VectorType):
            return value
        if isinstance(value, ir.Constant):
            return ir.Constant(kind, [value] * self.lanes)
        none = ir.Constant(kind, ir.Undefined)
        first = self.at.insert_element(none, value, ir.Constant(ir.IntType(32), 0))
        every = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [0] * self.lanes)
        return self.at.shuffle_vector(first, none, every)

    def alike(self, *values: Any) -> list[Any]:
        """Elements with lanes, if any of them has."""
        if not any(isinstance(value.type, ir.VectorType) for value in values):
            return list(values)
        return [self.spread(value, self.wide(value.type)) for value in values]

    def lane(self, value: Any, k: int) -> Any:
        """What a lane has of an element."""
        if not isinstance(value.type, ir.VectorType):
            return value
        if isinstance(value, ir.Constant):
            return value.constant[k]
        return self.at.extract_element(value, ir.Constant(ir.IntType(32), k))

    def of_lanes(self, kind: ir.Type, each: Callable[[int], Any]) -> Any:
        """An element from a function that gives what each lane has of it."""
        out: Any = ir.Constant(kind, ir.Undefined)
        for k in range(self.lanes):
            out = self.at.insert_element(out, each(k), ir.Constant(ir.IntType(32), k))
        return out

    def any_lane(self, flag: Any) -> Any:
        """Whether a Boolean is true in any lane."""
        if not isinstance(flag.type, ir.VectorType):
            return flag
        bits = ir.IntType(self.lanes)
        return self.at.icmp_unsigned("!=", self.at.bitcast(flag, bits), ir.Constant(bits, 0))

    def add(self, a: Any, b: Any) -> Any:
        """Sum of integers."""
        return self.at.add(*self.alike(a, b))

    def scaled(self, a: Any, by: int) -> Any:
        """A multiple of an integer."""
        return self.at.mul(*self.alike(a, LONG(by)))

    def select(self, which: Any, yes: Any, no: Any) -> Any:
        """One of two elements."""
        yes, no = self.alike(yes, no)
        if isinstance(which.type, ir.VectorType):
            yes, no = (self.spread(value, self.wide(value.type)) for value in (yes, no))
        return self.at.select(which, yes, no)

    # --- memory -------------------------------------------------------------------------------------------

    def room(self, shape: tuple[int, ...], kind: ir.Type) -> Block:
        """A new array in the workspace."""
        start = self.at.gep(self.workspace, [LONG(self.taken)], source_etype=ir.IntType(8))
        lanes = self.lanes if isinstance(kind, ir.VectorType) else 1
        self.taken += BYTES * lanes * max(size_of(shape), 1)
        return Block(start, shape, kind)

    def slot(self, kind: ir.Type) -> ir.Value:
        """Room for one value on the stack, which LLVM turns into registers."""
        with self.at.goto_entry_block():
            return self.at.alloca(kind)

    def held(self, kind: ir.Type) -> ir.Type:
        """The type by which memory holds elements of a type: Booleans as integers."""
        if plain(kind) != BOOL:
            return kind
        return self.wide(LONG) if isinstance(kind, ir.VectorType) else LONG

    def load(self, block: Block, index: Any) -> Any:
        """Element of a block at a linear index, which may differ between lanes."""
        index = long(index)
        if isinstance(index.type, ir.VectorType):
            inside = isinstance(block.kind, ir.VectorType)
            numbers = Block(block.start, (), plain(block.kind))

            def one(k: int) -> Any:
                at = self.lane(index, k)
                return self.load(numbers, self.add(self.scaled(at, self.lanes), LONG(k)) if inside else at)

            return self.of_lanes(self.wide(block.kind), one)
        held = self.held(block.kind)
        value = self.at.load(self.at.gep(block.start, [index], source_etype=held), align=BYTES, typ=held)
        return self.at.trunc(value, block.kind) if plain(block.kind) == BOOL else value

    def store(self, value: Any, block: Block, index: Any) -> None:
        """Write an element."""
        held = self.held(block.kind)
        value = self.spread(value, block.kind)
        value = self.at.zext(value, held) if plain(block.kind) == BOOL else value
        index = long(index)
        if isinstance(index.type, ir.VectorType):
            raise Untranslatable("an element written at a place that differs between lanes")
        self.at.store(value, self.at.gep(block.start, [index], source_etype=held), align=BYTES)

    def loop(self, count: Any, body: Callable[[Any], None]) -> None:
        """body(i) for i from 0 to count - 1."""
        i = self.slot(LONG)
        self.at.store(LONG(0), i)
        head, inside, after = (self.function.append_basic_block(n) for n in ("head", "body", "after"))
        self.at.branch(head)
        self.at.position_at_end(head)
        now = self.at.load(i, typ=LONG)
        self.at.cbranch(self.at.icmp_signed("<", now, long(count)), inside, after)
        self.at.position_at_end(inside)
        body(now)
        self.at.store(self.at.add(now, LONG(1)), i)
        self.at.branch(head)
        self.at.position_at_end(after)

    def filled(self, shape: tuple[int, ...], kind: ir.Type, element: Callable[[list[Any]], Any]) -> Computed:
        """An array from a function that gives the element at indices, one per axis."""
        if size_of(shape) <= FEW:
            out = np.empty(shape, dtype=object)
            for index in np.ndindex(*shape):
                out[index] = self.spread(element([LONG(i) for i in index]), kind)
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
            if all(isinstance(i, ir.Constant) and i.type == LONG for i in index):
                return value[tuple(i.constant for i in index)]
            value = self.spilled(value)
        if isinstance(value, Later):
            return value.element(index)
        return self.load(value, self.linear(index, value.shape))

    def linear(self, index: Sequence[Any], shape: Sequence[int]) -> Any:
        """The linear index of indices, one per axis."""
        linear: Any = LONG(0)
        for i, extent in zip(index, shape, strict=True):
            linear = self.add(self.scaled(linear, extent), i)
        return linear

    def computed(self, value: Value) -> Computed:
        """An array with its elements computed."""
        return self.filled(value.shape, value.kind, value.element) if isinstance(value, Later) else value

    def spilled(self, values: Values) -> Block:
        """A small array, stored in the workspace."""
        flat = values.ravel()
        block = self.room(values.shape, flat[0].type)
        for i, value in enumerate(flat):
            self.store(value, block, i)
        return block

    def gathered(self, block: Block) -> Computed:
        """A small array, loaded from memory; a larger one stays there."""
        if size_of(block.shape) > FEW:
            return block
        out = np.empty(block.shape, dtype=object)
        for i, index in enumerate(np.ndindex(*block.shape)):
            out[index] = self.load(block, i)
        return out

    def constant(self, array: Any) -> Computed:
        """A constant array, which is the same in all lanes."""
        array = np.asarray(array)
        kind = kind_of(array.dtype)
        numbers = array.astype({DOUBLE: float, LONG: int, BOOL: int}[kind])
        if array.size <= FEW:
            out = np.empty(array.shape, dtype=object)
            for index in np.ndindex(*array.shape):
                out[index] = ir.Constant(kind, numbers[index].item())
            return out
        stored = self.held(kind)
        whole = ir.ArrayType(stored, array.size)
        known = ir.GlobalVariable(self.module, whole, self.module.get_unique_name("known"))
        known.linkage, known.global_constant = "internal", True
        known.initializer = ir.Constant(  # pyright: ignore[reportAttributeAccessIssue]
            whole, [ir.Constant(stored, v.item()) for v in numbers.ravel()]
        )
        return Block(self.at.bitcast(known, ir.PointerType()), array.shape, kind)

    def copied(self, value: Computed, into: Block, where: Any = None) -> None:
        """Write an array over a block; where a Boolean is given, only in the lanes in which it is true."""

        def one(new: Any, i: Any) -> None:
            self.store(new if where is None else self.select(where, new, self.load(into, i)), into, i)

        if isinstance(value, np.ndarray):
            for i, new in enumerate(value.ravel()):
                one(new, i)
            return
        self.loop(size_of(into.shape), lambda i: one(self.load(value, i), i))

    # --- functions ----------------------------------------------------------------------------------------

    def call(self, name: str, *args: Any) -> Any:
        """A function of LLVM's own (`llvm.NAME`)."""
        kind = args[0].type
        name += f".v{self.lanes}f64" if isinstance(kind, ir.VectorType) else ".f64"
        return self.at.call(self._declared(name, kind, len(args)), args)

    def of_library(self, name: str, *args: Any) -> Any:
        """A function of the C library's mathematics, in each lane."""
        known, kind = self._declared(name, DOUBLE, len(args)), args[0].type
        if not isinstance(kind, ir.VectorType):
            return self.at.call(known, args)
        return self.of_lanes(kind, lambda k: self.at.call(known, [self.lane(a, k) for a in args]))

    def _declared(self, name: str, kind: ir.Type, count: int) -> ir.Function:
        known = self.module.globals.get(name)
        if known is None:
            known = ir.Function(self.module, ir.FunctionType(kind, [kind] * count), name)
            known.attributes.add("nounwind")
            known.attributes.add("readnone")
        return known


def long(index: Any) -> Any:
    """An index as a value of LLVM."""
    return LONG(index) if isinstance(index, int) else index
