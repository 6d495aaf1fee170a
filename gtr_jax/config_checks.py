"""What can be wrong with a robot, and the one line that says so.

The physics here is only geometry: whether the body, its bores and the tendon channel fit into each other.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ValidationError

from gtr_jax.errors import InputError, did_you_mean, excerpt, nearest_first
from gtr_jax.terms import REGISTRY, Term
from gtr_jax.terms.term import NO_SLIP

if TYPE_CHECKING:
    from gtr_jax.config import BackboneConfig, RobotConfig

_SAYS = {
    "missing": "too few values",
    "too_long": "too many values",
    "tuple_type": "expected a list in brackets",
    "dict_type": "expected a table of keys and values",
    "bool_type": "expected true or false",
    "string_type": "expected a text in quotes",
    "int_parsing_size": "too large a number",
    "less_than": "too large a number",
    "greater_than": "too large a number below zero",
}
# What floats can compute with: least length [m] and bending stiffness of a full section [N m^2].
_LEAST_LENGTH, _LEAST_STIFFNESS = 1e-9, 1e-60
_NEAR = 1e-9  # relative: the same length written in two units may differ by a rounding error


def check_keys(section: type[BaseModel], data: Any) -> None:
    """Refuse a section that is no table, has a key it does not know, or lacks one it needs."""
    if not isinstance(data, Mapping):
        raise InputError(f"expected a table of keys and values, found {_found(data)}")
    keys = {field.alias or name: field for name, field in section.model_fields.items()}
    for key in data:
        if key not in keys:
            raise InputError(f"unknown key '{key}'; {did_you_mean(str(key), keys)}")
    for key, field in keys.items():
        if field.is_required() and key not in data:
            example = f"{key} = {_toml(field.examples[0])}" if field.examples else f"[{key}]"
            raise InputError(f"missing key '{key}'; add for example {example}")


def _toml(value: Any) -> str:
    """A value as a robot file writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)


def one_line(error: ValidationError, kinds: Mapping[str, object]) -> str:
    """The first fault of a pydantic error as "key: what; remedy". `kinds` are the names of the routings."""
    faults = error.errors()
    fault = faults[0]
    place = ""
    for i, part in enumerate(fault["loc"]):
        before = fault["loc"][i - 1] if i else None
        tag = str(part).startswith("#") or (before == "routing" and part in kinds)
        tag = tag or (fault["loc"][0] == "terms" and isinstance(before, int) and part in REGISTRY)
        if not tag:
            place += f"[{part}]" if isinstance(part, int) else f".{part}"
    context = fault.get("ctx", {})
    if fault["type"] == "value_error":
        says = str(context["error"])
    elif fault["type"] == "union_tag_invalid":
        tag, expected = context["tag"], re.findall(r"'([^']*)'", context["expected_tags"])
        unknown = f"unknown kind '{excerpt(tag)}'; {did_you_mean(tag, expected)}"
        place, says = f"{place}.kind", _unknown_term(tag, expected) if fault["loc"][0] == "terms" else unknown
    elif fault["type"] == "union_tag_not_found":
        says = f"missing key 'kind'; one of {', '.join(kinds)}"
    elif fault["type"] == "literal_error":
        says = f"expected {context['expected']}, found {_found(fault['input'])}"
    else:
        says = f"{_SAYS.get(fault['type'], fault['msg'])}, found {_found(fault['input'])}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{place.lstrip('.')}: {says}{more}" if place else says + more


def _found(value: Any) -> str:
    """A value as Python writes it, cut short."""
    return excerpt(value if isinstance(value, int) else repr(value))


