"""The robot file: `robot.toml` read, checked and written.

Its tables are in `robot_tables` and `sections`, how they are written in `form`, what fits into what in
`checks`, its JSON Schema in `schema`.
"""

from __future__ import annotations

import os
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, ModelWrapValidatorHandler, model_validator

from gtr_jax.atomic_write import write_atomically
from gtr_jax.errors import InputError, InputWarning, listed
from gtr_jax.notebook import as_card
from gtr_jax.terms import REGISTRY, null_values
from gtr_jax.units import DIMENSIONS, parse_quantity, to_si

from .checks import check_robot
from .drawn_channel import with_drawn_channels
from .form import LAW, check_strings, check_terms, with_one_tendon
from .markers import check_markers
from .out_of_plane import out_of_plane
from .plausible import implausible
from .robot_tables import RobotTables
from .space_checks import check_space
from .toml_file import dotted, find_key, place_of, read_toml

# Columns of a comment in a robot file.
NOTE_WIDTH = 110

# Names by which people call the two numbers that are fitted most.
_SHORT = {"mu": "friction_coefficient", "E": "youngs_modulus"}


def _one_tendon_or_several(schema: dict[str, Any]) -> None:
    schema["oneOf"] = [{"required": ["routing", "tendon"]}, {"required": ["tendons"]}]


def _of_lists(
    uncertainty: Mapping[str, float | str], known: Mapping[str, float]
) -> Iterator[tuple[str, float | str]]:
    """What [uncertainty] says, where a key names a list once for each of its numbers."""
    whole = [path for path in known if path.rpartition(".")[2].isdigit()]
    lists = dict.fromkeys(path.rpartition(".")[0] for path in whole)
    for key, deviation in uncertainty.items():
        meant = [one for one in lists if one == key or one.endswith(f".{key}")]
        if len(meant) > 1:
            raise InputError(f"uncertainty: '{key}' may be any of {listed(meant)}; write one of them")
        each = [path for path in whole if meant == [path.rpartition(".")[0]]]
        yield from ((path, deviation) for path in each or [key])


class RobotConfig(RobotTables):
    """A robot as its file describes it, in SI units."""

    model_config = ConfigDict(title="robot.toml of gtr-jax", json_schema_extra=_one_tendon_or_several)

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        check_terms(data, [*REGISTRY, LAW])
        check_strings(data)
        return with_drawn_channels(with_one_tendon(data), folder)

    @property
    def in_space(self) -> bool:
        """Whether the robot is computed in space."""
        return self.leaves_plane is not None

    @property
    def leaves_plane(self) -> str | None:
        """The key by which the robot leaves its plane, or asks for what only space has; None if none does."""
        return "space" if self.space else out_of_plane(self)

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, data: Any, handler: ModelWrapValidatorHandler[RobotConfig]) -> RobotConfig:
        """The robot, if it can be one; under [uncertainty] keys as written give way to dotted ones."""
        config = handler(data)
        check_robot(config.backbone, strung=config.strung, loads=config.loads, terms=config.terms)
        check_space(config, config.leaves_plane)
        check_markers(config.markers, config.backbone.length)
        return config.model_copy(update={"uncertainty": config._dotted_deviations()})

    def _dotted_deviations(self) -> dict[str, float | str]:
        """What [uncertainty] says, by dotted key; InputError if it cannot be."""
        resolved: dict[str, float | str] = {}
        known = self.numbers()
        for key, deviation in _of_lists(self.uncertainty, known):
            path = find_key(_SHORT.get(key, key), known, "uncertainty")
            size = deviation
            if isinstance(size, str):
                size = to_si(size, self._unit_of(path), f"uncertainty.{key}")
            if size <= 0:
                raise InputError(
                    f"uncertainty.{key}: must be positive, is {deviation}; remove it if known exactly"
                )
            if path in resolved:
                raise InputError(f"uncertainty.{key}: {path} is given twice; remove one")
            resolved[path] = deviation
        return resolved

    def _unit_of(self, key: str) -> str:
        """SI unit of a number of the robot, by dotted key."""
        data = self.model_dump(mode="json", by_alias=True, exclude_none=True, context={"unit_strings": True})
        text = next(value for path, value in dotted(data) if path == key)
        shown = text.split(" ", 1)[1] if isinstance(text, str) else "dimensionless"
        return next((si for si, d in DIMENSIONS.items() if shown in (d.display, si)), shown)

    def without_deviations(self, keys: Iterable[str]) -> RobotConfig:
        """A copy in which [uncertainty] says nothing about some numbers, by dotted key."""
        gone = set(keys)
        left = {key: said for key, said in self.uncertainty.items() if key not in gone}
        return self.model_copy(update={"uncertainty": left})

    def with_deviations(self, deviations: Mapping[str, float]) -> RobotConfig:
        """A copy in which [uncertainty] says other things of some numbers: standard deviations in SI, by
        dotted key. They are written as shares, to three digits, but those of a number that is zero with their
        unit; of one that is zero and has no unit nothing can be said.
        """
        values = self.numbers()
        said = {
            key: float(f"{sd / abs(values[key]):.3g}") if values[key] else f"{sd:.3g} {self._unit_of(key)}"
            for key, sd in deviations.items()
            if values[key] or self._unit_of(key) != "dimensionless"
        }
        return self.model_copy(update={"uncertainty": {**self.uncertainty, **said}})

    def deviation(self, key: str) -> float | None:
        """What [uncertainty] says of a number, by dotted key: one standard deviation in SI; None if it says
        nothing, or gives a share of zero.
        """
        said = self.uncertainty.get(key)
        if isinstance(said, str):
            return parse_quantity(said, self._unit_of(key))
        return None if said is None else abs(said * self.numbers()[key]) or None

    @property
    def term_values(self) -> dict[str, dict[str, Any]]:
        """The numbers of all terms, those of absent ones at their null values, by term and name, SI; of one
        that the file gives to single tendons one for each tendon, (tendons,).
        """
        values: dict[str, dict[str, Any]] = dict(null_values(self.laws))
        for term in self.terms:
            own = values[term.id]
            if term.tendon is None:
                values[term.id] = own | {name: getattr(term, name) for name in own}
                continue
            for name, known in own.items():
                each = np.array(np.broadcast_to(known, len(self.tendons)), float)
                each[self.tendon_names.index(term.tendon)] = getattr(term, name)
                own[name] = each
        return values

    _repr_html_ = as_card

    def with_values(self, values: Mapping[str, Any]) -> RobotConfig:
        """A copy with some values changed, checked like a file.

        Args:
            values: SI numbers or unit strings, by dotted key ("tendon.friction_coefficient",
                "backbone.outer_radius.0", "tendons.left.preload", "terms.tip-gain.gain", of one tendon
                "terms.tip-gain:left.gain") or by a bare key where it is the only one; what the file leaves
                open by its whole key ("tendons.left.axial_stiffness"). A term that is not there is added.

        Raises InputError naming the key that is unknown, given twice or whose value does not fit.
        """
        data = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        there = {(term["kind"], term.get("tendon")) for term in data.get("terms", ())}
        for kind, null in null_values().items():
            for tendon in (None, *self.tendon_names):
                table = f"terms.{kind}." if tendon is None else f"terms.{kind}:{tendon}."
                if (kind, tendon) not in there and any(key.startswith(table) for key in values):
                    whose = {} if tendon is None else {"tendon": tendon}
                    data.setdefault("terms", []).append({"kind": kind, **whose, **null})
        for key in values:
            part = next((other for other in values if other.startswith(f"{key}.")), None)
            if part is not None:
                raise InputError(f"{self.source}: {key} and {part} say the same; give one of the two")
        _with_axes(data["loads"], values)
        keys = {key: value for key, value in dotted(data) if not key.startswith("uncertainty.")}
        # Numbers of a part that is there which the file leaves open: by their whole keys.
        if absent := values.keys() - keys.keys():
            whole = dotted(self.model_dump(mode="json", by_alias=True))
            keys |= {k: v for k, v in whole if k in absent and v is None and k.rpartition(".")[0] in keys}
        for key, value in values.items():
            *parents, last = find_key(key, keys, self.source).split(".")
            node: Any = data
            for parent in parents:
                node = node[place_of(parent, node)]
            node[place_of(last, node)] = value
        return parse_config(data, source=self.source)


