"""A robot in space: twist and two bendings at each node.

The section's frame D turns with the strain u, D' = D [u]x. Over an interval it turns by the rotation of the
vector Omega = integral of u + h^2/12 (u_before x u), the Magnus expansion to order four. In the section's
axes the channel runs along w = e1 + u x r + r', its metric factor is nu = |w|, its direction t = w/nu, which
turns in space at the rate v = t' + u x t.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np

from ..terms.term import Bent
from .geometry import Geometry
from .mesh import along_nodes, increments
from .vector import (
    Stretched,
    Vector,
    applied,
    columns_of,
    cross,
    dot,
    inverse,
    joined,
    length_of,
    parts,
    stretched,
)

TURNED_BACK = 1e-12  # 1 + cosine of the angle of a corner at which the tendon turns back
SMALLEST_TURN = 1e-14  # rad; below it the plane of a turn is that of rounding
# tan(a/2)/(a/2) in powers of a^2
HALF_TANGENT = (1.0, 1 / 12, 1 / 120, 17 / 20160, 31 / 362880, 691 / 79833600)
BROYDEN_STEPS = 3  # per node; they reach rounding at the default mesh
BROYDEN_STRETCHING = 5  # the same, of a body that stretches
LEAST_SHARE = 0.2  # of a Broyden step's correction: least denominator


def _arctangent() -> tuple[float, ...]:
    """Coefficients of arctan(x)/x in powers of x^2, up to tan(pi/8), to rounding."""

    def ratio(square):
        x = np.sqrt(square)
        return np.where(x > 0, np.arctan(x) / np.where(x > 0, x, 1.0), 1.0)

    fitted = np.polynomial.Chebyshev.interpolate(ratio, 11, domain=[0.0, np.tan(np.pi / 8) ** 2])
    return tuple(float(c) for c in fitted.convert(kind=np.polynomial.Polynomial).coef)


ARCTANGENT = _arctangent()


def rotation(vector):
    """Rows of the rotation about a vector by its length [rad], to the eleventh power of it. Cayley's map: a
    rotation for any vector, and smooth at zero.
    """
    x, y, z = vector * (0.5 * _polynomial(HALF_TANGENT, dot(vector, vector)))
    scale = 2.0 / (1.0 + x * x + y * y + z * z)
    xx, yy, zz, xy, xz, yz = (scale * c for c in (x * x, y * y, z * z, x * y, x * z, y * z))
    x, y, z = scale * x, scale * y, scale * z
    return (
        Vector(1.0 - yy - zz, xy - z, xz + y),
        Vector(xy + z, 1.0 - xx - zz, yz - x),
        Vector(xz - y, yz + x, 1.0 - xx - yy),
    )


def _polynomial(coefficients, x):
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + x * total
    return total


def _length(square):
    """Square root, with derivative 0 at 0."""
    there = square > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), 0.0)


def _positive(value, otherwise=1.0):
    return jnp.where(value > 0, value, otherwise)


def angle_of(sine, cosine):
    """The angle in [0, pi) of a sine and a cosine [rad], by halving it three times: arctan2 would call a
    library, which keeps XLA from computing several lanes at once.
    """
    twice = 1.0 + cosine
    half = jnp.sqrt(0.5 * jnp.where(twice > TURNED_BACK, twice, TURNED_BACK))
    quarter = jnp.sqrt(0.5 + 0.5 * half)
    tangent = sine / (4.0 * half * quarter * (1.0 + quarter))
    return 8.0 * tangent * _polynomial(ARCTANGENT, tangent * tangent)


def _along(strain, R):
    """Components of strain and offset at the tendons: those of the strain broadcast to them."""
    offsets = tuple((r[..., 0], r[..., 1]) for r in R)
    return _spread(parts(strain), offsets[0][0].shape), offsets


def _spread(vector, shape):
    return jtu.tree_map(lambda c: jnp.broadcast_to(c, shape), vector)


def course_of(u, r):
    """w = e1 + u x r + r', which the channel runs along, and its length nu."""
    (y, z), (dy, dz), _ = r
    w = Vector(length_of(u) + u.y * z - u.z * y, dy - u.x * z, dz + u.x * y)
    return w, jnp.sqrt(dot(w, w))