_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def check_strings(data: Mapping[str, Any]) -> None:
    """Refuse a robot file that has neither one tendon nor several, or both."""
    several = data.get("tendons")
    if several == [] and data.get("tendon") is None:
        raise InputError("tendons: is empty; write one [[tendons]] table for each tendon, two at least")
    if several is None or several == () or several == []:
        for key in ("routing", "tendon"):
            if data.get(key) is None:
                raise InputError(f"missing key '{key}'; add for example [{key}]")
        return
    for key in ("routing", "tendon"):
        if data.get(key) is not None:
            raise InputError(
                f"has both '{key}' and 'tendons'; write [tendon] and [routing], or only [[tendons]]"
            )
    if not isinstance(several, list | tuple):
        raise InputError("tendons: expected one [[tendons]] table for each tendon")
    if len(several) == 1:
        raise InputError("tendons: there is only one; write [tendon] and [routing] for one tendon")
    names = [tendon.get("name") for tendon in several if isinstance(tendon, Mapping)]
    for i, name in enumerate(names):
        if isinstance(name, str) and not _NAME.fullmatch(name):
            raise InputError(
                f"tendons[{i}].name: '{name}' cannot end a column's name; take letters, digits, _ and -, "
                "and no digit first"
            )
        if name is not None and name in names[:i]:
            raise InputError(f"tendons[{i}].name: '{name}' stands twice; give each tendon its own name")


def _unknown_term(kind: object, known: Iterable[str]) -> str:
    terms = ", ".join(nearest_first(excerpt(kind), known))
    return f"unknown kind '{excerpt(kind)}'; the terms, nearest first: {terms}"


def check_terms(data: Mapping[str, Any], known: Mapping[str, Term]) -> None:
    """Refuse terms that are no tables, have no kind or an unknown one, or stand twice."""
    terms = data.get("terms", ())
    if not isinstance(terms, list | tuple):
        raise InputError("terms: expected one [[terms]] table for each term")
    seen = set()
    for i, term in enumerate(terms):
        kind = term.get("kind") if isinstance(term, Mapping) else getattr(term, "kind", None)
        if kind is None:
            raise InputError(f"terms[{i}]: missing key 'kind'; one of {', '.join(known)}")
        if not isinstance(kind, str) or kind not in known:
            raise InputError(f"terms[{i}].kind: {_unknown_term(kind, known)}")
        if kind in seen:
            raise InputError(f"terms[{i}].kind: '{kind}' stands twice; keep one")
        seen.add(kind)


def _check_terms(config: RobotConfig, known: Mapping[str, Term]) -> None:
    kinds, rigid = {term.kind for term in config.terms}, config.backbone.rigid
    for term in config.terms:
        law, key = known[term.kind], f"terms.{term.kind}"
        bends = law.bend or law.loads or law.stop
        _require(not (rigid and bends), key, "has no effect on a backbone with rigid = true; remove it")
        moved = not rigid or "tendon-stretch" in kinds
        _require(law.mobilise is None or moved, key, NO_SLIP)
        _require(
            not (rigid and config.tendons and not law.of_cells), key, "is for one tendon where rigid = true"
        )
        _require(
            any(getattr(term, q.name) != q.null for q in law.sizes) or len(law.sizes) == 1,
            key,
            f"has no effect; give one of {', '.join(q.name for q in law.sizes)}",
        )
        wrong = (
            law.fault({q.name: getattr(term, q.name) for q in law.quantities}, config.backbone.length)
            if law.fault
            else ""
        )
        _require(not wrong, key, wrong)
        for q in law.quantities:
            value = getattr(term, q.name)
            low = q.lower is not None and (value < q.lower or (q.log and value == q.lower))
            if low or (q.upper is not None and value > q.upper):
                least = "above" if q.log else "at least"
                bounds = f"{least} {q.lower:g}" if low else f"at most {q.upper:g}"
                raise InputError(f"terms.{term.kind}.{q.name}: must be {bounds}, is {value:g}; correct it")


