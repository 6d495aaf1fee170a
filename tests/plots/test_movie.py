"""Movies of simulations: frames, what they show, and names that are refused."""

import itertools
import os
import shutil

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gtr_jax.errors import InputError
from gtr_jax.plots import movie
from gtr_jax.plots.movie import Loop, check_movie, write_movie
from tests.plots.test_spatial_pictures import BODY, made_up

SHARES = (0.0, 0.5, 1.0, 0.6)
T_BASE = np.array([[0.0, 1.0], [20.0, 1.0], [45.0, 1.0], [22.0, 1.0]])


def written(folder, *, space=True, phases=None):
    path = folder / "motion.gif"
    columns = slice(None) if phases is None else slice(0, 1)
    write_movie(
        path,
        BODY,
        [made_up(f"step {k + 1}", share) for k, share in enumerate(SHARES)],
        steps=range(len(SHARES)),
        loop=Loop(T_BASE[:, columns], 0.6 * T_BASE[:, columns], phases),
        space=space,
    )
    return path


def frames_of(path):
    with Image.open(path) as image:
        frames, seconds = [], 0.0
        for frame in ImageSequence.Iterator(image):
            frames.append(np.asarray(frame.convert("RGB"), dtype=float))
            seconds += frame.info["duration"] / 1000
    return frames, seconds


@pytest.mark.parametrize("space", [True, False])
def test_a_frame_for_every_step_and_the_last_one_stands(tmp_path, space):
    phases = None if space else np.array(["pulling", "pulling", "pulling", "transition"])
    frames, seconds = frames_of(written(tmp_path, space=space, phases=phases))
    assert len(frames) == len(SHARES)
    assert seconds == pytest.approx((len(SHARES) + movie.HELD) / movie.RATE, rel=0.15)
    middle = frames[0].shape[1] // 2
    for side in (slice(0, middle), slice(middle, None)):
        moved = [np.abs(b[:, side] - a[:, side]).max() for a, b in itertools.pairwise(frames)]
        assert min(moved) > 100, "the body moves, and the point in the loop"


def test_nothing_is_cut_off(tmp_path):
    for frame in frames_of(written(tmp_path))[0]:
        rim = np.concatenate([frame[0], frame[-1], frame[:, 0], frame[:, -1]])
        assert rim.min() == 255


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("motion.avi", "must end in .gif or .mp4"),
        ("motion", "give for example motion.gif"),
        ("somewhere/motion.gif", "without folders of its own; give motion.gif"),
    ],
)
def test_names_that_are_refused(name, says):
    with pytest.raises(InputError, match=says):
        check_movie(name)


def test_mp4_without_ffmpeg_names_the_remedy(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"needs ffmpeg.*install it, or give motion\.gif"):
        check_movie("motion.mp4")
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    check_movie("motion.MP4")


def test_an_ffmpeg_that_fails_is_one_line(tmp_path, monkeypatch):
    false = tmp_path / "ffmpeg"
    false.write_text("#!/bin/sh\ncat > /dev/null\nexit 3\n")
    false.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(InputError, match=r"motion\.mp4: ffmpeg cannot write it .*; give motion\.gif"):
        write_movie(
            tmp_path / "motion.mp4",
            BODY,
            [made_up("step 1", 0.0)],
            steps=[0],
            loop=Loop(T_BASE[:2], T_BASE[:2], None),
            space=True,
        )


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_mp4(tmp_path):
    write_movie(
        tmp_path / "motion.mp4",
        BODY,
        [made_up("step 1", 0.0), made_up("step 2", 1.0)],
        steps=range(2),
        loop=Loop(T_BASE[:2], T_BASE[:2], None),
        space=True,
    )
    assert (tmp_path / "motion.mp4").read_bytes()[4:8] == b"ftyp"
