"""A loop over steps as native code: translated once, kept if there is a place to keep it, run on arrays."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import llvmlite.binding as llvm
import numpy as np
from jaxtyping import Array, Float
from llvmlite import ir

from .translate import Translator
from .values import BOOL, DOUBLE, LONG, Block, Value, kind_of, plain, size_of

NAME = "steps"  # of the compiled function
# The program of all physics terms compiles in 1.8 s and does 400 load steps in 35 ms; with LLVM's level 2 in
# 13 s and 32 ms, with its level 2 without vectorisation and unrolling in 3.8 s and 34 ms.
PASSES = ("sroa", "instruction_combine", "simplify_cfg", "new_gvn", "dead_store_elimination")
BYTE = ir.IntType(8)
_lock = threading.Lock()


class Place(Protocol):
    """Where compiled programs are kept. What it gives is run: it must be what this user has put there."""

    def read(self, name: str) -> bytes | None:
        """A program by its name; None if there is none."""
        ...

    def write(self, name: str, contents: bytes) -> None:
        """Keep a program, or leave it."""
        ...


class Program:
    """Runs K steps as native code.

    Args:
        begin: function from the fixed values to the carry; traced by JAX.
        step: function from the fixed values, the carry and the row of a step to the new carry and the outputs
            of the step.
        fixed: the shapes of the fixed values, as a pytree of `jax.ShapeDtypeStruct`.
        row: the shapes of the row of a step.
        key: tells this program from every other; the same key means the same code.
        kept: where it is kept; None: nowhere.
        lanes: how many runs go side by side, in the lanes of the processor's vectors.
    """

    def __init__(
        self,
        begin: Callable[[Any], Any],
        step: Callable[[Any, Any, Any], tuple[Any, Any]],
        fixed: Any,
        row: Any,
        key: Sequence[Any],
        *,
        kept: Place | None = None,
        lanes: int = 1,
    ):
        self._begin, self._step, self._fixed, self._row = begin, step, fixed, row
        self._lanes = lanes
        self._key = hashlib.blake2b(repr((*key, lanes)).encode(), digest_size=16).hexdigest()
        self._kept = kept
        self._lock = threading.Lock()

    @functools.cached_property
    def _ready(self) -> tuple[Any, int, int, Any]:
        """The function, bytes of its workspace, number of outputs per step, and the engine that holds it."""
        with self._lock:
            held = None if self._kept is None else self._kept.read(self._key)
            if held is None:
                held = self._compiled()
                if self._kept is not None:
                    self._kept.write(self._key, held)
        size, width, code = (
            int.from_bytes(held[:8], "little"),
            int.from_bytes(held[8:16], "little"),
            held[16:],
        )
        with _lock:
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            engine.finalize_object()
            address = engine.get_function_address(NAME)
        function = ctypes.CFUNCTYPE(None, ctypes.c_int64, *[ctypes.c_void_p] * 4)(address)
        return function, size, width, engine

    def __call__(self, fixed: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Run the steps; other Python threads run meanwhile.

        Args:
            fixed: the fixed values, `packed`, (n,); of several lanes (n, lanes).
            rows: the leaves of each step one after the other, (K, numbers), float64; likewise with the lanes
                last.

        Returns:
            Outputs of each step, (K, numbers), float64, likewise; Booleans as 0 and 1.
        """
        function, size, width, _ = self._ready
        given = np.ascontiguousarray(fixed, dtype=float)
        rows = np.ascontiguousarray(rows, dtype=float)
        out = np.empty((len(rows), width) if self._lanes == 1 else (len(rows), width, self._lanes))
        workspace = np.zeros(size, dtype=np.uint8)
        function(len(rows), given.ctypes.data, rows.ctypes.data, out.ctypes.data, workspace.ctypes.data)
        return out

    def _compiled(self) -> bytes:
        """Workspace and width in 8 bytes each, then the object code."""
        carried = jax.eval_shape(self._begin, self._fixed)
        begin = jax.make_jaxpr(self._begin)(self._fixed)
        step = jax.make_jaxpr(self._step)(self._fixed, carried, self._row)
        left = jax.eval_shape(self._step, self._fixed, carried, self._row)[1]
        module = ir.Module(NAME)
        pointer = ir.PointerType()
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), [LONG, *[pointer] * 4]), NAME)
        count, given, rows, out, workspace = function.args
        for argument in function.args[1:]:
            argument.add_attribute("noalias")
        t = Translator(module, function, workspace, self._lanes)
        numbers = t.wide(DOUBLE)
        leaves, own = jtu.tree_leaves(self._fixed), []
        place = 0
        for leaf in leaves:
            start = t.at.gep(given, [LONG(place)], source_etype=numbers)
            own.append(t.gathered(Block(start, leaf.shape, t.wide(kind_of(leaf.dtype)))))
            place += size_of(leaf.shape)
        kept = [t.kept(value, wide=True) for value in t.run(begin.jaxpr, begin.consts, own)]
        inputs = jtu.tree_leaves(self._row)
        wide = sum(size_of(leaf.shape) for leaf in inputs)
        outputs = jtu.tree_leaves(left)
        width = sum(size_of(leaf.shape) for leaf in outputs)

        def body(i: Any) -> None:
            here, row, place = t.row_of(Block(rows, (1, wide), numbers), i), [], 0
            for leaf in inputs:
                start = t.at.gep(here.start, [LONG(place)], source_etype=numbers)
                row.append(_of_doubles(t, start, leaf))
                place += size_of(leaf.shape)
            found = t.run(step.jaxpr, step.consts, [*own, *[read() for _, read, _ in kept], *row])
            there, place = t.row_of(Block(out, (1, width), numbers), i), 0
            for value in found[len(kept) :]:
                for k in range(size_of(value.shape)):
                    one: Any = t.load(value, k) if isinstance(value, Block) else value.ravel()[k]
                    one = t.spread(one, t.wide(one.type))
                    one = t.at.uitofp(one, numbers) if plain(one.type) == BOOL else one
                    one = t.at.sitofp(one, numbers) if plain(one.type) == LONG else one
                    t.store(one, there, place)
                    place += 1
            t.exchanged(kept, found[: len(kept)])

        t.loop(count, body)
        t.at.ret_void()
        code = _object_code(str(module))
        return t.taken.to_bytes(8, "little") + width.to_bytes(8, "little") + code


