"""How a robot file is written: keys, names and kinds, and the one line that says what is wrong with them."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from gtr_jax.errors import InputError, did_you_mean, excerpt, nearest_first
from gtr_jax.terms import REGISTRY

LAW = "law"  # the kind of term whose equation the file states
KINDS = (*REGISTRY, LAW)

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


def check_keys(section: type[BaseModel], data: Any) -> None:
    """Refuse a section that is not a table, has a key it does not know, or lacks one it needs."""
    if not isinstance(data, Mapping):
        raise InputError(f"expected a table of keys and values, found {_found(data)}")
    keys = {field.alias or name: field for name, field in section.model_fields.items()}
    for key in data:
        if key not in keys and section.model_config.get("extra") != "allow":
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


def one_line(error: ValidationError, kinds: Mapping[str, Collection[str]]) -> str:
    """The first fault of a pydantic error as "key: what; remedy". `kinds` are the names that `kind` may
    have, by the table that has it.
    """
    faults = error.errors()
    fault = faults[0]
    place = ""
    for i, part in enumerate(fault["loc"]):
        before = fault["loc"][i - 1] if i else None
        tag = str(part).startswith("#") or part in kinds.get(str(before), ())
        tag = tag or (fault["loc"][0] == "terms" and isinstance(before, int) and part in KINDS)
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
        says = f"missing key 'kind'; one of {', '.join(kinds.get(str(fault['loc'][-1]), ()))}"
    elif fault["type"] == "literal_error":
        says = f"expected {context['expected']}, found {_found(fault['input'])}"
    elif 0 in (context.get("gt"), context.get("ge")):
        bound = "must be positive" if "gt" in context else "cannot be negative"
        says = f"{bound}, is {excerpt(fault['input'])}"
    else:
        says = f"{_SAYS.get(fault['type'], fault['msg'])}, found {_found(fault['input'])}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{place.lstrip('.')}: {says}{more}" if place else says + more


def _found(value: Any) -> str:
    """A value as Python writes it, cut short."""
    return excerpt(value if isinstance(value, int) else repr(value))


_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def with_one_tendon(data: dict[str, Any]) -> dict[str, Any]:
    """The contents of a robot file in which a lone [[tendons]] table has given way to [tendon] and [routing];
    so have its keys under [uncertainty], and the tendon that a term names.
    """
    several = data.get("tendons")
    if not isinstance(several, list | tuple) or len(several) != 1 or not isinstance(several[0], Mapping):
        return data
    tendon = dict(several[0])
    name, routing = tendon.pop("name", None), tendon.pop("routing", None)
    before = f"tendons.{name}."

    def key_of(key: str) -> str:
        own = key.removeprefix(before)
        return key if own == key else own if own.startswith("routing.") else f"tendon.{own}"

    found = {key: value for key, value in data.items() if key != "tendons"}
    found |= {"tendon": tendon} if routing is None else {"tendon": tendon, "routing": routing}
    if isinstance(said := data.get("uncertainty"), Mapping):
        found["uncertainty"] = {key_of(str(key)): value for key, value in said.items()}
    if isinstance(terms := data.get("terms"), list | tuple):
        found["terms"] = [
            {key: value for key, value in term.items() if key != "tendon" or value != name}
            if isinstance(term, Mapping)
            else term
            for term in terms
        ]
    return found


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
    names = [tendon.get("name") for tendon in several if isinstance(tendon, Mapping)]
    for i, name in enumerate(names):
        if isinstance(name, str) and not _NAME.fullmatch(name):
            raise InputError(
                f"tendons[{i}].name: '{name}' cannot end a column's name; take letters, digits, _ and -, "
                "and no digit first"
            )
        if name is not None and name in names[:i]:
            raise InputError(f"tendons[{i}].name: '{name}' is given twice; give each tendon its own name")


def _unknown_term(kind: object, known: Iterable[str]) -> str:
    terms = ", ".join(nearest_first(excerpt(kind), known))
    return f"unknown kind '{excerpt(kind)}'; the terms, nearest first: {terms}"


def check_terms(data: Mapping[str, Any], known: Iterable[str]) -> None:
    """Refuse terms that are not tables, have no kind or an unknown one, or are given twice.

    Args:
        data: the robot file.
        known: kinds of terms.
    """
    terms = data.get("terms", ())
    if not isinstance(terms, list | tuple):
        raise InputError("terms: expected one [[terms]] table for each term")
    known, seen = [*known], {}
    for i, term in enumerate(terms):
        kind = term.get("kind") if isinstance(term, Mapping) else getattr(term, "kind", None)
        if kind is None:
            raise InputError(f"terms[{i}]: missing key 'kind'; one of {', '.join(known)}")
        if not isinstance(kind, str) or kind not in known:
            raise InputError(f"terms[{i}].kind: {_unknown_term(kind, known)}")
        name = kind
        if kind == LAW:
            name = term.get("name", LAW) if isinstance(term, Mapping) else getattr(term, "id", LAW)
        tendon = term.get("tendon") if isinstance(term, Mapping) else getattr(term, "tendon", None)
        before = seen.setdefault(str(name), [])
        if tendon in before or (before and (tendon is None or None in before or kind == LAW)):
            key, remedy = ("name", "give each law its own name") if kind == LAW else ("kind", "remove one")
            if kind != LAW and (tendon is not None or None not in before):
                remedy = f"{remedy}, or give each a tendon of its own"
            raise InputError(f"terms[{i}].{key}: '{excerpt(name)}' is given twice; {remedy}")
        before.append(tendon)