def check_robot(config: RobotConfig) -> None:
    """Refuse values that no robot can have; InputError naming the key and the remedy."""
    _check_backbone(config.backbone)
    _check_terms(config, REGISTRY)
    for name, tendon, routing in config.strung:
        table, channel = (f"tendons.{name}", f"tendons.{name}.routing") if name else ("tendon", "routing")
        _check_routing(routing, config.backbone.length, channel)
        friction, preload = tendon.friction_coefficient, tendon.preload
        _require(friction >= 0, f"{table}.friction_coefficient", f"cannot be negative, is {friction:g}")
        _require(
            preload >= 0, f"{table}.preload", f"cannot be negative, is {preload:g} N: a tendon only pulls"
        )
    _check_loads(config)


def _require(holds: bool, key: str, says: str) -> None:
    if not holds:
        raise InputError(f"{key}: {says}")


def outer_radius_at(backbone: BackboneConfig, s: np.ndarray | float) -> np.ndarray:
    """Outer radius [m] at arc length s [m], linear from base to tip."""
    return np.asarray(np.interp(s, [0.0, backbone.length], backbone.outer_radius))


def _check_backbone(backbone: BackboneConfig) -> None:
    length = backbone.length
    _check_length(length, "backbone.length")
    for radius in backbone.outer_radius:
        _check_length(radius, "backbone.outer_radius")
    modulus = backbone.youngs_modulus
    given = "youngs_modulus" in backbone.model_fields_set
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
    _require(backbone.density >= 0, "backbone.density", f"cannot be negative, is {backbone.density:g} kg/m^3")
    if isinstance(backbone.natural_curvature, tuple):
        _check_knots("backbone.natural_curvature", backbone.natural_curvature, length)
    _check_bores(backbone)


def _check_length(length: float, key: str) -> None:
    _require(length > 0, key, f"must be positive, is {length:g} m")
    _require(length >= _LEAST_LENGTH, key, f"is {length:g} m, too small to compute with; check the unit")


def _check_bores(backbone: BackboneConfig) -> None:
    length = backbone.length
    for i, bore in enumerate(backbone.bores):
        key = f"backbone.bores[{i}]"
        _require(bore.diameter > 0, f"{key}.diameter", f"must be positive, is {bore.diameter:g} m")
        ends = f"{_mm(bore.from_)} to {_mm(bore.to)}"
        _require(bore.from_ < bore.to, key, f"runs from {ends}; 'from' must lie before 'to'")
        _require(
            bore.from_ >= 0 and bore.to <= length * (1 + _NEAR),
            key,
            f"runs from {ends}, outside the backbone; keep it within 0 mm and {_mm(length)}",
        )
        stations = np.array([bore.from_, bore.to])
        radii = outer_radius_at(backbone, stations)  # linear, so narrowest at one of the ends
        narrowest = int(np.argmin(radii))
        _require(
            bore.diameter < 2 * radii[narrowest],
            f"{key}.diameter",
            f"the bore is {_mm(bore.diameter)} wide and the body {_mm(2 * radii[narrowest])} at "
            f"s = {_mm(stations[narrowest])}; narrow the bore or widen the body",
        )
    order = sorted(range(len(backbone.bores)), key=lambda i: backbone.bores[i].from_)
    for i, j in itertools.pairwise(order):
        end, start = backbone.bores[i].to, backbone.bores[j].from_
        _require(
            start >= end - _NEAR * length,
            f"backbone.bores[{j}]",
            f"starts at {_mm(start)}, before bores[{i}] ends at {_mm(end)}; part the two",
        )


def _check_routing(routing: Any, length: float, table: str) -> None:
    if routing.kind == "straight-sine-straight":
        for key, w in (("w1", routing.w1), ("w2", routing.w2)):
            _require(
                0 <= w <= length * (1 + _NEAR),
                f"{table}.{key}",
                f"{_mm(w)} lies outside the backbone; keep it within 0 mm and {_mm(length)}",
            )
        _require(
            routing.w1 < routing.w2,
            f"{table}.w1",
            f"w1 = {_mm(routing.w1)} must be less than w2 = {_mm(routing.w2)}; swap or move them",
        )
    elif routing.kind == "converging-sine" or routing.kind == "crossing-sine":
        _require(routing.n_sine > 0, f"{table}.n_sine", f"must be positive, is {routing.n_sine:g}")
    elif routing.kind == "table":
        _check_knots(f"{table}.knots", routing.knots, length)


