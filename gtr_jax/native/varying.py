"""Which values of a traced program differ between lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax.extend

# Primitives that run another program once, with the names under which they may hold it.
CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "core_call", "remat")
PROGRAMS = ("jaxpr", "call_jaxpr", "fun_jaxpr")


def program_in(params: Any) -> Any:
    """The program that one of `CALLS` runs."""
    return next(params[name] for name in PROGRAMS if name in params)


def varying(jaxpr: Any, given: Sequence[bool]) -> list[bool]:
    """Whether each value that a program returns differs between lanes, if its arguments do as said."""
    does = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, given, strict=True))

    def read(atom: Any) -> bool:
        return not isinstance(atom, jax.extend.core.Literal) and does[atom]

    for eqn in jaxpr.eqns:
        does |= dict(zip(eqn.outvars, _found(eqn, [read(atom) for atom in eqn.invars]), strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _found(eqn: Any, given: list[bool]) -> list[bool]:
    name, params = eqn.primitive.name, eqn.params
    if name in CALLS:
        return varying(program_in(params).jaxpr, given)
    if name == "scan":
        carries = carried_by_scan(params, given)
        return [*carries, *[True] * (len(eqn.outvars) - len(carries))]
    if name == "while":
        return carried_by_while(params, given)
    if name == "cond":
        return [True] * len(eqn.outvars)
    return [any(given)] * len(eqn.outvars)


def carried_by_scan(params: Any, given: Sequence[bool]) -> list[bool]:
    """Whether each value that a scan carries differs between lanes, if its arguments do as said."""
    consts, carries = params["num_consts"], params["num_carry"]
    fixed, rows = given[:consts], given[consts + carries :]

    def once(does: list[bool]) -> list[bool]:
        return varying(params["jaxpr"].jaxpr, [*fixed, *does, *rows])[:carries]

    return _settled(list(given[consts : consts + carries]), once)


def carried_by_while(params: Any, given: Sequence[bool]) -> list[bool]:
    """Whether each value that a while loop carries does: all of them, where the lanes do not end together."""
    a, b = params["cond_nconsts"], params["body_nconsts"]

    def once(does: list[bool]) -> list[bool]:
        if any(varying(params["cond_jaxpr"].jaxpr, [*given[:a], *does])):
            return [True] * len(does)
        return varying(params["body_jaxpr"].jaxpr, [*given[a : a + b], *does])

    return _settled(list(given[a + b :]), once)


def _settled(does: list[bool], once: Callable[[list[bool]], list[bool]]) -> list[bool]:
    """Which carried values differ after any number of turns of a loop; `once` says which do after one."""
    while True:
        after = [before or now for before, now in zip(does, once(does), strict=True)]
        if after == does:
            return does
        does = after