def _with_axes(loads: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Give the loads on a tip the axes of space, where `values` name one of these."""
    known = {key.removeprefix("loads.") for key in values}
    if "tip_force.2" in known:
        loads["tip_force"] = [*loads["tip_force"], 0.0][:3]
    turned = any(key.startswith("tip_moment.") for key in known)
    if turned and not isinstance(loads["tip_moment"], list):
        loads["tip_moment"] = [0.0, 0.0, loads["tip_moment"]]


def parse_config(
    data: Mapping[str, Any], *, source: str = "robot", folder: str | os.PathLike[str] = "."
) -> RobotConfig:
    """Check the contents of a robot file. `source` names it in errors; `folder` is where its files lie.

    Raises InputError naming source, key and remedy.
    """
    return RobotConfig.parsed(data, source=source, folder=folder)


def load_config(path: str | os.PathLike[str]) -> RobotConfig:
    """Read a robot file.

    Raises InputError naming file, key and remedy; warns with an `InputWarning` of sizes that such robots do
    not have, as of a length of 120 m.
    """
    data = read_toml(path)
    config = parse_config(data, source=str(path), folder=Path(path).parent)
    if data.get("tendons") and not config.tendons:
        warnings.warn(
            f"{path}: tendons: there is only one, so its columns and numbers carry no name: T_base_N, mu; "
            "write [tendon] and [routing] for one tendon",
            InputWarning,
            stacklevel=2,
        )
    for line in implausible(config):
        warnings.warn(f"{path}: {line}", InputWarning, stacklevel=2)
    return config


def config_text(config: RobotConfig) -> str:
    """A robot file as TOML, with unit strings; it reads back to equal SI values."""
    import tomli_w

    return tomli_w.dumps(
        config.model_dump(by_alias=True, exclude_defaults=True, context={"unit_strings": True})
    )


def dump_config(config: RobotConfig, path: str | os.PathLike[str], *, note: str = "") -> None:
    """Write a robot file, whole or not at all, with a note as comment at its top; see `config_text`."""
    comment = "".join(f"# {line}\n" for line in textwrap.wrap(note, NOTE_WIDTH, break_on_hyphens=False))
    write_atomically(path, comment + config_text(config))
