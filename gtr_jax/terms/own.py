"""Terms of a user's own: where they are found, and what is checked before one joins the catalogue."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.util
import marshal
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.dimension import dimension_of_unit
from gtr_jax.errors import InputError, did_you_mean, listed, reason

from .term import Bent, Channel, Clock, Passing, Quantity, Term
from .tried import fault_of

# Entry points of installed packages, and the variable that names Python files, apart as paths are in PATH.
GROUP, VARIABLE = "gtr_jax.terms", "GTR_JAX_TERMS"
# The kind of the terms that a robot file states as an expression.
LAW = "law"
# What a file or a module calls its terms.
ATTRIBUTES = ("TERM", "TERMS")
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_NUMBER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
# Largest effect at the null values that counts as none, relative to the size of what the hook changes.
NOTHING = 1e-12
# Places at which hooks are evaluated: tensions [N], line pressures [N/m], speeds [m/s], arc lengths [m],
# curvatures [1/m], times [s] and cycles.
_T = np.array([0.0, 0.1, 3.0, 40.0, 90.0])
_P = np.array([0.0, 2.0, 300.0, 40.0, 9.0])
_V = np.array([0.0, 1e-6, 1e-3, 0.02, 0.3])
_S = np.array([0.0, 0.01, 0.1, 0.2, 0.24])
_K = np.array([-12.0, -0.5, 0.0, 3.0, 25.0])
_TIME = np.array([0.0, 0.5, 30.0, 200.0, 4e3])
_CYCLE = np.array([0.0, 0.5, 2.0, 7.0, 40.0])
# How far the tendon is drawn out [m]: a law may be a narrow bump of it.
_DRAWN = np.append(np.linspace(-2e-3, 2e-2, 28), [0.05, 0.1]).reshape(6, 5)
# What a hook of friction may read, by the flag with which a term says so.
_READ = {"timed": "time", "reads_speed": "the speed of the slip", "reads_drawn": "what is drawn out"}
Values = Mapping[str, float]


@dataclasses.dataclass(frozen=True)
class _Hook:
    """A hook that a term of a user's own may have: how it is called, and what it gives without effect."""

    called: Callable[[Callable, Values, Any], Any]
    neutral: np.ndarray | float

    def at(self, hook: Callable, values: Values, where: Any) -> np.ndarray:
        """What it gives at numbers and places, compiled as the simulation compiles it."""
        return np.asarray(jax.jit(lambda p: self.called(hook, p, where))(dict(values)), float)


@dataclasses.dataclass(frozen=True)
class _Where:
    """What hooks are evaluated at: speeds [m/s], times [s] and cycles, (K,), the sense of the slip, whether a
    `Channel` is known, and how far the tendon is drawn out [m], (K,).
    """

    speed: np.ndarray
    time: np.ndarray
    cycle: np.ndarray
    sense: float = 1.0
    channel: bool = True
    drawn: np.ndarray = dataclasses.field(default_factory=lambda: np.full(len(_S), 1e-3))

    @property
    def of_channel(self) -> Channel:
        """As the hooks of friction get it."""
        start, speed, time, cycle = map(jnp.asarray, (_S, self.speed, self.time, self.cycle))
        return Channel(start, start + 0.01, speed, self.sense, time, cycle, jnp.asarray(self.drawn))

    @property
    def passing(self) -> Passing:
        """As the hooks get it that act while a load step is solved."""
        return Passing(jnp.asarray(_P), jnp.asarray(_T), self.of_channel if self.channel else None)


def _bent(term: Term) -> Bent:
    rest, before = jnp.zeros(len(_K)), jnp.asarray(0.5 * _K)
    kept = jnp.zeros((term.remembers, len(_K)))
    place = jnp.linspace(0.0, 0.3, len(_K)) if term.by_place else None
    return Bent(rest, before, kept, jnp.asarray(0.5), jnp.asarray(100.0), jnp.asarray(0.01), place)


def _cell(hook: Callable, p: Values, where: _Where) -> Any:
    return hook(p, jnp.asarray(_T), Clock(jnp.asarray(where.time), jnp.asarray(_T)))


