"""What can be wrong with a robot, and the one line that says so.

The physics here is only geometry: whether the body, its bores and the tendon channel fit into each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gtr_jax.errors import InputError, excerpt
from gtr_jax.terms import Term, catalogue_of
from gtr_jax.terms.term import NO_TUG
from gtr_jax.terms.unmoved import NO_SLIP, unmoved

from .law_section import LawSection
from .sections import (
    BackboneConfig,
    LoadsConfig,
    RectangleConfig,
    TendonConfig,
    TermConfig,
    stiffness_by_several,
)

# What floats can compute with: least length [m] and bending stiffness of a full section [N m^2].
_LEAST_LENGTH, _LEAST_STIFFNESS = 1e-9, 1e-60
_NEAR = 1e-9  # relative: the same length written in two units may differ by a rounding error


def _check_terms(
    terms: Sequence[TermConfig], backbone: BackboneConfig, tendons: Sequence[str], known: Mapping[str, Term]
) -> None:
    kinds, rigid, several = {term.id for term in terms}, backbone.rigid, len(tendons) > 1
    values = {term.id: {q.name: getattr(term, q.name) for q in known[term.id].numbers} for term in terms}
    still = unmoved(known, values, list(values), backbone.length) if rigid else []
    for term in terms:
        law, key = known[term.id], f"terms.{term.id}"
        bends = law.bend or law.loads or law.stop
        if term.tendon is not None:
            _require(several, f"{key}.tendon", "the robot has one tendon; leave tendon out")
            _require(
                term.tendon in tendons,
                f"{key}.tendon",
                f"there is no tendon '{excerpt(term.tendon)}'; one of {', '.join(tendons)}",
            )
            _require(not bends, f"{key}.tendon", "it acts on the body, not on a tendon; leave tendon out")
        unfit = refused_for_section(backbone, law)
        _require(unfit is None, key, unfit or "")
        _require(not (rigid and bends), key, "has no effect on a backbone with rigid = true; remove it")
        _require(term.id not in still, key, NO_SLIP)
        held = not several and not any(known[kind].mobilise for kind in kinds)
        _require(law.tugged is None or held, key, NO_TUG)
        _require(not (rigid and several and not law.of_cells), key, "is for one tendon where rigid = true")
        _require(
            any(getattr(term, q.name) != q.null for q in law.sizes) or len(law.sizes) == 1,
            key,
            f"has no effect; give one of {', '.join(q.name for q in law.sizes)}",
        )
        for q in law.numbers:
            value = getattr(term, q.name)
            low = q.lower is not None and (value < q.lower or (q.log and value == q.lower))
            if low or (q.upper is not None and value > q.upper):
                least = "above" if q.log else "at least"
                bounds = f"{least} {q.lower:g}" if low else f"at most {q.upper:g}"
                raise InputError(f"terms.{term.id}.{q.name}: must be {bounds}, is {value:g}; correct it")
        if law.fault:
            wrong = law.fault({q.name: getattr(term, q.name) for q in law.numbers}, backbone.length)
            _require(not wrong, key, wrong)


def refused_for_section(backbone: BackboneConfig, term: Term) -> str | None:
    """Why a body of this section cannot have a physics term, with the remedy; None if it can."""
    if term.discs_only and isinstance(backbone.section, RectangleConfig):
        return "is for round sections; give a tube instead of a rectangle, or the term stiffening instead"
    if term.discs_only and backbone.notches:
        return "is for round sections, not for what notches leave of them; remove one of the two"
    return None


def check_robot(
    backbone: BackboneConfig,
    *,
    strung: Sequence[tuple[str, TendonConfig, Any]],
    loads: LoadsConfig,
    terms: Sequence[TermConfig],
) -> None:
    """Refuse values that no robot can have; InputError naming the key and the remedy.

    Args:
        backbone: the body.
        strung: name, tendon and routing of every tendon.
        loads: the external loads.
        terms: physics beyond the paper.
    """
    check_backbone(backbone)
    laws = tuple(term.checked() for term in terms if isinstance(term, LawSection))
    _check_terms(
        terms, backbone, [getattr(tendon, "name", "") for _, tendon, _ in strung], catalogue_of(laws)
    )
    for name, tendon, routing in strung:
        table, channel = (f"tendons.{name}", f"tendons.{name}.routing") if name else ("tendon", "routing")
        _check_routing(routing, backbone.length, channel)
        friction, preload = tendon.friction_coefficient, tendon.preload
        _require(friction >= 0, f"{table}.friction_coefficient", f"cannot be negative, is {friction:g}")
        _require(
            preload >= 0, f"{table}.preload", f"cannot be negative, is {preload:g} N: a tendon only pulls"
        )
    _check_loads(loads, backbone)


def _require(holds: bool, key: str, says: str) -> None:
    if not holds:
        raise InputError(f"{key}: {says}")


def outer_radius_at(backbone: BackboneConfig, s: np.ndarray | float) -> np.ndarray:
    """Outer radius [m] at arc length s [m], linear from base to tip and along pieces."""
    s = np.asarray(s, float)
    radius = np.interp(s, [0.0, backbone.length], backbone.outer_radius)
    for piece in backbone.sections:
        if piece.outer_radius is not None:
            here = (piece.from_ <= s) & (s <= piece.to)
            radius = np.where(here, np.interp(s, [piece.from_, piece.to], piece.outer_radius), radius)
    return np.asarray(radius)


def check_backbone(backbone: BackboneConfig) -> None:
    """Refuse a body that cannot be; InputError naming the key and the remedy."""
    length = backbone.length
    _check_length(length, "backbone.length")
    for radius in backbone.outer_radius:
        _check_length(radius, "backbone.outer_radius")
    _require(
        -1 < backbone.poissons_ratio <= 0.5,
        "backbone.poissons_ratio",
        f"must lie above -1 and be at most 0.5, is {backbone.poissons_ratio:g}",
    )
    _check_modulus(backbone)
    for key in ("natural_curvature", "natural_curvature_y", "natural_twist"):
        strain = getattr(backbone, key)
        if isinstance(strain, tuple):
            _check_knots(f"backbone.{key}", strain, length)
    _check_stiffness("backbone", backbone.bending_stiffness, backbone.torsional_stiffness, length)
    _check_factor(backbone)
    _check_pieces(backbone)
    _check_bores(backbone)
    _check_section(backbone)
    _check_notches(backbone)
    _check_axial(backbone)


def _check_modulus(backbone: BackboneConfig) -> None:
    modulus = backbone.youngs_modulus
    given = "youngs_modulus" in backbone.model_fields_set and not (
        backbone.bending_stiffness is not None and modulus == 0
    )
    if backbone.bending_stiffness is not None:
        needed = any(p.bending_stiffness is None and p.youngs_modulus is None for p in backbone.sections)
        _require(
            not given or needed,
            "backbone.youngs_modulus",
            "has no effect beside bending_stiffness; remove one of the two",
        )
        _require(
            given or not needed,
            "backbone",
            "missing key 'youngs_modulus', of the sections without one; give each its own, or a "
            "bending_stiffness",
        )
        return
    _require(
        given or backbone.rigid,
        "backbone",
        "missing key 'youngs_modulus'; add for example youngs_modulus = \"1.06 MPa\", or rigid = true",
    )
    _require(
        modulus > 0 or (backbone.rigid and modulus == 0),
        "backbone.youngs_modulus",
        f"must be positive, is {modulus:g} Pa",
    )
    stiffness = 0.25 * np.pi * modulus * min(backbone.outer_radius) ** 4
    _require(
        backbone.rigid or stiffness > _LEAST_STIFFNESS,
        "backbone.youngs_modulus",
        f"{modulus:g} Pa leaves a bending stiffness of {stiffness:g} N m^2, too little to compute with; "
        "check the units",
    )


def _check_stiffness(table: str, bending: Any, torsion: Any, length: float) -> None:
    for key, given in (("bending_stiffness", bending), ("torsional_stiffness", torsion)):
        if given is None:
            continue
        rows = given if isinstance(given, tuple) else (given,)
        if isinstance(rows[0], tuple):
            _require(
                len({len(row) for row in rows}) == 1,
                f"{table}.{key}",
                "some rows give one stiffness and some two; write [s, EI] or [s, EI_y, EI_z] in all",
            )
            _check_knots(f"{table}.{key}", rows, length)
            values = [value for row in rows for value in row[1:]]
        else:
            values = list(rows)
        least = min(values)
        _require(
            least > _LEAST_STIFFNESS, f"{table}.{key}", f"must be positive everywhere, is {least:g} N m^2"
        )
    _require(
        torsion is None or bending is not None,
        f"{table}.torsional_stiffness",
        "needs a bending_stiffness beside it; add one, or leave both to youngs_modulus and poissons_ratio",
    )


def _check_factor(backbone: BackboneConfig) -> None:
    key = "backbone.stiffness_factor"
    if backbone.stiffness_factor is None:
        return
    _require(not backbone.rigid, key, "has no effect on a backbone with rigid = true; remove it")
    _require(
        stiffness_by_several(backbone.model_dump(include={"bending_stiffness", "sections"})),
        key,
        "one number gives the stiffness of this body; change that number and leave stiffness_factor out",
    )


def _check_pieces(backbone: BackboneConfig) -> None:
    for i, piece in enumerate(backbone.sections):
        key = f"backbone.sections[{i}]"
        own = (piece.outer_radius, piece.youngs_modulus, piece.bending_stiffness)
        _require(
            any(value is not None for value in own),
            key,
            "changes nothing; give outer_radius, youngs_modulus or bending_stiffness",
        )
        for radius in piece.outer_radius or ():
            _check_length(radius, f"{key}.outer_radius")
        _require(
            piece.youngs_modulus is None or piece.bending_stiffness is None,
            f"{key}.youngs_modulus",
            "has no effect beside bending_stiffness; remove one of the two",
        )
        _check_stiffness(key, piece.bending_stiffness, piece.torsional_stiffness, backbone.length)
    _check_stretches("sections", backbone.sections, backbone.length)


def _check_stretches(table: str, stretches: Sequence[Any], length: float) -> None:
    """Bores, or pieces, must run forwards within the body and not overlap."""
    for i, stretch in enumerate(stretches):
        key, ends = f"backbone.{table}[{i}]", f"{mm(stretch.from_)} to {mm(stretch.to)}"
        _require(stretch.from_ < stretch.to, key, f"runs from {ends}; 'from' must lie before 'to'")
        _require(
            stretch.from_ >= 0 and stretch.to <= length * (1 + _NEAR),
            key,
            f"runs from {ends}, outside the backbone; keep it within 0 mm and {mm(length)}",
        )
    order = sorted(range(len(stretches)), key=lambda i: stretches[i].from_)
    for i, j in itertools.pairwise(order):
        end, start = stretches[i].to, stretches[j].from_
        _require(
            start >= end - _NEAR * length,
            f"backbone.{table}[{j}]",
            f"starts at {mm(start)}, before {table}[{i}] ends at {mm(end)}; separate the two",
        )


def _check_length(length: float, key: str) -> None:
    _require(length > 0, key, f"must be positive, is {length:g} m")
    _require(length >= _LEAST_LENGTH, key, f"is {length:g} m, too small to compute with; check the unit")


def _check_bores(backbone: BackboneConfig) -> None:
    _check_stretches("bores", backbone.bores, backbone.length)
    for i, bore in enumerate(backbone.bores):
        steps = [end for piece in backbone.sections for end in (piece.from_, piece.to)]
        ends = [end * side for end in steps for side in (1 - _NEAR, 1 + _NEAR)]
        stations = np.array([bore.from_, bore.to, *(end for end in ends if bore.from_ < end < bore.to)])
        radii = outer_radius_at(backbone, stations)  # linear between them, so narrowest at one
        narrowest = int(np.argmin(radii))
        _require(
            bore.diameter < 2 * radii[narrowest],
            f"backbone.bores[{i}].diameter",
            f"the bore is {mm(bore.diameter)} wide and the body {mm(2 * radii[narrowest])} at "
            f"s = {mm(stations[narrowest])}; narrow the bore or widen the body",
        )


def _check_section(backbone: BackboneConfig) -> None:
    """What carries the load must fit into the body, and say alone how stiff it is."""
    section = backbone.section
    if section is None:
        return
    key = "backbone.section"
    _require(not backbone.rigid, key, "has no effect on a backbone with rigid = true; remove it")
    _require(
        backbone.bending_stiffness is None,
        key,
        "says with youngs_modulus what bending_stiffness says; keep one of the two",
    )
    for table in ("bores", "notches"):
        _require(
            not getattr(backbone, table),
            f"backbone.{table}",
            "is not computed beside section; remove one of the two",
        )
    if isinstance(section, RectangleConfig):
        sizes, least = (
            {"height": section.height, "width": section.width},
            float(np.hypot(section.height, section.width)),
        )
    else:
        sizes, least = {"outer_diameter": section.outer_diameter}, section.outer_diameter
        _require(
            0 <= section.inner_diameter < section.outer_diameter,
            f"{key}.inner_diameter",
            f"is {mm(section.inner_diameter)}, and the tube {mm(section.outer_diameter)} thick; "
            "give 0 or more, and less than that",
        )
    for name, size in sizes.items():
        _check_length(size, f"{key}.{name}")
    ends = [end for piece in backbone.sections for end in (piece.from_, piece.to)]
    room = 2 * float(np.min(outer_radius_at(backbone, np.array([0.0, backbone.length, *ends]))))
    _require(
        least <= room * (1 + _NEAR),
        key,
        f"is {mm(least)} from side to side, and the body {mm(room)} where it is thinnest; correct one",
    )


def _check_axial(backbone: BackboneConfig) -> None:
    stiffness = backbone.axial_stiffness
    key = "backbone.extensible" if stiffness is None else "backbone.axial_stiffness"
    _require(not (backbone.stretches and backbone.rigid), key, "has no effect on a body with rigid = true")
    moduli = backbone.bending_stiffness is None and all(
        p.bending_stiffness is None for p in backbone.sections
    )
    _require(
        not backbone.extensible or stiffness is not None or moduli,
        key,
        "needs a modulus all along; give axial_stiffness beside bending_stiffness",
    )


def _check_notches(backbone: BackboneConfig) -> None:
    """Notches must be cut into a tube or rod of known modulus, leave something of it, and not overlap."""
    stiff = [piece for piece in backbone.sections if piece.bending_stiffness is not None]
    for i, row in enumerate(backbone.notches):
        key = f"backbone.notches[{i}]"
        _require(not backbone.rigid, key, "has no effect on a backbone with rigid = true; remove it")
        _require(
            backbone.youngs_modulus > 0 and backbone.bending_stiffness is None,
            key,
            "needs the stiffness of its section; give youngs_modulus instead of bending_stiffness",
        )
        _check_length(row.height, f"{key}.height")
        _require(
            row.height + row.end_correction > 0.05 * row.height,
            f"{key}.end_correction",
            f"of {mm(row.end_correction)} leaves nothing of a height of {mm(row.height)}; correct one",
        )
        _require(
            len(row.natural_angle) == row.count,
            f"{key}.natural_angle",
            f"gives {len(row.natural_angle)} angles for {row.count} notches; give one for all or for each",
        )
        for start, end in row.ends:
            _require(
                start >= -_NEAR * backbone.length and end <= backbone.length * (1 + _NEAR),
                key,
                f"a notch runs from {mm(start)} to {mm(end)}, outside the backbone; keep it within 0 mm and "
                f"{mm(backbone.length)}",
            )
            _require(
                not any(piece.from_ < end and start < piece.to for piece in stiff),
                key,
                f"the notch from {mm(start)} to {mm(end)} needs the stiffness of its section; give the piece "
                "of the body there a youngs_modulus instead of bending_stiffness",
            )
            outer = outer_radius_at(backbone, np.array([start, end]))
            _require(
                bool(np.all((row.depth > outer) & (row.depth < 2 * outer))),
                f"{key}.depth",
                f"is {mm(row.depth)}, and the body is {mm(2 * outer[0])} thick; a notch goes beyond the axis "
                "and leaves something of the body",
            )
    # Rows may alternate, as of tubes that are cut from both sides.
    each = sorted((start, end, i) for i, row in enumerate(backbone.notches) for start, end in row.ends)
    for (_, before, last), (start, _, i) in itertools.pairwise(each):
        _require(
            start >= before - _NEAR * backbone.length,
            f"backbone.notches[{i}]",
            f"a notch starts at {mm(start)}, before one of notches[{last}] ends at {mm(before)}; give more "
            "spacing",
        )


def _check_routing(routing: Any, length: float, table: str) -> None:
    if routing.kind == "straight-sine-straight":
        for key, w in (("w1", routing.w1), ("w2", routing.w2)):
            _require(
                0 <= w <= length * (1 + _NEAR),
                f"{table}.{key}",
                f"{mm(w)} lies outside the backbone; keep it within 0 mm and {mm(length)}",
            )
        _require(
            routing.w1 < routing.w2,
            f"{table}.w1",
            f"w1 = {mm(routing.w1)} must be less than w2 = {mm(routing.w2)}; swap or move them",
        )
    elif routing.kind == "converging-sine" or routing.kind == "crossing-sine":
        _require(routing.n_sine > 0, f"{table}.n_sine", f"must be positive, is {routing.n_sine:g}")
    elif routing.kind in ("table", "curve"):
        _check_knots(f"{table}.knots", routing.knots, length)
    elif routing.kind in ("helix", "straight"):
        for key in ("radius", "tip_radius"):
            radius = getattr(routing, key, None)
            _require(
                radius is None or radius >= 0, f"{table}.{key}", f"cannot be negative, is {mm(radius or 0)}"
            )


def _check_knots(key: str, knots: Sequence[Sequence[float]], length: float) -> None:
    """Knots must be at least two, in increasing s, and cover the backbone from 0 to its length [m]."""
    _require(len(knots) >= 2, key, f"needs at least two knots, has {len(knots)}")
    stations = np.array([knot[0] for knot in knots])
    back = np.flatnonzero(np.diff(stations) <= 0)
    if back.size:
        i = int(back[0])
        _require(
            False,
            f"{key}[{i + 1}]",
            f"s = {mm(stations[i + 1])} follows {mm(stations[i])}; s must increase",
        )
    _require(
        stations[0] <= _NEAR * length and stations[-1] >= length * (1 - _NEAR),
        key,
        f"knots span {mm(stations[0])} to {mm(stations[-1])}; they must cover 0 mm to {mm(length)}",
    )


def _check_loads(loads: LoadsConfig, backbone: BackboneConfig) -> None:
    _require(
        loads.gravity is None or loads.gravity_angle is None,
        "loads.gravity",
        "says what gravity_angle says; keep one of the two",
    )
    weighs = loads.gravity_angle is not None or loads.gravity is not None
    key = "gravity" if loads.gravity_angle is None else "gravity_angle"
    _require(
        not weighs or backbone.rigid or backbone.density > 0,
        "backbone",
        f"missing key 'density', which {key} needs; add for example density = \"1070 kg/m^3\"",
    )
    _require(
        loads.payload == 0 or weighs,
        "loads.payload",
        'needs the direction of gravity to weigh; add for example gravity_angle = "-90 deg"',
    )
    acting = {
        key: weighs,
        "tip_force": any(loads.tip_force),
        "tip_moment": bool(np.any(np.asarray(loads.tip_moment))),
    }
    for key, acts in acting.items():
        _require(
            not (acts and backbone.rigid),
            f"loads.{key}",
            "has no effect on a backbone with rigid = true; remove one of the two",
        )


def mm(length: float) -> str:
    """A length [m] in millimetres, for a message."""
    return f"{1e3 * length:.6g} mm"