def _sweep(u, du, r):
    """Direction t of the channel in the section's axes, and the rate v at which it turns in space, for a
    strain u that changes at the rate du.
    """
    (y, z), (dy, dz), (ddy, ddz) = r
    w, nu = course_of(u, r)
    change = cross(u, w) + Vector(du.y * z - du.z * y, ddy - du.x * z, ddz + du.x * y)
    change = change + Vector(u.y * dz - u.z * dy, -u.x * dz, u.x * dy)
    if isinstance(du, Stretched):
        change = change + Vector(du.e, 0.0, 0.0)
    each = 1.0 / nu
    t, change = w * each, change * each
    return t, change - t * dot(t, change)


def _arms(u, r):
    """Moment of a unit of tension on the section, m = -(r x t), and nu."""
    (y, z), _, _ = r
    w, nu = course_of(u, r)
    each = 1.0 / nu
    return Vector((z * w.y - y * w.z) * each, -z * w.x * each, y * w.x * each), nu


def _detour(v, v_before):
    """Length of the path of a point whose velocity changes linearly, less that of its chord, over the time.

    With n the two speeds, S their sum, beta the change of velocity and x = beta/S, the length is S/4 (1 + e +
    (1 - e) F), e = (change of n)^2/beta^2, F = (1 - x^2) artanh(x)/x, of which the polynomial below has the
    first three terms and the value 0 at x = 1: exact for velocities along a line.
    """
    change, middle = v - v_before, v + v_before
    speed, before = _length(dot(v, v)), _length(dot(v_before, v_before))
    total, square = speed + before, dot(change, change)
    e = (speed - before) ** 2 / _positive(square)
    x = square / _positive(total) ** 2
    course = 1.0 - x * (2 / 3 + x * (2 / 15 + x * 0.2))
    return 0.25 * total * (1.0 + e + (1.0 - e) * course) - 0.5 * _length(dot(middle, middle))


def _over(values, tension):
    """Sum over the tendons of a node."""
    return jtu.tree_map(lambda v: jnp.sum(v, axis=0), values) if jnp.ndim(tension) else values


