"""Programs that are kept whole on the disk."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from gtr_jax import kept as kept_module
from gtr_jax import stored


class Line(eqx.Module):
    """a x + b, or its absolute value."""

    a: Array
    b: Array
    rectified: bool = eqx.field(static=True)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A function that is kept in a folder of the test, anew at each call, and how often it was traced."""
    monkeypatch.setattr(stored, "_root", tmp_path)
    traced = []

    def build():
        @stored.Stored
        def value(line: Line, x: Array, times: int) -> tuple[Array, ...]:
            traced.append(x.shape)
            y = times * (line.a * x + line.b)
            return jnp.abs(y) if line.rectified else y, y.sum()

        value.__module__ = "gtr_jax"
        return value

    return build, traced, tmp_path


LINE = Line(jnp.asarray(2.0), jnp.asarray(-1.0), False)
X = jnp.linspace(-1.0, 1.0, 5)


def test_a_program_is_traced_once_and_then_read(kept):
    build, traced, folder = kept
    first, second = build()(LINE, X, 3), build()(LINE, X, 3)
    np.testing.assert_array_equal(first[0], 3 * (2 * X - 1))
    np.testing.assert_array_equal(first[0], second[0])
    assert len(traced) == 1 and len(list(folder.glob("programs-*/*"))) == 1
    # Another value needs no other program; what is static, and another shape, do.
    other = eqx.tree_at(lambda line: line.a, LINE, jnp.asarray(5.0))
    np.testing.assert_array_equal(build()(other, X, 3)[0], 3 * (5 * X - 1))
    assert len(traced) == 1
    for arguments in ((LINE, X, 4), (LINE, X[:3], 3), (Line(LINE.a, LINE.b, True), X, 3)):
        build()(*arguments)
    assert len(traced) == 4


def test_a_file_that_cannot_be_read_is_made_anew(kept):
    build, traced, folder = kept
    build()(LINE, X, 3)
    (file,) = folder.glob("programs-*/*")
    file.write_bytes(b"no program")
    np.testing.assert_array_equal(build()(LINE, X, 3)[0], 3 * (2 * X - 1))
    np.testing.assert_array_equal(build()(LINE, X, 3)[0], 3 * (2 * X - 1))
    assert len(traced) == 2


def test_under_a_transformation_it_is_an_ordinary_function(kept):
    build, _, folder = kept
    slope = jax.grad(lambda b: build()(Line(LINE.a, b, False), X, 3)[1])(jnp.asarray(0.5))
    assert float(slope) == pytest.approx(15.0) and not list(folder.glob("programs-*"))


def test_programs_of_other_sources_are_cleared_away(kept):
    build, _, folder = kept
    for k in range(4):
        (folder / f"programs-{k}").mkdir()
        (folder / f"programs-{k}" / "old").write_bytes(b"")
    build()(LINE, X, 3)
    assert len(list(folder.glob("programs-*"))) == kept_module.EARLIER + 1


def test_a_program_from_the_compilation_cache_does_no_harm(kept, tmp_path, monkeypatch):
    """What XLA read from its own cache may not be written again: such a program is run, but not kept."""
    build, _, folder = kept
    build()(LINE, X, 3)
    (file,) = folder.glob("programs-*/*")
    file.unlink()
    for _ in range(2):
        np.testing.assert_array_equal(build()(LINE, X, 3)[0], 3 * (2 * X - 1))


def test_no_program_is_kept_that_a_users_term_may_be_in(kept, monkeypatch):
    build, traced, folder = kept
    monkeypatch.setattr(stored, "_ours", True)  # as it was, once the test is over
    build()(LINE, X, 3)
    stored.keep_none()
    np.testing.assert_array_equal(build()(LINE, X, 3)[0], 3 * (2 * X - 1))
    assert len(traced) == 2 and len(list(folder.glob("programs-*/*"))) == 1
