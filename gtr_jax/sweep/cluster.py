"""Running a sweep by workers of `dask.distributed`, in other processes or on other machines.

Each worker compiles the program once, and writes its blocks into the store itself: nothing but their numbers
travels. A worker that is lost costs the blocks it was computing, which others compute again.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gtr_jax.errors import InputError
from gtr_jax.interpreters import started_safely

from .config import load_sweep
from .lanes import Lanes
from .run import Done, Meter, Report, in_turn, solve_block
from .store import Store
from .task import Task, task_of

if TYPE_CHECKING:
    from distributed import Client

AHEAD = 4  # blocks queued or running for each worker
WATCHED = 0.5  # seconds between two checks of a worker whether the main process still runs
RETRIES = 3  # of a block whose worker was lost
# One executing thread in each worker: the threads of several workers on the same cores would wait for one
# another.
ALONE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
ALONE_IN_XLA = "--xla_cpu_multi_thread_eigen=false"


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Workers on this machine: spawned processes of one thread each, which run what this process alone sends
    them: every user of the machine can reach their ports.
    """
    distributed = _distributed()
    try:
        secret = distributed.Security.temporary()
    except ImportError:
        raise InputError(
            "--workers: needs cryptography, which keeps other users of this machine from them; install "
            "it with pip install 'gtr-jax[cluster]'"
        ) from None
    with (
        _quiet(),
        started_safely(),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            security=secret,
            silence_logs="CRITICAL",
            env=ALONE | {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {ALONE_IN_XLA}".strip()} | _cache(),
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        # Also for workers that replace a lost one.
        client.register_worker_callbacks(functools.partial(_end_with, os.getpid()))
        yield client


def _end_with(pid: int) -> None:
    """In a worker on this machine: end as soon as the process that started it is gone, however it ended."""

    def watch() -> None:
        while _runs(pid):
            time.sleep(WATCHED)
        os._exit(1)

    threading.Thread(target=watch, name="end with the main process", daemon=True).start()


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


def _cache() -> dict[str, str]:
    """Where this process keeps compiled programs, as the environment of a worker.

    With its size limit: a program stored without a limit cannot be evicted by processes that have one.
    """
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    names = ("MIN_COMPILE_TIME_SECS", "MIN_ENTRY_SIZE_BYTES")
    always = {f"JAX_PERSISTENT_CACHE_{name}": "-1" for name in names}
    limit = str(jax.config.values["jax_compilation_cache_max_size"])
    same = {"JAX_COMPILATION_CACHE_DIR": folder, "JAX_COMPILATION_CACHE_MAX_SIZE": limit}
    return same | always if folder else {}


@contextlib.contextmanager
def their_cluster(address: str) -> Iterator[Client]:
    """The workers of a scheduler that runs already; InputError if it does not answer."""
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout="20s")
    except (OSError, ValueError, TimeoutError) as fault:
        raise InputError(
            f"--scheduler {address}: no scheduler answers there ({fault}); start one with 'dask scheduler'"
        ) from None
    with client:
        yield client


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "--workers, --scheduler: need dask.distributed; install it with pip install 'gtr-jax[cluster]'"
        ) from None
    return distributed


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep a local cluster's messages about its start and end off stderr."""
    import logging

    names = ("distributed", "distributed.nanny", "distributed.scheduler", "distributed.worker")
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def run_there(
    client: Client, file: Path, task: Task, store: Store, blocks: Sequence[int], progress: Report
) -> Done:
    """Compute blocks of a sweep by the workers of a cluster.

    Args:
        client: of the cluster.
        file: the sweep file, which the workers read too, as they write the store.
        task, store: the sweep.
        blocks: which.
        progress: called with a line on the progress.
    """
    if not blocks:
        return Done(0, 0.0)
    distributed = _distributed()

    progress("waiting for workers")
    client.wait_for_workers(1)
    began = time.monotonic()
    where = (str(file.resolve()), str(store.path.resolve()), task.fingerprint)
    workers = max(len(client.scheduler_info()["workers"]), 1)
    meter = Meter(task, blocks, progress, unsettled=workers)
    number: dict[Any, int] = {}
    lost: list[tuple[int, str]] = []
    done = 0

    def submit(block: int):
        future = client.submit(compute, *where, block, pure=False, retries=RETRIES)
        number[future.key] = block
        return future

    def first_done(pending: set) -> set:
        return set(distributed.wait(list(pending), return_when="FIRST_COMPLETED").done)

    for finished in in_turn(blocks, submit, first_done, AHEAD * workers):
        block = number.pop(finished.key)
        fault = finished.exception()
        if fault is None:
            done += finished.result()
        else:
            lost.append((block, str(fault).splitlines()[0] if str(fault) else type(fault).__name__))
        finished.release()
        meter(done)
    return Done(done, time.monotonic() - began, None, tuple(lost))


def compute(file: str, store: str, fingerprint: str, block: int) -> int:
    """One block, in a worker; the number of its points."""
    return solve_block(*_prepared(file, store, fingerprint), block)


@functools.lru_cache(maxsize=2)
def _prepared(file: str, store: str, fingerprint: str) -> tuple[Store, Lanes]:
    task = task_of(load_sweep(file))
    if task.fingerprint != fingerprint:
        raise InputError(
            f"{file}: is not what this sweep was begun with, or other versions are installed here"
        )
    there = Store(Path(store), task)
    there.create()
    return there, Lanes(task)