def _hooks(term: Term) -> dict[str, _Hook]:
    """The hooks that are open, by name; `bend` remembers as much as the term says."""
    one, none = 1.0, 0.0

    def bend(hook: Callable, p: Values, where: _Where) -> Any:
        return hook(p, jnp.asarray(_K), _bent(term))[0]

    def by_tension(hook: Callable, p: Values, where: _Where) -> Any:
        return hook(p, jnp.asarray(_T))

    return {
        "friction": _Hook(lambda hook, p, where: hook(p, where.of_channel), one),
        "by_pressure": _Hook(lambda hook, p, where: hook(p, where.passing), one),
        "by_speed": _Hook(lambda hook, p, where: hook(p, jnp.asarray(where.sense * where.speed)), none),
        "drag": _Hook(lambda hook, p, where: hook(p, where.passing), none),
        "wrap": _Hook(by_tension, one),
        "base_grip": _Hook(lambda hook, p, where: hook(p), none),
        "tip_grip": _Hook(lambda hook, p, where: hook(p), none),
        "bend": _Hook(bend, none),
        "strain": _Hook(by_tension, none),
        "anchor": _Hook(by_tension, none),
        "ahead": _Hook(by_tension, none),
        "tip": _Hook(_cell, _T),
        "base": _Hook(_cell, _T),
        "true_base": _Hook(_cell, _T),
    }


# Hooks that the terms of the catalogue alone have: a robot has one memory of friction, what loads and stops
# do at null is not checked here, and events are looked for by their own search.
CLOSED = ("mobilise", "loads", "stop", "stop_angle", "stop_normal", "tugged", "read_at")


def check_term(term: Any, known: Mapping[str, Term], where: str) -> None:
    """Refuse what cannot be a term of the catalogue.

    Args:
        term: what is to join it.
        known: the catalogue.
        where: it comes from, for messages.

    Raises:
        InputError: it is not a term, its name or a number's is taken or none, a unit is unknown, it has no
            hook or one that is not open, a hook cannot be compiled, has an effect at the null values, or
            reads what the term does not declare.
    """
    if not isinstance(term, Term):
        raise InputError(f"{where}: expected a gtr_jax.terms.Term, found {type(term).__name__}")
    at = f"{where}: term '{term.id}'"
    if not isinstance(term.id, str) or not _NAME.fullmatch(term.id):
        raise InputError(
            f"{at}: is not a valid name of a term; write small letters and digits, with hyphens between"
        )
    if term.id == LAW or term.id in known:
        raise InputError(f"{at}: there is a term of this name already; give it another id")
    _check_quantities(term, at)
    hooks = _hooks(term)
    given = [name for name in hooks if getattr(term, name) is not None]
    closed = [name for name in CLOSED if getattr(term, name) is not None]
    closed += [name for name in ("event", "across", "adds_to") if getattr(term, name)]
    closed += ["assumed" for q in term.quantities if q.assumed]
    if closed:
        what = closed[0]
        raise InputError(f"{at}: '{what}' is open to the terms of the catalogue only; leave it out")
    if not given:
        raise InputError(f"{at}: has no hook, so that it does nothing; give it one of {listed(hooks, 20)}")
    if term.base is not None and term.true_base is None:
        raise InputError(f"{at}: base needs its inverse; give true_base as well")
    if (term.bend is None) != (term.bend_in_space is None) and not term.not_in_space:
        raise InputError(
            f"{at}: bend needs bend_in_space beside it; give both, or say why not in space in not_in_space"
        )
    try:
        values = {each.id: {q.name: q.null for q in each.quantities} for each in (*known.values(), term)}
        fault = fault_of(term.tried, {q.name: float(q.typical) for q in term.quantities}, values)
    except Exception as error:  # of any kind: it is the user's code
        fault = f"what is tried of it cannot be computed ({reason(error)}); correct its functions"
    if fault:
        raise InputError(f"{at}: {fault}")
    for name in given:
        _check_hook(term, name, hooks[name], at)


