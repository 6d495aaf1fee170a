"""A robot in the plane: one curvature at each node."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from . import channel
from .geometry import Geometry
from .mesh import cumulative
from .sections import at_tendons, moment_slope, over_tendons


class Plane(Geometry):
    """Strain kappa, direction phi; see `channel` for what the tendon does."""

    def split(self, values):
        return values

    def join(self, values):
        return values

    def split_direction(self, direction):
        return direction

    def join_direction(self, direction):
        return direction

    def zero(self):
        return jnp.zeros(())

    def unstrained(self):
        return self.zero()

    def start(self):
        return jnp.zeros(())

    def turn(self, step, strain, before, length):
        return step

    def onward(self, direction, turn):
        return direction + turn

    def directions(self, weights, interval, strain):
        return cumulative(weights, strain)

    def wrap(self, turn, strain, before, rates, R, R_before, between):
        midline = at_tendons((turn, strain, before), R)
        return channel.wrap_increment(*midline, R, R_before, at_tendons(between, R))

    def metric(self, strain, R):
        return channel.metric_factor(at_tendons(strain, R), R)

    def pull(self, tension, strain, R):
        return over_tendons(tension * channel.moment_arm(at_tendons(strain, R), R), 0)

    def give(self, compliance, strain, R):
        return compliance * channel.moment_arm(strain, R) ** 2

    def moment_slope(self, direction, force):
        return moment_slope(direction, *force)

    def felt(self, direction, moment):
        return moment

    def inner(self, one, other):
        return one * other

    def bent(self, term, values, strain, at):
        assert term.bend is not None
        return term.bend(values, strain, at)

    def way_of(self, term, values):
        assert term.stop_angle is not None
        return term.stop_angle(values)

    def components(self, way):
        return jnp.cos(way), jnp.sin(way)

    def advance(self, direction, way):
        return jnp.cos(direction - way)

    def lever(self, direction, force, length):
        x, y = force
        return jnp.sum(length * (y * jnp.cos(direction) - x * jnp.sin(direction)))

    def line(self, direction):
        return jnp.cos(direction), jnp.sin(direction)

    def stretch(self, strain, shift):
        return None if shift is None else 1.0 - shift * strain

    def pushed(self, pulls, direction, force, shift):
        if shift is None:
            return pulls
        x, y = self.line(direction)
        return pulls - shift * (x * force[0] + y * force[1])

    def bending_slope(self, law, strain):
        return self.slope(law, strain)[1]

    def slackened(self, start, rest, compliance, tension, moment, R):
        strain = rest
        for _ in range(2):
            strain = rest + compliance * (self.pull(tension, strain, R) + moment)
        return strain

    def near(self, compliance, tension, strain, R):
        return None

    def root(self, residual, guess, near, steps, flattest, stopped, first):
        strain, low, high = guess, -jnp.inf, jnp.inf
        for i in range(steps):
            error, slope = self.slope(residual, strain)
            least = flattest if first is None or i else first
            after = strain - error / jnp.where(slope > least, slope, least)
            after = after if stopped is None else stopped(strain, after)
            if first is not None:
                low, high = jnp.where(error < 0, strain, low), jnp.where(error > 0, strain, high)
                astray = (after < low) | (after > high)
                known = jnp.isfinite(low) & jnp.isfinite(high)
                after = jnp.where(astray & known, 0.5 * (low + high), after)
            strain = after
        return strain

    def slope(self, residual, strain):
        return jax.jvp(residual, (strain,), (jnp.ones_like(strain),))

    def quotient(self, change, slope):
        return change / slope


PLANE = Plane()
