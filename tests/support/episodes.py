"""Episodes of the shipped scenes."""

from __future__ import annotations

from typing import Any

from support.device import DEVICE

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.geometry.feasibility import sample_start
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene


def episode(name: str, method: str, *, seed: int = 0, options: tuple[str, ...] = (), **run: Any) -> Episode:
    """An episode from a drawn start, with ``options`` among the settings and ``run`` among the run's options."""
    scene = load_scene(name)
    config = best(method)
    for option in options:
        config = set_option(config, option)
    return Episode(scene.with_start(sample_start(scene, seed)), config, method=method, device=DEVICE, seed=seed, **run)
