"""How JAX is set up for this package: 64-bit floats, and loops compiled as one kernel on the CPU, in which
nothing is computed twice.

All settings are environment variables, which JAX reads when it is imported. So this module does not import
JAX, and it does not matter which module imports it first.

XLA's CPU backend runs every operation of a loop's body as a kernel of its own unless one pass of the body
touches fewer bytes than a threshold, 1 kB by default. The march over the nodes touches more. With a threshold
of 1 MB the whole march is one kernel, and so is a history of marches: an equilibrium is then 2 to 4 times
faster, a history 5 times (`python -m benchmarks --only loops`). 100 kB is enough in the plane. The four
marches side by side that a robot in space takes under an external load touch more.

Within a kernel XLA fuses operations, and copies into each fusion what it needs of the others: of the march's
derivatives in space, 8,500 operations became 73,000. Fusions with several outputs, after which XLA looks at
all of the body again, keep one copy. What that is worth in space, and costs in the plane, is in
docs/solver.md, "What compiling takes".

Fits and diagnoses solve dense systems of some dozen unknowns by NumPy, that is, in LAPACK. Threads do not
speed these up, the last bits of an answer depend on their number, and on a machine that is busy with other
work they wait for one another: with two of them 15 decompositions of up to 2,000 x 60 numbers took 44 s
instead of 0.7 s.
"""

from __future__ import annotations

import os
import sys
import warnings

LOOP_OPTION = "xla_backend_extra_options"  # XLA flag that holds the options of a backend
# Each see above; the threshold is in bytes.
LOOPS = (
    "xla_cpu_small_while_loop_byte_threshold=1000000",
    "xla_cpu_use_multi_output_fusion",
    "xla_cpu_flatten_after_fusion",
)


def set_up() -> None:
    """Switch to 64-bit floats, set how loops are compiled unless the environment already sets options of the
    backend, and keep LAPACK to one thread unless the environment says how many.

    XLA reads its flags when it is first used, JAX and LAPACK theirs when they are imported. Where JAX has
    computed already, the flags would have no effect: they are left as they are, and a warning says so.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    flags = os.environ.get("XLA_FLAGS", "")
    if LOOP_OPTION not in flags:
        if _jax_has_computed():
            warnings.warn(
                "JAX has computed before gtr_jax was imported, so equilibria take 2 to 4 times as long, "
                "histories 5 times; import gtr_jax before computing anything with JAX",
                RuntimeWarning,
                stacklevel=3,
            )
        else:
            os.environ["XLA_FLAGS"] = f"{flags} --{LOOP_OPTION}={','.join(LOOPS)}".strip()
    os.environ["JAX_ENABLE_X64"] = "1"
    if "jax" in sys.modules:  # JAX is imported already and has read its settings
        sys.modules["jax"].config.update("jax_enable_x64", True)


def _jax_has_computed() -> bool:
    """Whether JAX is imported and has made its backends, which have read XLA's flags. No public function says
    so; False of a version of JAX that lacks this one.
    """
    bridge = sys.modules.get("jax._src.xla_bridge")
    says = getattr(bridge, "backends_are_initialized", None)
    return bool(says is not None and says())