def _check_knots(key: str, knots: tuple[tuple[float, float], ...], length: float) -> None:
    """Knots must be at least two, in increasing s, and cover the backbone from 0 to its length [m]."""
    _require(len(knots) >= 2, key, f"needs at least two knots, has {len(knots)}")
    stations = np.array([s for s, _ in knots])
    back = np.flatnonzero(np.diff(stations) <= 0)
    if back.size:
        i = int(back[0])
        _require(
            False,
            f"{key}[{i + 1}]",
            f"s = {_mm(stations[i + 1])} follows {_mm(stations[i])}; s must increase",
        )
    _require(
        stations[0] <= _NEAR * length and stations[-1] >= length * (1 - _NEAR),
        key,
        f"knots span {_mm(stations[0])} to {_mm(stations[-1])}; they must cover 0 mm to {_mm(length)}",
    )


def _check_loads(config: RobotConfig) -> None:
    loads = config.loads
    _require(
        loads.gravity_angle is None or config.backbone.rigid or config.backbone.density > 0,
        "backbone",
        "missing key 'density', which gravity_angle needs; add for example density = \"1070 kg/m^3\"",
    )
    _require(loads.payload >= 0, "loads.payload", f"cannot be negative, is {loads.payload:g} kg")
    _require(
        loads.payload == 0 or loads.gravity_angle is not None,
        "loads.payload",
        'needs the direction of gravity to weigh; add for example gravity_angle = "-90 deg"',
    )
    acting = {
        "gravity_angle": loads.gravity_angle is not None,
        "tip_force": any(loads.tip_force),
        "tip_moment": loads.tip_moment != 0,
    }
    for key, acts in acting.items():
        _require(
            not (acts and config.backbone.rigid),
            f"loads.{key}",
            "has no effect on a backbone with rigid = true; remove one of the two",
        )


def check_channel(
    config: RobotConfig,
    offset: Callable[[np.ndarray], np.ndarray],
    *,
    tendon: str | None = None,
    points: int = 2001,
) -> None:
    """Refuse a tendon channel that leaves the body.

    Args:
        config: the robot.
        offset: the channel's offset R [m] from the backbone at each arc length s [m] of an array.
        tendon: name of the tendon, if the robot has several.
        points: places along the backbone to look at, besides the knots or junctions of the routing.

    Raises InputError naming the file, the place s where the channel is farthest outside, and the remedy.
    """
    length = config.backbone.length
    routing = next(channel for name, _, channel in config.strung if name == (tendon or ""))
    table = f"tendons.{tendon}.routing" if tendon else "routing"
    special: list[float] = []
    if routing.kind == "straight-sine-straight":
        special = [routing.w1, routing.w2]
    elif routing.kind == "table":
        special = [s for s, _ in routing.knots]
    s = np.union1d(np.linspace(0.0, length, points), np.clip(special, 0.0, length))
    reach = np.abs(np.asarray(offset(s), dtype=np.float64))
    radius = outer_radius_at(config.backbone, s)
    if not np.all(np.isfinite(reach)):
        raise InputError(f"{config.source}: {table}: the channel has no finite offset; check its values")
    worst = int(np.argmax(reach - radius))
    if reach[worst] >= radius[worst]:
        raise InputError(
            f"{config.source}: {table}: the tendon leaves the body at s = {_mm(s[worst])}, where it runs "
            f"{_mm(reach[worst])} from the axis and the outer radius is {_mm(radius[worst])}; "
            "bring the channel inside or widen the body"
        )


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g} mm"
