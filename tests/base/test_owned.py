"""Nobody else's programs are run: folders that are the user's own, and sealed files."""

import os
import pickle
import stat
import warnings
from pathlib import Path

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache

from gtr_jax import cache, kept, owned, sealed
from gtr_jax.errors import InputWarning
from gtr_jax.owned import NotOwn, own_folder

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the system closes folders of users to others")
NOBODY = 65534
as_root = pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_folder_is_closed_to_others(tmp_path):
    before = os.umask(0)
    try:
        folder = own_folder(tmp_path / "one" / "two")
    finally:
        os.umask(before)
    assert (mode(folder), mode(folder.parent)) == (0o700, 0o700)


def test_a_folder_of_the_user_is_closed_and_rid_of_what_others_could_write(tmp_path):
    folder = tmp_path / "cache"
    (folder / "in").mkdir(parents=True)
    for name, bits in (("mine", 0o644), ("open", 0o666), ("in/mine", 0o600), ("in/open", 0o602)):
        (folder / name).write_text("")
        (folder / name).chmod(bits)
    (folder / "link").symlink_to("/etc/passwd")
    folder.chmod(0o777)
    assert own_folder(folder) == folder.resolve()
    assert mode(folder) == 0o700
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
    assert left == ["in", "in/mine", "mine"]
    (folder / "mine").chmod(0o666)  # nobody else gets there any more
    own_folder(folder)
    assert (folder / "mine").exists()


def test_the_root_of_a_container_may_belong_to_a_user_without_number(tmp_path, monkeypatch):
    """In a user namespace the administrator outside is the kernel's overflow user."""
    real, seen = Path.stat, {"mode": 0o40755, "uid": NOBODY}

    def stat_of(path, **options):
        found = real(path, **options)
        if path != Path("/"):
            return found
        return os.stat_result((seen["mode"], *found[1:4], seen["uid"], NOBODY, *found[6:]))

    monkeypatch.setattr(Path, "stat", stat_of)
    monkeypatch.setattr(owned, "OVERFLOW", tmp_path / "overflowuid")
    owned.OVERFLOW.write_text(f"{NOBODY}\n")
    assert own_folder(tmp_path / "cache").is_dir()
    for mode, uid in ((0o40775, NOBODY), (0o40757, NOBODY), (0o40755, NOBODY - 1)):
        seen.update(mode=mode, uid=uid)
        with pytest.raises(NotOwn):
            own_folder(tmp_path / "cache")
    seen.update(mode=0o40755, uid=NOBODY)
    owned.OVERFLOW.unlink()
    with pytest.raises(NotOwn):
        own_folder(tmp_path / "cache")


def test_a_folder_that_others_could_exchange_is_refused(tmp_path):
    above = tmp_path / "shared"
    own_folder(above / "cache")
    above.chmod(0o777)
    with pytest.raises(NotOwn, match=r"others can write to .*shared"):
        own_folder(above / "cache")
    above.chmod(0o1777)  # as /tmp: nobody moves what is not theirs
    own_folder(above / "cache")
    link = tmp_path / "link"
    link.symlink_to(above)
    assert own_folder(link / "cache") == (above / "cache").resolve()


@as_root
def test_a_folder_of_somebody_else_is_refused_and_files_of_theirs_removed(tmp_path):
    folder = own_folder(tmp_path / "cache")
    (folder / "planted").write_text("")
    os.chown(folder / "planted", NOBODY, NOBODY)
    own_folder(folder)
    assert not (folder / "planted").exists()
    os.chown(folder, NOBODY, NOBODY)
    with pytest.raises(NotOwn, match="belongs to user"):
        own_folder(folder)
    with pytest.raises(NotOwn, match="belongs to user"):
        own_folder(folder / "deeper")


def test_a_group_of_the_user_alone_is_nobody_else(monkeypatch, tmp_path):
    above = tmp_path / "above"
    own_folder(above / "cache")
    above.chmod(0o775)
    monkeypatch.setattr(owned, "_alone_in", lambda gid: True)
    own_folder(above / "cache")
    monkeypatch.setattr(owned, "_alone_in", lambda gid: False)
    with pytest.raises(NotOwn):
        own_folder(above / "cache")


