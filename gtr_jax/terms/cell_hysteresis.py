"""A load cell is hysteretic."""

import functools
import itertools

import jax
import jax.numpy as jnp

from .term import APART, Quantity, Term, spread_out
from .tried import SIZES, At, Rig, Start, Tried, Variant

# Decades between the widths of elements that fits start from.
SPREAD = 0.2

# Which of the elements have given way by the end of a change: every choice.
GAVE_WAY = tuple(itertools.product((False, True), repeat=len(APART)))


def _clipped(z):
    return jnp.where(z >= 1.0, 1.0, jnp.where(z <= -1.0, -1.0, z))


def _on(zs, change, over):
    return tuple(_clipped(z + change / own) for z, own in zip(zs, over, strict=True))


def _mean(zs):
    return sum(zs[1:], zs[0]) / len(zs)


def _steepest(over):
    """How fast the elements build up at most, per newton."""
    return _mean([1.0 / own for own in over])


def _relaxed(T):
    return (jnp.zeros_like(T),) * len(APART)


def lagging(force, width, spread, T):
    """Reading of a cell that holds back up to `force` after each reversal; it starts relaxed."""
    over = spread_out(width, spread)

    def step(carry, now):
        zs, before = carry
        zs = _on(zs, now - before, over)
        return (zs, now), now - force * _mean(zs)

    return jax.lax.scan(step, (_relaxed(T[0]), T[0]), T)[1]


def leading(force, width, spread, shown):
    """The tension behind what `lagging` shows; NaN for a cell that would show less of more tension."""
    over = spread_out(width, spread)
    each, rises = force / len(APART), force * _steepest(over) < 1.0

    def step(carry, y):
        zs, before = carry
        rise = y - (before - force * _mean(zs))
        way = jnp.where(rise < 0, -1.0, 1.0)
        # How far each element goes on in this direction, in its widths. What the cell shows is convex in the
        # change and made of straight pieces, one for each choice of elements that give way, so that the
        # change is the least of those which the pieces give.
        left = [1.0 - way * z for z in zs]
        pieces = []
        for gave_way in GAVE_WAY:
            held = sum(z for z, gave in zip(left, gave_way, strict=True) if gave)
            slope = 1.0 - each * sum(1.0 / own for own, gave in zip(over, gave_way, strict=True) if not gave)
            pieces.append((way * rise + each * held) / jnp.where(rises, slope, 1.0))
        found = functools.reduce(lambda least, piece: jnp.where(piece < least, piece, least), pieces)
        # The tension from what the elements hold has the right slopes also where all pieces are one.
        zs = _on(zs, way * found, over)
        now = jnp.where(rises, y + force * _mean(zs), jnp.nan)
        return (zs, now), now

    return jax.lax.scan(step, (_relaxed(shown[0]), shown[0]), shown)[1]


def fault(values, length):
    """Why no cell can have these numbers; empty if one can."""
    over = spread_out(values["width"], values["spread"])
    if max(values["tip"], values["base"]) * _steepest(over) < 1.0:
        return ""
    wide = "" if values["spread"] == 0 else ", the more the larger the spread"
    return f"width must exceed the forces{wide}"


def starts_spread(at: At, rig: Rig) -> list[Start]:
    """Of several widths. A cell whose elements build up too steeply would show less of more tension."""
    force, width, spread = at
    found = [
        {force: at[force](size), width: at[width](x), spread: SPREAD} for size in SIZES for x in (-0.4, 0.9)
    ]
    return [start for start in found if not fault({"tip": 0.0, "base": 0.0} | start, rig.length)]


TERM = Term(
    id="cell-hysteresis",
    place=600,
    says="A load cell lags behind the tension by a force after each reversal, at any rate.",
    law="shown = T − force·mean(z_j), z_j = clip(z_j + dT/w_j, ±1), "
    "w_j = width·10^(spread·(−3/2, −1/2, 1/2, 3/2)), for each cell its own force",
    seen="Reversals are rounded and the loop is wider by the same force at every tension.",
    told_apart="Load the cell alone, up and down; swap the cells.",
    source="Maxwell-slip (Prandtl) elements; of one width: one element",
    quantities=(
        Quantity("tip", "N", 0.0, 0.2, "Force that the cell at the tip holds back.", (0.02, 1.0), 0.0),
        Quantity("base", "N", 0.0, 0.2, "Force that the cell at the base holds back.", (0.02, 1.0), 0.0),
        Quantity(
            "width",
            "N",
            2.0,
            2.0,
            "Change of tension over which it builds up, of both cells; more than the forces.",
            (0.3, 10.0),
            0.0,
            log=True,
            size=False,
        ),
        Quantity(
            "spread",
            "dimensionless",
            0.0,
            0.0,
            "Decades between the widths of elements that follow one another, of both cells; 0 for one width.",
            (0.05, 0.4),
            0.0,
            1.0,
            size=False,
        ),
    ),
    fault=fault,
    tip=lambda p, T, at: lagging(p["tip"], p["width"], p["spread"], T),
    base=lambda p, T, at: lagging(p["base"], p["width"], p["spread"], T),
    true_base=lambda p, shown, at: leading(p["base"], p["width"], p["spread"], shown),
    tried=Tried(
        variants=(
            Variant("tip", ("tip", "width")),
            Variant("base", ("base", "width")),
            Variant("tip-spread", ("tip", "width", "spread"), starts=starts_spread),
            Variant("base-spread", ("base", "width", "spread"), starts=starts_spread),
        )
    ),
)
