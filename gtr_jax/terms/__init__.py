"""Physics beyond the paper, one term per file. A new term needs its file and its entry in REGISTRY below.

A robot has these terms, those of a user's own (`register_term`) and the laws of its own file; `catalogue_of`
gives all.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool

from gtr_jax.errors import InputError

from . import (
    adhesion,
    base_gain,
    base_offset,
    body_hysteresis,
    cell_hysteresis,
    clearance,
    contact,
    crosstalk,
    free_length,
    friction_asymmetry,
    friction_drift,
    gravity_error,
    hyperelastic,
    local_friction,
    low_pass,
    presliding,
    pressure_dependent_friction,
    quantisation,
    saturation,
    shaken_sheath,
    sheath_moved,
    stiffening,
    stribeck_friction,
    superelastic,
    tendon_stretch,
    time_skew,
    tip_gain,
    tip_load,
    tip_moved,
    tip_offset,
    viscoelastic_body,
    viscous_friction,
    wear,
    zero_drift,
)
from .law import Law, term_of_law
from .own import check_term, mark_of, outside_terms
from .term import Quantity, Term, Values

# Terms of the load cells act in this order, from the true tension to the tension shown.
REGISTRY: dict[str, Term] = {
    module.TERM.id: module.TERM
    for module in (
        presliding,
        viscous_friction,
        stribeck_friction,
        pressure_dependent_friction,
        adhesion,
        friction_asymmetry,
        wear,
        friction_drift,
        shaken_sheath,
        sheath_moved,
        tip_moved,
        local_friction,
        clearance,
        stiffening,
        hyperelastic,
        superelastic,
        viscoelastic_body,
        body_hysteresis,
        tendon_stretch,
        free_length,
        tip_load,
        gravity_error,
        contact,
        cell_hysteresis,
        tip_gain,
        base_gain,
        crosstalk,
        tip_offset,
        base_offset,
        zero_drift,
        low_pass,
        time_skew,
        saturation,
        quantisation,
    )
}


# Names of those that users registered.
OWN: set[str] = set()
# Whether robot files have tables for the terms known so far, `terms_of_files`.
_in_files = False
# Whether terms are looked for that lie outside, on import: these may register themselves.
_looking = True


def register_term(term: Term, *, where: str = "register_term") -> Term:
    """Add a term of your own to the catalogue: robot files, fits, diagnoses, sweeps and `gtr terms` then know
    it like any other. Terms of the load cells act before those of the catalogue.

    Args:
        term: its id, words, quantities and hooks; see `gtr_jax.terms.Term`.
        where: it comes from, for messages.

    Returns:
        The term.

    Raises:
        InputError: its name is taken, it has no hook, does something at its null values or reads what it
            does not declare; or robot files have been read already, with tables for the terms known then.
    """
    if _in_files and not _looking:
        raise InputError(
            f"{where}: robot files are read already, with the terms known then; register terms right after "
            "'import gtr_jax', before calibrate, design or a robot file"
        )
    from gtr_jax.stored import keep_none

    check_term(term, REGISTRY, where)
    before = dict(REGISTRY)
    REGISTRY.clear()
    REGISTRY.update({term.id: term} | before)
    OWN.add(term.id)
    keep_none()
    return term


def terms_of_files() -> tuple[Term, ...]:
    """Every registered term, for the tables of robot files; from now on none can be registered."""
    global _in_files
    _in_files = True
    return tuple(REGISTRY.values())


def own_mark() -> str:
    """What tells the registered terms of users from others of the same names; "" where there are none."""
    return mark_of([REGISTRY[name] for name in sorted(OWN)])


def catalogue_of(laws: tuple[Law, ...]) -> Mapping[str, Term]:
    """All terms of a robot, by name: the laws of its file, which act first of those of the load cells, then
    the registered ones.
    """
    return _with_laws(laws) if laws else REGISTRY


@functools.lru_cache(maxsize=256)
def _with_laws(laws: tuple[Law, ...]) -> Mapping[str, Term]:
    return MappingProxyType({law.name: term_of_law(law) for law in laws} | REGISTRY)


def null_values(laws: tuple[Law, ...] = ()) -> dict[str, dict[str, float]]:
    """The numbers of all terms at which no term has an effect, by term and name [SI]."""
    known = catalogue_of(laws)
    return {term.id: {q.name: float(q.null) for q in term.numbers} for term in known.values()}


def is_on(term: Term, values: Values) -> Bool[Array, ""]:
    """Whether any size of a term, a number that sets its strength, differs from its null value."""
    return jnp.any(jnp.stack([values[q.name] != q.null for q in term.sizes]))


def called(hook: Callable[..., Any], values: Values, *args: Any) -> Any:
    """What a hook of a term gives for its numbers. These may be one for each tendon, (tendons,), where the
    robot file says so: hooks act on each element by itself, with the tendons along the last axis.
    """
    if not any(jnp.ndim(value) for value in values.values()):
        return hook(values, *args)
    with jax.numpy_rank_promotion("allow"):
        return hook(values, *args)


def known_on(term: Term, values: Mapping[str, Any]) -> bool | None:
    """As `is_on`, but on the host; None if any of these numbers is traced."""
    if any(isinstance(values[q.name], Tracer) for q in term.sizes):
        return None
    return any(bool(np.any(np.asarray(values[q.name]) != q.null)) for q in term.sizes)


def known_acting(terms: Mapping[str, Values], laws: tuple[Law, ...] = ()) -> list[str]:
    """Names of the terms that are known to act."""
    return [kind for kind, term in catalogue_of(laws).items() if known_on(term, terms[kind])]


for _where, _term in outside_terms():
    register_term(_term, where=_where)
_looking = False


__all__ = [
    "OWN",
    "REGISTRY",
    "Law",
    "Quantity",
    "Term",
    "called",
    "catalogue_of",
    "is_on",
    "known_acting",
    "known_on",
    "null_values",
    "own_mark",
    "register_term",
    "terms_of_files",
]