def _of_doubles(t: Translator, start: Any, leaf: Any) -> Value:
    """A leaf of a row, whose numbers are all doubles."""
    whole = Block(start, leaf.shape, t.wide(DOUBLE))
    kind = kind_of(leaf.dtype)
    if kind == DOUBLE:
        return t.gathered(whole)
    out = np.empty(leaf.shape, dtype=object)
    for k, index in enumerate(np.ndindex(*leaf.shape)):
        value = t.load(whole, k)
        out[index] = (
            t.at.fcmp_unordered("!=", value, t.spread(DOUBLE(0.0), value.type))
            if kind == BOOL
            else t.at.fptosi(value, t.wide(LONG))
        )
    return out


def packed(tree: Any) -> Float[Array, " n"]:
    """The leaves of a tree as one array of doubles; integers and Booleans by their bits."""

    def words(leaf: Array) -> Array:
        leaf = jnp.asarray(leaf).ravel()
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf.astype(jnp.float64)
        return jax.lax.bitcast_convert_type(leaf.astype(jnp.int64), jnp.float64)

    return jnp.concatenate([words(leaf) for leaf in jtu.tree_leaves(tree)])


@functools.cache
def sources() -> str:
    """Hash of the sources that simulations depend on: it changes with every edit."""
    root, rooms = Path(__file__).parents[1], ("mechanics", "native", "robot", "simulation", "terms")
    files = sorted(path for room in rooms for path in (root / room).glob("**/*.py"))
    return hashlib.blake2b(b"".join(path.read_bytes() for path in files), digest_size=16).hexdigest()


@functools.cache
def origin() -> str:
    """Hash of what compiled code depends on besides its program: it is kept for no other."""
    features = str(llvm.get_host_cpu_features().flatten())
    whole = sources(), llvm.get_host_cpu_name(), features, version("llvmlite"), version("jax")
    return hashlib.blake2b(repr(whole).encode(), digest_size=16).hexdigest()


def _machine() -> Any:
    _initialise()
    target = llvm.Target.from_default_triple()
    # Not the small code model: code and constants may come to lie too far apart for it, and LLVM aborts.
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, reloc="pic"
    )


@functools.cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def _object_code(text: str) -> bytes:
    with _lock:
        machine = _machine()
        module = llvm.parse_assembly(text)
        module.verify()
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options())
        passes = llvm.create_new_module_pass_manager()
        for name in PASSES:
            getattr(passes, f"add_{name}_pass")()
        passes.run(module, builder)
        return machine.emit_object(module)
