"""Films: one frame for each moment, and what moves in the log moves in them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from PIL import Image, ImageSequence
from support.synthetic_episode import make_log

from oimppi_warp.plots.film import FPS, film
from oimppi_warp.usd import load_scene


def test_a_film_has_a_frame_for_each_moment_and_the_object_moves_in_it(tmp_path):
    log = make_log(steps=40, arrive=1.0)
    seconds = float(log["time"][-1] - log["time"][0])
    frames = film(log, load_scene("task01"), tmp_path / "film.gif", speed=2.0)
    assert abs(frames - seconds / 2.0 * FPS) <= 2
    with Image.open(tmp_path / "film.gif") as image:
        shown = [np.asarray(frame.convert("L"), float) for frame in ImageSequence.Iterator(image)]
    assert len(shown) == frames
    assert all(np.abs(a - b).max() > 50.0 for a, b in pairwise(shown[:-1]))
