"""How well friction coefficient and stiffness are known, and the values with which a robust design is
tried.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError
from gtr_jax.recordings.formats.text import read_text
from gtr_jax.robot.parameters import STIFFNESS

from .target import TargetConfig

# Names in fit.json, of each the first that it has.
NAMES = (("mu",), STIFFNESS)


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations of friction coefficient and stiffness, relative.

    Attributes:
        sd: of both, (2,); 0 where nothing is said.
        correlation: between the two.
        source: where it is from, for people; "" if nothing is known.
    """

    sd: np.ndarray
    correlation: float
    source: str

    @property
    def known(self) -> bool:
        """Whether anything is uncertain."""
        return bool(np.any(self.sd > 0))

    def _root(self) -> np.ndarray:
        rho = self.correlation
        return np.diag(self.sd) @ np.array([[1.0, 0.0], [rho, np.sqrt(max(0.0, 1.0 - rho**2))]])

    def gaussian(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and weights that integrate over a normal distribution: three-point Gauss-Hermite quadrature
        in each direction; steps (9, 2), relative, and weights (9,), which sum to 1.
        """
        x, w = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)]), np.array([1.0, 4.0, 1.0]) / 6.0
        grid = np.array([(a, b) for a in x for b in x])
        weights = np.array([a * b for a in w for b in w])
        return grid @ self._root().T, weights

    def edge(self, deviations: float) -> tuple[np.ndarray, np.ndarray]:
        """The nominal point and eight on the ellipse so many standard deviations away, (9, 2)."""
        angle = np.arange(8) * np.pi / 4
        around = deviations * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points = np.concatenate([np.zeros((1, 2)), around @ self._root().T])
        return np.maximum(points, -0.95), np.full(9, 1.0 / 9.0)

    def points(self, optimise: str, deviations: float) -> tuple[np.ndarray, np.ndarray]:
        """Relative steps (D, 2) and weights (D,) at which a design is tried."""
        if optimise == "nominal":
            return np.zeros((1, 2)), np.ones(1)
        steps, weights = self.gaussian() if optimise == "expected" else self.edge(deviations)
        return np.maximum(steps, -0.95), weights


def keys_of(config: RobotConfig) -> tuple[list[str], list[str]]:
    """Keys in the robot file of its friction coefficients, which deviate together, and of the numbers that
    say how stiff the body is, which do too.
    """
    names = config.tendon_names
    friction = [f"tendons.{name}.friction_coefficient" for name in names]
    said = ("backbone.youngs_modulus", "backbone.stiffness_factor", "backbone.bending_stiffness")
    stiffness = [key for key in config.numbers() if key.startswith(said)]
    return friction or ["tendon.friction_coefficient"], stiffness


def uncertainty_of(config: RobotConfig, target: TargetConfig) -> Uncertainty:
    """What the target file, its fit.json or the robot's [uncertainty] say; of several tendons the largest.

    Raises:
        InputError: the file is missing or no fit; or a robust design is asked for and nothing is uncertain.
    """
    own = target.robust
    sd, rho, source = np.zeros(2), 0.0, ""
    if own.fit is not None:
        sd, rho = _of_fit(target, target.beside(own.fit, "robust.fit"))
        source = own.fit
    else:
        values = config.numbers()
        for i, keys in enumerate(keys_of(config)):
            said = [(config.deviation(key), values.get(key, 0.0)) for key in keys]
            shares = [deviation / value for deviation, value in said if deviation is not None and value > 0]
            if shares:
                sd[i], source = max(shares), f"{config.source} [uncertainty]"
    for i, name in enumerate(("friction_coefficient", "youngs_modulus")):
        given = getattr(own, name)
        if given is not None:
            sd[i], source = given, f"{target.source} [robust]"
    found = Uncertainty(sd, rho, source)
    asked = "optimise" if own.optimise != "nominal" else "deviations"
    if asked in own.model_fields_set and not found.known:
        raise InputError(
            f"{target.source}: robust.{asked}: nothing is uncertain; give friction_coefficient = 0.1, "
            'fit = "fit.json", or [uncertainty] in the robot file'
        )
    return found


def _of_fit(target: TargetConfig, path: Path) -> tuple[np.ndarray, float]:
    where = f"{target.source}: robust.fit"
    try:
        text, _ = read_text(path)
    except InputError:
        raise InputError(f"{where}: {path} cannot be read; give the fit.json of a run of gtr fit") from None
    try:
        data = json.loads(text)
        parameters = data["parameters"]
        names = list(parameters)
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{where}: {path} is not a fit.json; take the one of a run of gtr fit") from None
    if not data.get("converged", True):
        raise InputError(f"{where}: {path} did not converge; fit again")
    sd, rho = np.zeros(2), 0.0
    try:
        given = [next((name for name in known if name in names), "") for known in NAMES]
        for i, name in enumerate(given):
            if name and parameters[name]["sd"] is not None:
                sd[i] = float(parameters[name]["sd"]) / float(parameters[name]["value"])
        if all(given):
            own, matrix = data["correlation"]["names"], data["correlation"]["matrix"]
            rho = float(matrix[own.index(given[0])][own.index(given[1])])
    except (KeyError, TypeError, ValueError, IndexError, ZeroDivisionError):
        raise InputError(f"{where}: {path} lacks value and sd of mu and E; fit them again") from None
    if not np.any(sd > 0):
        raise InputError(f"{where}: {path} fits neither mu nor E; take a fit that frees them")
    return sd, rho if np.isfinite(rho) else 0.0
