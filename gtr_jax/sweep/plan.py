"""The points of a sweep, and their division into blocks, each computed, stored and resumed as a whole."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from .axes import Axis
from .config import SweepConfig

POINT = "point"
MOST_AT_ONCE = 20_000_000  # most points of a sample that can only be drawn as a whole, in memory
DRAWN_AT_ONCE = 2**16  # points of any other sample that are drawn at a time
LEVELS = 6  # of the elementary effects' grid
# Work of a block in equilibria without external loads, and bytes that it leaves; see `block_size`.
LEAST_WORK = 2**8
MOST_WORK, MOST_BYTES = 2**17, 64 * 2**20


@dataclasses.dataclass(frozen=True)
class Plan:
    """Points of a sweep on a grid of `shape`, parted into blocks.

    Attributes:
        axes: what is varied.
        dims: dimension names; those of the axes on a grid, else "point".
        shape: of the grid.
        chunk: shape of a block; the last along a dimension may be smaller.
    """

    axes: tuple[Axis, ...]
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunk: tuple[int, ...]

    @property
    def gridded(self) -> bool:
        """Whether every dimension is a parameter."""
        return self.dims != (POINT,)

    @property
    def points(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of blocks along each dimension."""
        return tuple(-(-n // c) for n, c in zip(self.shape, self.chunk, strict=True))

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    @property
    def largest(self) -> int:
        """Points of the largest block."""
        return math.prod(self.chunk)

    def place(self, block: int) -> tuple[int, ...]:
        """Where a block stands among the blocks."""
        return tuple(int(i) for i in np.unravel_index(block, self.counts))

    def region(self, block: int) -> tuple[slice, ...]:
        """The part of the grid that a block covers."""
        parts = zip(self.place(block), self.chunk, self.shape, strict=True)
        return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in parts)

    def on_grid(self, block: int) -> np.ndarray:
        """Values [SI] at the points of a block of a grid, (points, axes), the last dimension fastest."""
        along = [
            np.asarray(axis.values)[part] for axis, part in zip(self.axes, self.region(block), strict=True)
        ]
        return np.stack([v.ravel() for v in np.meshgrid(*along, indexing="ij")], axis=1)


def plan_of(sweep: SweepConfig, axes: Sequence[Axis], points: int | None, block: int) -> Plan:
    """Part a sweep into blocks of at most `block` points.

    Args:
        sweep: the file.
        axes: what is varied.
        points: rows of its table of points; None without one.
        block: points of a block.
    """
    axes = tuple(axes)
    if sweep.sample == "grid" and points is None:
        shape = tuple(len(np.asarray(axis.values)) for axis in axes)
        return Plan(axes, tuple(axis.name for axis in axes), shape, _chunk(shape, block))
    count = points if points is not None else drawn_points(sweep, len(axes))
    return Plan(axes, (POINT,), (count,), _chunk((count,), block))


def _chunk(shape: tuple[int, ...], block: int) -> tuple[int, ...]:
    """Shape of a block: the last dimensions whole, as many as fit, and the next one in about even parts."""
    chunk, room = [], max(block, 1)
    for n in reversed(shape):
        most = min(n, max(room, 1))
        parts = -(-n // most)
        chunk.append(-(-n // parts))
        room = room // n if most == n else 1
    return tuple(reversed(chunk))


def drawn_points(sweep: SweepConfig, axes: int) -> int:
    """How many points a sample has."""
    count = sweep.count or 0
    return count * {"saltelli": axes + 2, "morris": axes + 1}.get(sweep.sample, 1)


def draw(sweep: SweepConfig, axes: Sequence[Axis]) -> Iterator[np.ndarray]:
    """The points of a sample [SI], (some, axes) at a time, always the same for the same file.

    Raises:
        InputError: more points than fit into memory, of a sample that must be drawn at once.
    """
    for shares in _shares(sweep, len(axes)):
        yield np.stack([axis.at(shares[:, i]) for i, axis in enumerate(axes)], axis=1)


def _shares(sweep: SweepConfig, axes: int) -> Iterator[np.ndarray]:
    from scipy.stats import qmc

    total = drawn_points(sweep, axes)
    if sweep.sample in ("sobol", "random"):
        drawer = qmc.Sobol(axes, bits=64, rng=sweep.seed) if sweep.sample == "sobol" else None
        rng = np.random.default_rng(sweep.seed)
        for start in itertools.takewhile(lambda at: at < total, itertools.count(0, DRAWN_AT_ONCE)):
            some = min(DRAWN_AT_ONCE, total - start)
            yield rng.random((some, axes)) if drawer is None else _quietly(drawer, some)
        return
    if total > MOST_AT_ONCE:
        raise sweep.fault(
            "count",
            f"{total} points of a {sweep.sample} sample do not fit into memory; take sample = 'sobol'",
        )
    if sweep.sample == "latin-hypercube":
        yield qmc.LatinHypercube(axes, rng=sweep.seed).random(total)
        return
    yield sensitivity_sample(sweep.sample, axes, sweep.count or 0, sweep.seed)


def _quietly(drawer, some: int) -> np.ndarray:
    """The next points; no warning if their number is not a power of two, which is the user's choice."""
    import warnings

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The balance properties of Sobol", UserWarning)
        return drawer.random(some)


def sensitivity_problem(names: Sequence[str]) -> dict:
    """SALib's description of parameters that are drawn as shares of their probability."""
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def sensitivity_sample(kind: str, axes: int, count: int, seed: int) -> np.ndarray:
    """Shares drawn for Sobol's indices (saltelli) or for elementary effects (morris), by SALib."""
    from SALib.sample import morris, sobol

    problem = sensitivity_problem([str(i) for i in range(axes)])
    if kind == "saltelli":
        return sobol.sample(problem, count, calc_second_order=False, seed=seed)
    return morris.sample(problem, count, num_levels=LEVELS, seed=seed)


def block_size(total: int, weight: float, bytes_each: float, lanes: int) -> int:
    """Points of a block: a 64th of the sweep, but seconds of work and tens of megabytes at most.

    Args:
        total: points of the sweep.
        weight: work of a point, in equilibria without external loads.
        bytes_each: bytes that a point leaves.
        lanes: points solved side by side, the least block unless they leave more than that.
    """
    most = min(MOST_WORK / weight, MOST_BYTES / bytes_each)
    least = min(lanes, max(MOST_BYTES / bytes_each, 1.0))
    return int(max(min(max(total / 64, LEAST_WORK / weight), most), least))
