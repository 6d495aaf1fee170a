"""What every table of a file shares: quantities in SI units, and the refusal of keys that are not known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StrictStr, ValidationInfo, model_validator

from gtr_jax.units import Unit

from .form import check_keys

Length = Annotated[float, Unit("m")]
Angle = Annotated[float, Unit("rad")]
Curvature = Annotated[float, Unit("rad/m")]
Modulus = Annotated[float, Unit("Pa")]
Density = Annotated[float, Unit("kg/m^3")]
Force = Annotated[float, Unit("N")]
Moment = Annotated[float, Unit("N m")]
Mass = Annotated[float, Unit("kg")]
Ratio = Annotated[float, Unit("dimensionless")]
BendingStiffness = Annotated[float, Unit("N m^2")]
Acceleration = Annotated[float, Unit("m/s^2")]
POSITIVE, NOT_NEGATIVE = Field(gt=0), Field(ge=0)  # bounds of the file's own numbers; `form` says them


class Section(BaseModel):
    """One table of the robot file; unknown keys are refused with the nearest valid name.

    What stands below a key says what it is, and becomes its description in the JSON Schema (`schema`).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any, info: ValidationInfo) -> Any:
        if isinstance(data, Mapping):
            data = cls._resolved(dict(data), Path((info.context or {}).get("folder", ".")))
        check_keys(cls, data)
        return data

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        """The section with what it refers to in other files, relative to `folder`, put in place."""
        return data


class TermSection(Section):
    """One physics term; see `gtr_jax.terms`."""

    kind: str
    tendon: StrictStr | None = None
    """Tendon on which it acts, where there are several; absent: all of them."""

    @property
    def id(self) -> str:
        """The name of the term."""
        return self.kind
