"""Benchmarks: speed against the project's targets, and the study that chose the solver and the mesh.

XLA's CPU backend runs every operation of a loop's body as a kernel of its own unless one pass of the body
touches fewer bytes than a threshold, 1 kB by default. The march over the nodes lies above; with 100 kB the
whole march is one kernel, and a history of marches too. `python -m benchmarks --only loops` measures what
that is worth.
"""

import os

LOOP_THRESHOLD = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000"

if "xla_backend_extra_options" not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {LOOP_THRESHOLD}".strip()
