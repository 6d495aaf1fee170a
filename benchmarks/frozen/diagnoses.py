"""Frozen diagnosis cases."""

from __future__ import annotations

from .case import Case


def cases() -> list[Case]:
    """None yet."""
    return []
