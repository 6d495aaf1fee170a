"""Physics beyond the paper, a term in each file. A new term is its file and one line here."""

from . import base_gain, base_offset, tip_gain, tip_offset
from .term import Quantity, Term

# Terms of the load cells act in this order, from the true tension to what is shown.
REGISTRY: dict[str, Term] = {
    module.TERM.id: module.TERM for module in (base_gain, base_offset, tip_gain, tip_offset)
}


def null_values() -> dict[str, dict[str, float]]:
    """The numbers of all terms at which none does anything, by term and name, SI."""
    return {term.id: {q.name: q.null for q in term.quantities} for term in REGISTRY.values()}


__all__ = ["REGISTRY", "Quantity", "Term", "null_values"]
