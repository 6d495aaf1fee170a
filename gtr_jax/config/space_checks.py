"""What can be wrong with what only robots in space have: bases, guides, drives, tendons that end early."""

from __future__ import annotations

from typing import Any

import numpy as np

from gtr_jax.errors import InputError
from gtr_jax.terms import Term
from gtr_jax.terms.term import ONE_HELD, UNMOVED

from .checks import mm
from .robot_tables import RobotTables
from .sections import RectangleConfig, TendonConfig

_NEAR = 1e-9


def check_space(config: RobotTables, leaves_plane: str | None) -> None:
    """Refuse values that no robot in space can have; InputError naming the key and the remedy.

    Args:
        config: the robot file.
        leaves_plane: the key by which the robot leaves its plane, or None.
    """
    turned = float(np.linalg.norm(config.base.rotation))
    if turned > 2 * np.pi * (1 + _NEAR):
        raise InputError(
            f"base.rotation: a rotation vector of {np.degrees(turned):.4g} deg is more than a full "
            "turn; give the axis times the angle, at most 360 deg"
        )
    stretching = {term.kind for term in config.terms if getattr(term, "compliance", 0.0)}
    for name, tendon, _ in config.strung:
        table = f"tendons.{name}" if name else "tendon"
        _check_tendon(table, tendon, config.backbone.length, stretching)
    if leaves_plane is not None and config.backbone.notches:
        raise InputError(
            f"backbone.notches: are computed in the plane, which '{leaves_plane}' leaves; remove "
            "one of the two"
        )
    if leaves_plane is not None:
        _check_twist(config)
        _check_terms(config)


def _check_tendon(table: str, tendon: TendonConfig, length: float, terms: set[str]) -> None:
    end = length if tendon.to is None else tendon.to
    if not 0 < end <= length * (1 + _NEAR):
        raise InputError(
            f"{table}.to: {mm(end)} lies outside the backbone; keep it above 0 mm and at most {mm(length)}"
        )
    back = np.flatnonzero(np.diff([0.0, *tendon.guides]) <= 0)
    if back.size:
        i = int(back[0])
        before = mm(tendon.guides[i - 1]) if i else "the base"
        raise InputError(
            f"{table}.guides[{i}]: {mm(tendon.guides[i])} does not lie beyond {before}; give arc lengths "
            "that increase, the base's entry left out"
        )
    if tendon.guides and tendon.guides[-1] > end * (1 + _NEAR):
        raise InputError(
            f"{table}.guides: the last at {mm(tendon.guides[-1])} lies beyond the tendon's end at "
            f"{mm(end)}; leave it out"
        )
    if tendon.axial_stiffness is not None and tendon.axial_stiffness <= 0:
        raise InputError(f"{table}.axial_stiffness: must be positive, is {tendon.axial_stiffness:g} N")
    if tendon.free_length < 0:
        raise InputError(f"{table}.free_length: cannot be negative, is {mm(tendon.free_length)}")
    if tendon.free_length and tendon.axial_stiffness is None:
        raise InputError(
            f"{table}.free_length: has no effect without axial_stiffness; add for example axial_stiffness = "
            '"5 kN"'
        )
    for key, value, kind in (
        ("axial_stiffness", tendon.axial_stiffness, "tendon-stretch"),
        ("free_length", tendon.free_length, "free-length"),
    ):
        if value and kind in terms:
            raise InputError(f"{table}.{key}: says what terms.{kind}.compliance says; keep one of the two")


def _check_terms(config: RobotTables) -> None:
    for term in config.terms:
        fault = refused_in_space(config, config.catalogue[term.id])
        if fault:
            raise InputError(f"terms.{term.id}: {fault}")


def refused_in_space(config: RobotTables, term: Term) -> str | None:
    """Why a robot in space cannot have a physics term, with the remedy; None if it can."""
    if config.tendons and (term.stop or term.relaxes):
        return ONE_HELD
    if term.not_in_space:
        return term.not_in_space
    section = config.backbone.section
    if term.round_only and isinstance(section, RectangleConfig) and section.height != section.width:
        return "is for sections that are as stiff in every direction; give a tube instead of a rectangle"
    if term.round_only and any(_two(bending) for _, bending, _ in _stiffnesses(config)):
        return "is for sections that are as stiff in every direction; give one bending_stiffness, not two"
    drawn = any(tendon.drive == "displacement" for _, tendon, _ in config.strung)
    return UNMOVED if drawn and term.tugged else None


def _stiffnesses(config: RobotTables) -> list[tuple[str, Any, Any]]:
    """Key, bending and torsional stiffness of the backbone and of each piece."""
    body = config.backbone
    pieces = [(f"backbone.sections[{i}]", piece) for i, piece in enumerate(body.sections)]
    return [
        (key, own.bending_stiffness, own.torsional_stiffness) for key, own in [("backbone", body), *pieces]
    ]


def _check_twist(config: RobotTables) -> None:
    for key, bending, torsion in _stiffnesses(config):
        if torsion is None and _two(bending):
            raise InputError(
                f"{key}: missing key 'torsional_stiffness': a section with two bending stiffnesses is not "
                'round; add for example torsional_stiffness = "0.01 N m^2"'
            )


def _two(bending: object) -> bool:
    """Whether a stiffness differs between the two directions anywhere."""
    if not isinstance(bending, tuple):
        return False
    if isinstance(bending[0], tuple):
        return any(len(row) == 3 and row[1] != row[2] for row in bending)
    return bending[0] != bending[1]
