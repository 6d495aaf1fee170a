"""For every test: float64, no silent promotion of dtype or rank, and programs that compile quickly."""

import ctypes
import gc
import itertools
import os
import zlib
from pathlib import Path

import equinox as eqx
import jax
import pytest

import gtr_jax
from gtr_jax.config.config import parse_config

# Nearly all of the time goes into compiling: without optimisation it takes half as long, and runs take twice.
# A worker inherits them.
# What only helps optimisation is not written down either.
UNOPTIMISED = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
    " --xla_llvm_enable_alias_scope_metadata=false --xla_llvm_enable_noalias_metadata=false"
)
if UNOPTIMISED not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {UNOPTIMISED}"
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Tracing makes many objects and hardly any cycles: Python looks for these every so many new objects.
NEW_OBJECTS = 50_000

# Memory [pages of 4 KiB] beyond which compiled programs are dropped: a worker keeps all it ever compiled.
LARGE, STATISTICS = 3 * 2**18, Path("/proc/self/statm")
# Programs are compiled once for both workers and kept in pytest's cache: the most of them [bytes], and the
# quickest to compile that is worth keeping [s].
LARGEST_CACHE, QUICK = 2**31, 0.2


def pytest_addoption(parser):
    parser.addoption("--part", metavar="K/N", help="only the Kth of N parts of the tests")


def pytest_collection_modifyitems(config, items):
    """Leave out what is not in the part asked for: tests are dealt out by their names, so that a part stays
    the same when others are added.
    """
    if config.option.part is None:
        return
    try:
        k, n = map(int, config.option.part.split("/"))
    except ValueError:
        raise pytest.UsageError(f"--part {config.option.part}: not two whole numbers, as 2/4") from None
    if not 1 <= k <= n:
        raise pytest.UsageError(f"--part {config.option.part}: parts are counted from 1 to {n}")
    parts: list[list[pytest.Item]] = [[] for _ in range(n)]
    for item in items:
        parts[zlib.crc32(item.nodeid.encode()) % n].append(item)
    items[:] = parts.pop(k - 1)
    config.hook.pytest_deselected(items=[*itertools.chain(*parts)])


def pytest_configure(config):
    gc.set_threshold(NEW_OBJECTS, 10, 10)
    os.environ["GTR_JAX_CACHE"] = "off"  # the commands leave the user's own cache alone
    if not hasattr(config, "cache"):  # -p no:cacheprovider
        return
    # The key that seals programs is not the user's either.
    os.environ["XDG_DATA_HOME"] = str(config.cache.mkdir("data"))
    jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("programs")))
    jax.config.update("jax_compilation_cache_max_size", LARGEST_CACHE)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", QUICK)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def large() -> bool:
    """Whether this process holds more memory than it should."""
    return STATISTICS.exists() and int(STATISTICS.read_text().split()[1]) > LARGE


def give_back():
    """Freed memory goes back to the system; it stays with the process otherwise, in pieces."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(autouse=True)
def programs_do_not_pile_up():
    """Give memory back where a worker has much of it, and drop compiled programs where they hold it."""
    yield
    if large():
        give_back()
        if large():
            eqx.clear_caches()
            jax.clear_caches()
            give_back()


@pytest.fixture
def make_config():
    """A valid robot file as a dictionary of SI numbers, changed by keyword per section, parsed; a None takes
    a number of the backbone away, `tendons` the only tendon and its channel.
    """

    def make(routing=None, backbone=None, tendon=None, loads=None, **rest):
        data = {
            "schema": 1,
            "name": "test",
            "backbone": {
                "length": 0.25,
                "outer_radius": [0.02, 0.013],
                "youngs_modulus": 1.06e6,
                "density": 1070.0,
                **(backbone or {}),
            },
            "routing": routing or {"kind": "parallel", "offset": 0.01},
            "tendon": {"friction_coefficient": 0.3, **(tendon or {})},
            "loads": loads or {},
            **rest,
        }
        data["backbone"] = {key: value for key, value in data["backbone"].items() if value is not None}
        if "tendons" in rest:
            del data["routing"], data["tendon"]
        return parse_config(data)

    return make


@pytest.fixture
def make_robot(make_config):
    """The robot of `make_config`, at a mesh resolution."""

    def make(resolution=1.0, **sections):
        return gtr_jax.build_robot(make_config(**sections), resolution=resolution)

    return make


SINE = {"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": 0.03, "w2": 0.1}
WAVE = {"kind": "converging-sine", "R_max": 0.01, "r_min": 0.006, "n_sine": 6, "sigma": 0.3}
CROSS = {"kind": "crossing-sine", "R_max": 0.012, "r_min": 0.008, "n_sine": 4}
PARALLEL = {"kind": "parallel", "offset": 0.008}
TABLE = {"kind": "table", "knots": [[0.0, 0.006], [0.08, 0.01], [0.16, -0.004], [0.25, 0.008]]}
ROUTINGS = {"sine": SINE, "wave": WAVE, "cross": CROSS, "parallel": PARALLEL, "table": TABLE}
