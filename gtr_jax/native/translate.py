"""From a traced JAX program to LLVM's intermediate representation.

Only primitives that the mechanics uses are supported: any other raises `Untranslatable`, and the caller uses
JAX instead. Where several lanes run at once, a loop turns until the last lane is done, and a branch is
executed if any lane takes it; lanes that are done, or do not take it, keep what they have.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax.extend
import numpy as np
from llvmlite import ir

from .elementwise import ELEMENTWISE
from .shapes import SHAPES
from .values import (
    BOOL,
    FEW,
    LONG,
    Block,
    Computed,
    Later,
    Untranslatable,
    Value,
    Writer,
    kind_in,
    kind_of,
    long,
    plain,
    size_of,
    varies,
)
from .varying import CALLS, carried_by_scan, carried_by_while, program_in

# Operations that are computed where the last of them is used, one inside another.
DEEPEST = 40


class Translator(Writer):
    """Writes the programs of one function; see `Writer`."""

    # The lanes that are to be computed, a Boolean for each; None for all.
    on: Any = None

    @contextlib.contextmanager
    def only(self, lanes: Any) -> Iterator[None]:
        """What is written inside needs to be right in some lanes only."""
        before = self.on
        self.on = lanes
        try:
            yield
        finally:
            self.on = before

    def among(self, flag: Any) -> Any:
        """A Boolean that is false in the lanes that are not to be computed."""
        # Not `and`: what a lane that is not computed has may be undefined.
        return flag if self.on is None else self.select(self.on, flag, BOOL(0))

    def run(self, jaxpr: Any, known: Sequence[Any], given: Sequence[Value]) -> list[Computed]:
        """Write a traced program.

        Args:
            jaxpr: the program.
            known: its constants.
            given: its arguments.

        Returns:
            What it returns.
        """
        return [self.computed(value) for value in self._run(jaxpr, known, given)]

    def _run(self, jaxpr: Any, known: Sequence[Any], given: Sequence[Value]) -> list[Value]:
        """As `run`; what is returned may be left to be computed later."""
        once = _used_once(jaxpr)
        values: dict[Any, Value] = {}

        def keep(variables: Sequence[Any], found: Sequence[Value]) -> None:
            for variable, value in zip(variables, found, strict=True):
                values[variable] = value if variable in once else self.computed(value)

        for variable, array in zip(jaxpr.constvars, known, strict=True):
            values[variable] = (
                array
                if isinstance(array, np.ndarray | Block) and _is_value(array)
                else (self.constant(array))
            )
        keep(jaxpr.invars, given)

        def read(atom: Any) -> Value:
            return self.constant(atom.val) if isinstance(atom, jax.extend.core.Literal) else values[atom]

        for eqn in jaxpr.eqns:
            keep(eqn.outvars, self.written(eqn, [read(v) for v in eqn.invars]))
        return [read(v) for v in jaxpr.outvars]

    def written(self, eqn: Any, given: list[Value]) -> list[Value]:
        """Write one operation, or what it leaves to be computed later."""
        name, params = eqn.primitive.name, eqn.params
        shapes = [v.aval.shape for v in eqn.outvars]
        if name in CALLS:
            inner = program_in(params)
            return self._run(inner.jaxpr, inner.consts, given)
        if name in ELEMENTWISE:
            write = ELEMENTWISE[name]

            def one(index: Sequence[Any]) -> Any:
                each = [self.element(v, index if len(v.shape) else []) for v in given]
                return write(self, params, *self.alike(*each))

            kind = self.wide_of(kind_of(eqn.outvars[0].aval.dtype), *given)
            depth = 1 + max((v.depth for v in given if isinstance(v, Later)), default=0)
            if size_of(shapes[0]) > FEW and depth < DEEPEST:
                return [Later(shapes[0], kind, one, depth)]
            return [self.filled(shapes[0], kind, one)]
        if name in ONCE:
            return [SHAPES[name](self, params, shapes[0], *given)]
        known = [self.computed(value) for value in given]
        if name == "scan":
            return [*self.scan(params, known)]
        if name == "while":
            return [*self.while_loop(params, known)]
        if name == "cond":
            return [*self.branched(params, known)]
        if name in SHAPES:
            return [SHAPES[name](self, params, shapes[0], *known)]
        raise Untranslatable(name)

    # --- loops and branches -------------------------------------------------------------------------------

    def kept(self, value: Computed, wide: bool) -> tuple[Any, Callable[[], Computed], Callable[..., None]]:
        """Storage of a value that a loop carries, which differs between lanes or not, and how to read and
        write it; written where a Boolean is true, if one is given.
        """
        kind = self.wide(kind_in(value)) if wide else kind_in(value)
        if isinstance(value, np.ndarray):
            slots = np.empty(value.shape, dtype=object)
            for index in np.ndindex(*value.shape):
                slots[index] = self.slot(kind)
                self.at.store(self.spread(value[index], kind), slots[index])

            def read() -> Computed:
                out = np.empty(slots.shape, dtype=object)
                for index in np.ndindex(*slots.shape):
                    out[index] = self.at.load(slots[index], typ=kind)
                return out

            def write(new: Computed, where: Any = None) -> None:
                assert isinstance(new, np.ndarray)
                for index in np.ndindex(*slots.shape):
                    one, slot = self.spread(new[index], kind), slots[index]
                    one = one if where is None else self.select(where, one, self.at.load(slot, typ=kind))
                    self.at.store(one, slot)

            return slots, read, write
        block = self.room(value.shape, kind)
        self.copied(value, block)
        return block, lambda: block, lambda new, where=None: self.copied(new, block, where)

    def all_kept(self, values: Sequence[Computed], wide: Callable[[], list[bool]]) -> list[Any]:
        """Storage of all values that a loop carries; `wide` says which differ between lanes."""
        apart = wide() if self.lanes > 1 else [False] * len(values)
        return [self.kept(value, differs) for value, differs in zip(values, apart, strict=True)]

    def exchanged(self, kept: Sequence[Any], new: Sequence[Computed], where: Any = None) -> None:
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
                write(value, where)

    def scan(self, params: Any, given: list[Computed]) -> list[Computed]:
        """Write a scan."""
        consts, carries = params["num_consts"], params["num_carry"]
        inner, length = params["jaxpr"], params["length"]
        fixed, first, rows = given[:consts], given[consts : consts + carries], given[consts + carries :]
        if params["reverse"]:
            raise Untranslatable("a scan in reverse")
        kept = self.all_kept(first, lambda: carried_by_scan(params, [varies(value) for value in given]))
        rows = [self.spilled(v) if isinstance(v, np.ndarray) and v.size else v for v in rows]
        out = [
            self.room((length, *v.aval.shape), self.wide(kind_of(v.aval.dtype)))
            for v in inner.jaxpr.outvars[carries:]
        ]

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
        start = self.at.mul(long(i), LONG(size_of(block.shape[1:])))
        place = self.at.gep(block.start, [start], source_etype=self.held(block.kind))
        return Block(place, block.shape[1:], block.kind)

    def row(self, value: Computed, i: Any) -> Computed:
        """Entry i of an array along its first axis, loaded from memory where it is small."""
        if isinstance(value, np.ndarray):  # of no elements
            return np.empty(value.shape[1:], dtype=object)
        return self.gathered(self.row_of(value, i))

    def while_loop(self, params: Any, given: list[Computed]) -> list[Computed]:
        """Write a while loop."""
        a, b = params["cond_nconsts"], params["body_nconsts"]
        kept = self.all_kept(given[a + b :], lambda: carried_by_while(params, [varies(v) for v in given]))
        head, inside, after = (self.function.append_basic_block(n) for n in ("again", "turn", "done"))
        self.at.branch(head)
        self.at.position_at_end(head)
        cond, body = params["cond_jaxpr"], params["body_jaxpr"]
        (goes,) = self.run(cond.jaxpr, cond.consts, [*given[:a], *[read() for _, read, _ in kept]])
        assert isinstance(goes, np.ndarray)
        on: Any = goes.reshape(())[()]
        apart = isinstance(on.type, ir.VectorType)
        lanes = self.among(on) if apart else self.on
        self.at.cbranch(self.any_lane(lanes) if apart else on, inside, after)
        self.at.position_at_end(inside)
        with self.only(lanes):
            found = self.run(body.jaxpr, body.consts, [*given[a : a + b], *[read() for _, read, _ in kept]])
        self.exchanged(kept, found, lanes if apart else None)
        self.at.branch(head)
        self.at.position_at_end(after)
        return [read() for _, read, _ in kept]

    def branched(self, params: Any, given: list[Computed]) -> list[Computed]:
        """Write a choice between two branches, of which only those that are taken are executed."""
        which, *operands = given
        branches = params["branches"]
        if len(branches) != 2 or not isinstance(which, np.ndarray):
            raise Untranslatable("a choice between more than two branches")
        out = [self.room(v.shape, self.wide(kind_of(v.dtype))) for v in branches[0].out_avals]
        index: Any = which.reshape(())[()]
        second = self.at.icmp_signed("!=", index, self.spread(ir.Constant(plain(index.type), 0), index.type))
        if not varies(which):
            return self._one_of(branches, operands, second, out)
        takes = [self.at.not_(second), second]
        # What the first leaves in the lanes that take the other is overwritten. One without equations is
        # written first, for all lanes.
        order = sorted((0, 1), key=lambda k: len(branches[k].jaxpr.eqns) > 0)
        for place, number in enumerate(order):
            branch, taken = branches[number], self.among(takes[number])

            def write(branch: Any = branch, where: Any = taken if place else None) -> None:
                found = self.run(branch.jaxpr, branch.consts, operands)
                for room, value in zip(out, found, strict=True):
                    self.copied(value, room, where)

            if not branch.jaxpr.eqns and not place:
                write()
                continue
            inside, after = (self.function.append_basic_block(n) for n in ("branch", "after"))
            self.at.cbranch(self.any_lane(taken), inside, after)
            self.at.position_at_end(inside)
            with self.only(taken):
                write()
            self.at.branch(after)
            self.at.position_at_end(after)
        return [self.gathered(place) for place in out]

    def _one_of(
        self, branches: Any, operands: list[Computed], second: Any, out: list[Block]
    ) -> list[Computed]:
        """Write a choice that is the same in all lanes."""
        blocks = [self.function.append_basic_block(n) for n in ("first", "second")]
        after = self.function.append_basic_block("chosen")
        self.at.cbranch(second, blocks[1], blocks[0])
        for block, branch in zip(blocks, branches, strict=True):
            self.at.position_at_end(block)
            found = self.run(branch.jaxpr, branch.consts, operands)
            for place, value in zip(out, found, strict=True):
                self.copied(value, place)
            self.at.branch(after)
        self.at.position_at_end(after)
        return [self.gathered(place) for place in out]


# Operations on shapes that read each element of what they are given at most once.
ONCE = ("slice", "reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "transpose", "rev")


def _used_once(jaxpr: Any) -> set[Any]:
    """Variables of a program that are used once, by what reads each of their elements at most once: these
    may be computed there.
    """
    uses: dict[Any, int] = {}
    for eqn in jaxpr.eqns:
        once = eqn.primitive.name in (*ELEMENTWISE, *ONCE, *CALLS)
        for atom in eqn.invars:
            if not isinstance(atom, jax.extend.core.Literal):
                uses[atom] = uses.get(atom, 0) + (1 if once else 2)
    for atom in jaxpr.outvars:
        if not isinstance(atom, jax.extend.core.Literal):
            uses[atom] = uses.get(atom, 0) + 1
    return {atom for atom, count in uses.items() if count == 1}


def _is_value(array: Any) -> bool:
    return isinstance(array, Block) or array.dtype == object