def _check_quantities(term: Term, at: str) -> None:
    names = [q.name for q in term.quantities if isinstance(q, Quantity)]
    if len(names) != len(term.quantities) or not any(q.size for q in term.quantities):
        raise InputError(f"{at}: needs quantities, of which one at least is a size; give a tuple of Quantity")
    for q in term.quantities:
        if not _NUMBER.fullmatch(q.name) or q.name == "kind" or names.count(q.name) > 1:
            raise InputError(f"{at}: '{q.name}' is not a valid name of a number of its own; give another")
        if dimension_of_unit(q.unit) is None:
            raise InputError(f"{at}: unit '{q.unit}' of {q.name} is unknown; write SI units, as N/m^2")
        low, high = q.usual
        ends = (-np.inf if q.lower is None else q.lower, np.inf if q.upper is None else q.upper)
        if not low < high or not all(ends[0] <= value <= ends[1] for value in (low, high, q.null, q.typical)):
            raise InputError(
                f"{at}: null, typical and usual values of {q.name} must lie within its bounds, and usual "
                "rise; correct them"
            )


def _check_hook(term: Term, name: str, hook: _Hook, at: str) -> None:
    """Refuse a hook that does something at the null values, or reads what the term does not declare."""
    call = getattr(term, name)
    usual = _Where(_V, _TIME, _CYCLE, channel=name not in ("by_pressure", "drag") or term.reads_channel)
    cells = name in ("tip", "base", "true_base")

    def value(values: Values, where: _Where) -> np.ndarray:
        try:
            found = hook.at(call, values, where)
        except Exception as fault:  # of any kind: it is the user's code
            remedy = "write it with jax.numpy, for arrays of any shape, without branches on values"
            if not where.channel and "NoneType" in str(fault):
                remedy = "set reads_channel=True if it depends on the channel"
            if name == "bend" and not term.by_place and "NoneType" in str(fault):
                remedy = "set by_place=True if it depends on the place"
            raise InputError(f"{at}: {name} cannot be computed ({reason(fault)}); {remedy}") from None
        if not np.all(np.isfinite(found)):
            raise InputError(
                f"{at}: {name} gives {found.ravel()[~np.isfinite(found.ravel())][0]}; keep it finite"
            )
        return found

    scale = max(float(np.max(np.abs(hook.neutral))), 1.0)
    for values in _nulls(term):
        for sense in (1.0, -1.0):
            off = np.abs(value(values, dataclasses.replace(usual, sense=sense)) - hook.neutral)
            if float(np.max(off)) > NOTHING * scale:
                neutral = "what it is given" if cells else f"{hook.neutral:g}"
                told = ", ".join(f"{key} = {number:g}" for key, number in values.items())
                raise InputError(
                    f"{at}: {name} must give {neutral} at null, and is {float(np.max(off)):.3g} off it at "
                    f"{told}; correct the law or the null values"
                )
    typical = {q.name: float(q.typical) for q in term.quantities}
    here = value(typical, usual)
    reads = [("timed", dataclasses.replace(usual, time=usual.time + 77.0))]
    if name in ("friction", "by_pressure", "drag"):
        reads.append(("reads_speed", dataclasses.replace(usual, speed=usual.speed[::-1] + 1e-3)))
        reads += [("reads_drawn", dataclasses.replace(usual, drawn=drawn)) for drawn in _DRAWN]
    for flag, other in reads:
        if not getattr(term, flag) and np.any(np.abs(value(typical, other) - here) > NOTHING * scale):
            raise InputError(f"{at}: {name} depends on {_READ[flag]}; set {flag}=True")
    sizes = [q.name for q in term.sizes]

    def slopes(p: dict) -> Any:
        return jax.jacfwd(lambda own: hook.called(call, {**p, **own}, usual))({key: p[key] for key in sizes})

    derivatives = jax.tree_util.tree_leaves(
        slopes({q.name: jnp.asarray(float(q.null)) for q in term.quantities})
    )
    if not all(np.all(np.isfinite(leaf)) for leaf in derivatives):
        raise InputError(f"{at}: {name} has no finite derivative at null; write it so that it has one")


