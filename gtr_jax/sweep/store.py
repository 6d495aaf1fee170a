"""The store of a sweep: a Zarr group that xarray opens as a labelled dataset. Each block is a region, and a
chunk, of its own; its result codes are written last, so that a block that has them is complete.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtr_jax.errors import InputError

from .loadpath import drive_of
from .outputs import DRAWN_OUT, RESULT, STEP, Variable, of_tendons
from .plan import POINT, draw
from .task import Task, settings_of

if TYPE_CHECKING:
    import xarray
    import zarr

STORE = "sweep.zarr"  # name in a run folder
PART = ".part"  # ending of a store that is being created
NOT_COMPUTED = 255  # result code of a point that is not computed yet
NUMBERS: dict[str, Any] = {"dtype": "float64", "fill_value": np.nan}
RESULTS: dict[str, Any] = {"dtype": "uint8", "fill_value": NOT_COMPUTED}
FLAGS = {
    "flag_values": [0, 1, 2, 3, NOT_COMPUTED],
    "flag_meanings": "converged not_converged not_finite no_such_robot not_computed",
}


class Store:
    """The store of one sweep.

    Args:
        path: folder of the Zarr group.
        task: the sweep.
    """

    def __init__(self, path: Path, task: Task) -> None:
        self.path, self.task = path, task
        self._open: zarr.Group | None = None

    def create(self) -> None:
        """Create an empty store unless it exists; atomically, as other workers may do so at the same time.

        Raises:
            InputError: there is one of another sweep.
        """
        if self.path.exists():
            self._refuse_another()
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        part = self.path.with_name(f"{self.path.name}.{uuid.uuid4().hex}{PART}")
        try:
            self._write_empty(part)
            try:
                part.rename(self.path)
            except OSError:
                if not self.path.exists():
                    raise
                self._refuse_another()
        finally:
            shutil.rmtree(part, ignore_errors=True)

    @property
    def group(self) -> zarr.Group:
        """The Zarr group, opened for reading and writing."""
        import zarr

        if self._open is None:
            try:
                self._open = zarr.open_group(self.path, mode="r+", zarr_format=3)
            except (OSError, ValueError, KeyError):
                raise InputError(f"{self.path}: is damaged; remove it and run again") from None
        return self._open

    def array(self, name: str) -> Any:
        """One array of the store."""
        try:
            return self.group[name]
        except (OSError, ValueError, KeyError):
            raise InputError(
                f"{self.path}: {name} is gone; another run has finished this sweep, or the store is damaged"
            ) from None

    def same(self) -> bool:
        """Whether the existing store belongs to this sweep."""
        return self.group.attrs.get("fingerprint") == self.task.fingerprint

    def _refuse_another(self) -> None:
        if not self.same():
            raise InputError(
                f"{self.path}: holds a sweep of another file, robot, version or device; finish it with what "
                "it was begun with, remove it, or choose another folder with -o"
            )

    def _write_empty(self, path: Path) -> None:
        import zarr

        task, plan = self.task, self.task.plan
        group = zarr.create_group(path, zarr_format=3)
        extra = {"coordinates": " ".join(axis.name for axis in task.axes)} if not plan.gridded else {}
        group.attrs.update(settings_of(task) | extra)
        if plan.gridded:
            for axis in task.axes:
                said = _described(axis.parameter.key, axis.parameter.unit)
                _put(group, axis.name, np.asarray(axis.values), (axis.name,), said)
        else:
            self._points(group)
        steps = task.history.kept
        if len(steps) > 1:
            _put(group, STEP, np.asarray(steps), (STEP,), _described("load step", ""))
        self._base(group)
        for v in task.stored:
            extra = task.extra_shape(v)
            group.create_array(
                v.name,
                shape=(*plan.shape, *extra),
                chunks=(*plan.chunk, *extra),
                dimension_names=(*plan.dims, *task.extra_dims(v)),
                config={"write_empty_chunks": True},
                **(RESULTS if v is RESULT else NUMBERS),
                attributes=_described(v.says, v.unit) | (FLAGS if v is RESULT else {}),
            )

    def _points(self, group) -> None:
        """The points, as coordinates along them."""
        task, plan = self.task, self.task.plan
        arrays = [
            group.create_array(
                axis.name,
                shape=plan.shape,
                chunks=plan.chunk,
                dimension_names=(POINT,),
                attributes=_described(axis.parameter.key, axis.parameter.unit),
                **NUMBERS,
            )
            for axis in task.axes
        ]
        for region, values in _by_chunks(self._drawn(), plan.chunk[0]):
            for i, array in enumerate(arrays):
                array[region] = values[:, i]

    def _drawn(self) -> Iterator[np.ndarray]:
        task = self.task
        return iter([task.table]) if task.table is not None else draw(task.file, task.axes)

    def _base(self, group) -> None:
        """What drives the tendons at the steps kept, base tension or displacement, where it is the same at
        every point.
        """
        task, path = self.task, self.task.history
        names = task.robot.tendon_names
        put: list[tuple[Variable, np.ndarray]] = []
        if not task.base_varies:
            T = np.asarray(drive_of(path, task.robot, {}).T_base)
            put += [(v, T[:, i] if names else T) for i, v in task.given_bases]
        if task.drawn and not task.pull_varies:
            out = np.asarray(drive_of(path, task.robot, {}).displacement)
            each = enumerate(of_tendons(DRAWN_OUT, names))
            put += [(v, out[:, i] if names else out) for i, v in each if path.drawn[i]]
        for v, steps in put:
            own = steps[list(path.kept)]
            values = own if len(path.kept) > 1 else own[0]
            dims = (STEP,) if len(path.kept) > 1 else ()
            _put(group, v.name, values, dims, _described(v.says, v.unit))
        if put:
            known = group.attrs.get("coordinates", "")
            group.attrs["coordinates"] = f"{known} {' '.join(v.name for v, _ in put)}".strip()

    def left(self) -> list[int]:
        """Blocks that are not computed yet."""
        plan, chunks = self.task.plan, self.path / RESULT.name / "c"
        done = np.zeros(plan.counts, dtype=bool)
        for folder, _, files in os.walk(chunks):
            above = Path(folder).relative_to(chunks).parts
            for name in files:
                if name.isdigit() and len(above) == len(plan.counts) - 1:
                    done[tuple(map(int, (*above, name)))] = True
        return [int(block) for block in np.flatnonzero(~done.ravel())]

    def read(self, name: str, block: int) -> np.ndarray:
        """A block of an array.

        Raises:
            InputError: it cannot be read, or was never computed; it will be, when the sweep runs again.
        """
        try:
            values = np.asarray(self.array(name)[self.task.plan.region(block)])
            if name != RESULT.name or np.all(values != NOT_COMPUTED):
                return values
        except (RuntimeError, OSError, ValueError):
            pass
        place = map(str, self.task.plan.place(block))
        self.path.joinpath(RESULT.name, "c", *place).unlink(missing_ok=True)
        raise InputError(f"{self.path}: a part of {name} is damaged; run again to compute it again")

    def points(self, block: int) -> np.ndarray:
        """Values [SI] of what is varied at the points of a block, (points, axes)."""
        plan = self.task.plan
        if plan.gridded:
            return plan.on_grid(block)
        return np.stack([self.array(axis.name)[plan.region(block)] for axis in plan.axes], axis=1)

    def write(self, block: int, found: dict[str, np.ndarray]) -> None:
        """Store the outputs of a block, its result codes last."""
        task, region = self.task, self.task.plan.region(block)
        size = tuple(part.stop - part.start for part in region)
        for v in task.stored:
            values = found[v.name]
            self.array(v.name)[region] = values.reshape(*size, *values.shape[1:])

    def clean(self) -> None:
        """Remove what interrupted runs have left, in the store and beside it."""
        for stray in self.path.rglob("*.partial"):
            stray.unlink(missing_ok=True)
        for stray in self.path.parent.glob(f"{self.path.name}.*{PART}"):
            shutil.rmtree(stray, ignore_errors=True)


def _by_chunks(pieces: Iterator[np.ndarray], chunk: int) -> Iterator[tuple[slice, np.ndarray]]:
    """Pieces of any length joined and cut again, so that every chunk is written once."""
    held: list[np.ndarray] = []
    start = have = 0
    for piece in pieces:
        held.append(piece)
        have += len(piece)
        if have >= chunk:
            whole = np.concatenate(held)
            upto = have // chunk * chunk
            yield slice(start, start + upto), whole[:upto]
            held, start, have = [whole[upto:]], start + upto, have - upto
    if have:
        yield slice(start, start + have), np.concatenate(held)


def _put(
    group: zarr.Group, name: str, values: np.ndarray, dims: tuple[str, ...], says: dict[str, Any]
) -> None:
    """Write a whole array in one chunk."""
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=values.shape,
        dtype=values.dtype,
        fill_value=np.nan if values.dtype.kind == "f" else 0,
        dimension_names=dims,
        attributes=says,
    )
    array[...] = values


def _described(says: str, unit: str) -> dict[str, str]:
    return {"long_name": says, "units": unit or "1"}


def open_sweep(path: str | os.PathLike[str]) -> xarray.Dataset:
    """A finished sweep, or one that is being computed, as a labelled dataset.

    Args:
        path: the run folder that `gtr sweep` wrote, or the Zarr store in it.

    Returns:
        A dataset with the parameters as coordinates [SI]; values are read when they are used. `result` is 0
        where a point converged; where it did not, the outputs are NaN. The whole input is in `attrs`.

    Raises:
        InputError: there is no sweep.
    """
    import xarray

    path = Path(path)
    inner = path / STORE
    if inner.exists():
        path = inner
    if not (path / RESULT.name).exists():
        raise InputError(f"{path}: no sweep there; give the folder that 'gtr sweep' wrote with -o")
    return xarray.open_zarr(path, consolidated=False, chunks=None)