@pytest.fixture
def own_key(tmp_path, monkeypatch):
    """The key of a user who has none yet."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setattr(owned.tempfile, "gettempdir", lambda: str(tmp_path))
    sealed.key.cache_clear()
    yield sealed.key
    sealed.key.cache_clear()


def test_the_key_is_the_users_alone(own_key):
    first = own_key()
    place = owned.private_place()
    assert first is not None and place is not None
    assert mode(place / "key") == 0o600 and [*place.iterdir()] == [place / "key"]
    own_key.cache_clear()
    assert own_key() == first
    (place / "key").chmod(0o644)  # others may have read it
    own_key.cache_clear()
    assert own_key() not in (None, first)
    (place / "key").write_bytes(b"short")
    own_key.cache_clear()
    assert len(own_key() or b"") == 32


def test_only_what_this_user_sealed_under_this_name_is_read(own_key, tmp_path):
    one = tmp_path / "programs" / "one"
    sealed.write(one, b"program")
    assert sealed.read(one) == b"program" and sealed.read(one.with_name("two")) is None
    one.with_name("two").write_bytes(one.read_bytes())
    assert sealed.read(one.with_name("two")) is None
    one.write_bytes(one.read_bytes()[:-1] + b"X")
    assert sealed.read(one) is None
    one.write_bytes(b"program")
    assert sealed.read(one) is None
    one.unlink()
    os.mkfifo(one)
    assert sealed.read(one) is None
    sealed.write(one, b"program")
    place = owned.private_place()
    assert place is not None
    (place / "key").unlink()
    own_key.cache_clear()
    assert sealed.read(one) is None  # of another user's key


class Planted:
    def __init__(self, told):
        self.told = told

    def __reduce__(self):
        return Path.write_text, (self.told, "ran")


def test_a_planted_pickle_is_not_run(own_key, tmp_path):
    """As one in the place of a stored program was."""
    from gtr_jax import stored

    folder, told = tmp_path / "cache" / "programs-x", tmp_path / "told"
    folder.mkdir(parents=True)
    (folder / "key").write_bytes(pickle.dumps(Planted(told)))
    place = kept.Kept("programs", "x", lambda: tmp_path / "cache")
    assert stored._read(place, "key", []) is None
    assert not told.exists()
    pickle.loads((folder / "key").read_bytes())
    assert told.exists()  # as it would have done


@pytest.fixture
def settings(monkeypatch, tmp_path):
    """JAX's settings, as they were once the test is over; the user's folders in that of the test."""
    names = ("compilation_cache_dir", "persistent_cache_min_compile_time_secs")
    names = [f"jax_{name}" for name in (*names, "persistent_cache_min_entry_size_bytes")]
    before = {name: getattr(jax.config, name) for name in names}
    monkeypatch.setattr("gtr_jax.stored._root", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


def test_a_cache_that_others_can_write_gives_way_to_a_private_one(settings, monkeypatch, tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("GTR_JAX_CACHE", str(shared))
    with pytest.warns(
        InputWarning, match=r"others can write to .*shared.* kept in .*user.* of your own"
    ) as said:
        folder = cache.enable_cache()
    assert len(said) == 1 and folder is not None and folder.is_relative_to(tmp_path / "user")
    assert jax.config.values["jax_compilation_cache_dir"] == str(folder)
    shared.chmod(0o700)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        folder = cache.enable_cache()
    assert folder is not None and folder.is_relative_to(shared) and mode(folder) == 0o700


@as_root
def test_a_cache_of_somebody_else_gives_way_to_a_private_one(settings, monkeypatch, tmp_path):
    monkeypatch.setenv("GTR_JAX_CACHE", str(tmp_path / "theirs"))
    wanted = cache.cache_folder()
    assert wanted is not None
    wanted.mkdir(parents=True)
    wanted.chmod(0o777)
    os.chown(wanted, NOBODY, NOBODY)
    with pytest.warns(InputWarning, match="belongs to user"):
        folder = cache.enable_cache()
    assert folder is not None and folder.is_relative_to(tmp_path / "user")