class Space(Geometry):
    """Strain a `Vector`, direction the rows of the rotation of the section's frame. Arrays hold them along
    their last axis, or their last two.
    """

    steps = BROYDEN_STEPS

    def split(self, values):
        return parts(values)

    def join(self, values):
        return joined(values)

    def join_direction(self, direction):
        return jnp.stack([joined(row) for row in direction], axis=-2)

    def split_direction(self, direction):
        return tuple(parts(direction[..., i, :]) for i in range(3))

    def zero(self):
        return Vector(*jnp.zeros(3))

    def unstrained(self):
        return self.zero()

    def start(self):
        return tuple(Vector(*row) for row in jnp.eye(3))

    def turn(self, step, strain, before, length):
        twist = cross(parts(before), parts(strain))
        return rotation(parts(step) + twist * (length * length / 12.0))

    def onward(self, direction, turn):
        columns = columns_of(turn)
        return tuple(Vector(*(dot(row, column) for column in columns)) for row in direction)

    def directions(self, weights, interval, strain):
        before = jnp.concatenate([strain[:1], strain[:-1]])
        turns = self.turn(along_nodes(increments, weights, strain), strain, before, interval.length)

        def node(direction, turn):
            direction = self.onward(direction, turn)
            return direction, direction

        return self.join_direction(jax.lax.scan(node, self.start(), turns)[1])

    def wrap(self, turn, strain, before, rates, R, R_before, between):
        u, r = _along(strain, R)
        u_before, r_before = _along(before, R_before)
        turn, length, joints = _spread((turn, between.length, between.joined), u.x.shape)
        du, du_before = (_spread(parts(rate), u.x.shape) for rate in rates)
        t, v = _sweep(u, du, r)
        t_before, v_before = _sweep(u_before, du_before, r_before)
        t, v = applied(turn, t), applied(turn, v)
        # The velocity at the node, carried back along the great circle between the two directions.
        cosine = dot(t, t_before)
        twice = jnp.where(cosine > TURNED_BACK - 1.0, 1.0 + cosine, 1.0)
        v = v - (t + t_before) * (dot(t_before, v) / twice)
        axis = cross(t_before, t)
        sine = dot(axis, axis)
        turned = sine > SMALLEST_TURN**2
        # Where nothing turns, the plane of the turn is the one it takes as the body moves.
        opening = cross(t_before, v + v_before)
        still = dot(axis, opening) / _positive(_length(dot(opening, opening)))
        size = jnp.where(turned, jnp.sqrt(jnp.where(turned, sine, 1.0)), still)
        return joints * (angle_of(size, cosine) + length * _detour(v, v_before))

    def course(self, strain, R):
        """w, along which the channels run, in the axes of the section, (..., 3)."""
        return joined(course_of(*_along(strain, R))[0])

    def bend(self, strain, rate, R):
        """Curvature of the channels in space [1/m], for a strain that changes at a rate [1/m^2]."""
        u, r = _along(strain, R)
        _, v = _sweep(u, _spread(parts(rate), u.x.shape), r)
        return _length(dot(v, v)) / course_of(u, r)[1]

    def metric(self, strain, R):
        return course_of(*_along(strain, R))[1]

    def pull(self, tension, strain, R):
        return _over(_arms(*_along(strain, R))[0] * tension, tension)

    def give(self, compliance, strain, R):
        u, r = _along(strain, R)
        arms, _ = _arms(u, r)
        return dot(_spread(parts(compliance), u.x.shape), arms * arms)

    def moment_slope(self, direction, force):
        return cross(force, self.line(direction))

    def felt(self, direction, moment):
        return applied(columns_of(direction), moment)

    def inner(self, one, other):
        return dot(one, other)

    def bent(self, term, values, strain, at):
        assert term.bend_in_space is not None
        rest, before, kept, compliance = map(tuple, (at.rest, at.before, at.kept, at.compliance))
        at = Bent(rest, before, kept, at.dt, compliance, at.reach, at.place)
        extra, kept = term.bend_in_space(values, tuple(strain), at)
        return Vector(*extra), Vector(*kept)

    def way_of(self, term, values):
        assert term.stop_normal is not None
        return Vector(*term.stop_normal(values))

    def components(self, way):
        return tuple(way)

    def advance(self, direction, way):
        return dot(self.line(direction), way)

    def lever(self, direction, force, length):
        turned = cross(self.line(self.split_direction(direction)), force)
        return jnp.stack([jnp.sum(length * c) for c in turned])

    def line(self, direction):
        return Vector(*(row.x for row in direction))

    def stretch(self, strain, shift):
        return None

    def pushed(self, pulls, direction, force, shift):
        return pulls

    def slackened(self, start, rest, compliance, tension, moment, R):
        strain = start
        for _ in range(2):
            error = strain - rest - compliance * (self.pull(tension, strain, R) + moment)
            strain = strain - self.through(inverse(self.near(compliance, tension, strain, R)), error)
        return strain

    def through(self, slope, error):
        """The step that an approximate inverse of the slope makes of an error."""
        return applied(slope, error)

    def near(self, compliance, tension, strain, R):
        u, r = _along(strain, R)
        (y, z), _, _ = r
        m, nu = _arms(u, r)
        # By Pythagoras the derivative of the moment arm is -(G - m m')/nu, with the squares G of the offset.
        force = tension / nu
        xx, yy, zz, yz = (
            force * c
            for c in (y * y + z * z - m.x * m.x, z * z - m.y * m.y, y * y - m.z * m.z, -y * z - m.y * m.z)
        )
        xy, xz = -force * m.x * m.y, -force * m.x * m.z
        xx, yy, zz, yz, xy, xz = _over((xx, yy, zz, yz, xy, xz), tension)
        c = compliance
        return (
            Vector(1.0 + c.x * xx, c.x * xy, c.x * xz),
            Vector(c.y * xy, 1.0 + c.y * yy, c.y * yz),
            Vector(c.z * xz, c.z * yz, 1.0 + c.z * zz),
        )

    def root(self, residual, guess, near, steps, flattest, stopped, first):
        # Broyden's method from the derivative in which tensions stay: what that leaves out is small, of the
        # order of the interval, and nearly of rank one.
        slope = inverse(near(guess))
        strain, taken = guess, []
        for _ in range(max(self.steps, steps)):
            step = -self.through(slope, residual(strain))
            for one, after in itertools.pairwise(taken):
                step = step + after * (self.inner(one, step) / _positive(self.inner(one, one)))
            if taken:
                last = self.inner(taken[-1], taken[-1])
                left = 1.0 - self.inner(taken[-1], step) / _positive(last)
                step = step * (1.0 / jnp.where(left > LEAST_SHARE, left, LEAST_SHARE))
            strain = strain + step
            taken.append(step)
        return strain

    def slope(self, residual, strain):
        error, along = jax.linearize(residual, strain)
        rows = jax.vmap(along)(Vector(*jnp.eye(3)))
        return error, tuple(Vector(*row) for row in rows)

    def bending_slope(self, law, strain):
        return self.slope(law, strain)[1]

    def quotient(self, change, slope):
        return applied(inverse(slope), change)