def _nulls(term: Term) -> Iterator[dict[str, float]]:
    """Numbers at which a term must do nothing: its sizes at null, and the others where they may be."""
    null = {q.name: float(q.null) for q in term.quantities}
    others = [q for q in term.quantities if not q.size]
    yield null
    for q in others:
        for other in (q.typical, *q.usual):
            yield null | {q.name: float(other)}


# --- where they are found ----------------------------------------------------------------------------------


def outside_terms() -> Iterator[tuple[str, Any]]:
    """Terms of installed packages and of the files that the environment names, with where each comes from.

    Raises:
        InputError: a package or a file that cannot be imported, or holds no term.
    """
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        where = f"entry point {entry.name} = {entry.value}"
        try:
            found = entry.load()
        except Exception as fault:  # of any kind: it is the user's code
            raise InputError(f"{where}: cannot be loaded ({reason(fault)}); mend or uninstall it") from None
        for term in _listed(found, where):
            yield where, term
    for path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        for term in terms_in(Path(path)):
            yield path, term


def terms_in(path: Path) -> list[Any]:
    """The terms that a Python file calls TERM or TERMS; none where it registers them itself.

    Raises:
        InputError: it is not a file, fails, or holds none.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; name a Python file that holds a TERM")
    name = f"gtr_jax_own_{hashlib.blake2b(str(path.resolve()).encode(), digest_size=6).hexdigest()}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file; its name must end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as fault:  # of any kind: it is the user's code
        hooks = [field.name for field in dataclasses.fields(Term)]
        unknown = re.search(r"unexpected keyword argument '(\w+)'", str(fault))
        remedy = (
            f"unknown hook '{unknown[1]}'; {did_you_mean(unknown[1], hooks)}" if unknown else "correct it"
        )
        raise InputError(f"{path}: fails ({reason(fault)}); {remedy}") from None
    return _listed(module, str(path))


def _listed(found: Any, where: str) -> list[Any]:
    """The terms in what was loaded: a term, several, or a module that holds them."""
    if isinstance(found, Term):
        return [found]
    if isinstance(found, Sequence) and not isinstance(found, str):
        return list(found)
    held = [getattr(found, name) for name in ATTRIBUTES if hasattr(found, name)]
    if not held and any(isinstance(value, Term) for value in vars(found).values()):
        raise InputError(f"{where}: calls no term TERM, nor several TERMS; name them so")
    return [term for one in held for term in ([one] if isinstance(one, Term) else list(one))]


def mark_of(terms: Sequence[Term]) -> str:
    """What tells terms from others of the same names, by their numbers and by the code of their functions,
    with those of the same file that these call; "" for none.
    """
    if not terms:
        return ""
    whole = hashlib.blake2b(digest_size=16)
    for term in terms:
        for field in dataclasses.fields(term):
            whole.update(field.name.encode())
            whole.update(_said(getattr(term, field.name), set()))
    return whole.hexdigest()


def _said(value: Any, seen: set[int]) -> bytes:
    """A value as bytes that are the same in every process; functions by their code and what it draws on."""
    if isinstance(value, functools.partial):
        return b"|".join(_said(part, seen) for part in (value.func, value.args, value.keywords))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return b"|".join(_said(getattr(value, field.name), seen) for field in dataclasses.fields(value))
    if isinstance(value, tuple):
        return b",".join(_said(part, seen) for part in value)
    if not isinstance(value, FunctionType):
        return repr(value).encode()
    if id(value) in seen:
        return b"again"
    seen.add(id(value))
    held = [cell.cell_contents for cell in value.__closure__ or ()]
    known = (value.__globals__.get(name) for name in value.__code__.co_names)
    called = [f for f in known if isinstance(f, FunctionType) and f.__module__ == value.__module__]
    parts = [_said(part, seen) for part in (*held, *called, value.__defaults__)]
    # Later formats depend on who else refers to a constant.
    return b"|".join([marshal.dumps(value.__code__, 2), *parts])
