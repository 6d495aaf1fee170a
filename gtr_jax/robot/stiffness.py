"""How stiff a body is against bending, however its file says so: by modulus and section, by EI, by rows of
EI, or by pieces that differ.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from .backbone import Backbone
from .clearance import place_in_section
from .parameters import STIFFNESS, parameters_of
from .parts import Parts, Tendon

WHOLE = ("E", "stiffness_factor")  # each of which says it alone
STATIONS = 101  # places along the body at which a mean is taken


def stiffness_of(robot: Parts) -> list[str]:
    """Names of the numbers that say how stiff the whole body is: its modulus; else the factor on the several
    numbers that give its stiffness; else its bending stiffness, or both of them; none of a rigid body.
    """
    body = robot.backbone
    known = [] if body.rigid else [name for name in STIFFNESS if name in parameters_of(robot)]
    own = [p for p in body.pieces if p.youngs_modulus is not None or p.stiffness is not None]
    if sum(float(p.end - p.start) for p in own) >= (1 - 1e-9) * float(body.length):
        known = [name for name in known if name != "E"]  # which acts nowhere
    whole = [name for name in known if name in WHOLE]
    return whole[:1] or known


def largest_modulus(body: Backbone) -> float:
    """Largest modulus [Pa] along a body: of one that is given by its bending stiffness, that of a full
    section as stiff, which is no more than that of its stiffest part.
    """
    s, uncut = _stations(body)
    return float(jnp.max(body.stiffnesses(s, uncut)[2] / body.second_moments(s, uncut)[1]))


def strain_per_tension(robot: Parts, tendon: Tendon) -> float:
    """Strain of the outermost fibre per tension of a tendon [1/N], R r/(EI), its mean along the body. Without
    bores and notches, which only soften the body; 0 of a rigid one.
    """
    body = robot.backbone
    if body.rigid:
        return 0.0
    s, uncut = _stations(body)
    across, up = place_in_section(tendon, np.asarray(s), float(body.length)).T
    _, about_y, about_z = (np.asarray(value) for value in body.stiffnesses(s, uncut))
    fibre = np.asarray(body.radius(s) if body.shape is None else body.shape.reach())
    return float(np.mean(np.hypot(across / about_z, up / about_y) * fibre))


def _stations(body: Backbone) -> tuple[jnp.ndarray, jnp.ndarray]:
    """Places along a body [m], and which pieces each lies in, as `Backbone.stiffnesses` wants it, as if no
    bore and no notch were there.
    """
    s = jnp.linspace(0.0, body.length, STATIONS)
    bores, notches = (
        jnp.zeros((ends.shape[0], STATIONS), bool) for ends in (body.bore_start, body.notch_start)
    )
    pieces = [((piece.start <= s) & (s <= piece.end))[None] for piece in body.pieces]
    return s, jnp.concatenate([bores, *pieces, notches])