class Stretching(Space):
    """Strain a `Stretched`: the axis of the body is stretched or shortened by the force along it,

        EA e = t . n_ext - (sum of T t_x),

    and a channel runs along w = (1 + e) e1 + u x r + r'.
    """

    steps = BROYDEN_STRETCHING

    def unstrained(self):
        return Stretched(*jnp.zeros(4))

    def pull(self, tension, strain, R):
        u, r = _along(strain, R)
        w, nu = course_of(u, r)
        turning = super().pull(tension, strain, R)
        return stretched(turning, _over(-tension * w.x / nu, tension))

    def pushed(self, pulls, direction, force, shift):
        return stretched(pulls, pulls.e + dot(self.line(direction), force))

    def stretch(self, strain, shift):
        return 1.0 + parts(strain).e

    def give(self, compliance, strain, R):
        u, r = _along(strain, R)
        w, nu = course_of(u, r)
        return super().give(compliance, strain, R) + parts(compliance).e * (w.x / nu) ** 2

    def inner(self, one, other):
        both = isinstance(one, Stretched) and isinstance(other, Stretched)
        return dot(one, other) + (one.e * other.e if both else 0.0)

    def through(self, slope, error):
        # The stretch and the others hardly depend on one another, and the search corrects for that.
        return stretched(applied(slope, error), error.e)

    def slope(self, residual, strain):
        error, along = jax.linearize(residual, strain)
        by = jax.vmap(along)(Stretched(*jnp.eye(4)))
        return error, tuple(Stretched(*row) for row in (*by, by.e))

    def bending_slope(self, law, strain):
        _, along = jax.linearize(law, strain)
        rows = jax.vmap(along)(Stretched(*jnp.eye(3, 4).T))
        return tuple(Vector(*row) for row in rows)

    def quotient(self, change, slope):
        *bent, last = slope
        within = inverse(tuple(Vector(*row) for row in bent))
        across = applied(within, Vector(*(row.e for row in bent)))
        own = applied(within, change)
        e = (change.e - dot(last, own)) / (last.e - dot(last, across))
        return stretched(own - across * e, e)


SPACE, STRETCHING = Space(), Stretching()
