"""The mechanics as native code: the same equations, translated from what JAX traces of them.

XLA has an overhead for every scalar operation of a small loop; compiled code has none. Where no derivative is
needed, a load history is three times as fast this way, and up to nine times where four go side by side
(`python -m benchmarks.native`). The equations are not written a second time: `translate` turns the traced
program of a load step into LLVM's intermediate representation, `program` compiles it, keeps it on disk and
runs it.
"""
