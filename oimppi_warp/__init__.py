"""Object-informed MPPI: an xArm6 pushes an object to its goal, planned on a CPU or a GPU.

The public names are imported on first use, so that ``import oimppi_warp`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oimppi_warp.lazy import names_on_first_use

if TYPE_CHECKING:
    from oimppi_warp.config import Config
    from oimppi_warp.episode import Episode
    from oimppi_warp.errors import ConfigError, DeviceError, OimppiError, SceneError
    from oimppi_warp.log import EpisodeLog
    from oimppi_warp.methods import make_planner
    from oimppi_warp.metrics import Metrics, summarize
    from oimppi_warp.plant import SimulatedPlant
    from oimppi_warp.presets import best, paper
    from oimppi_warp.scene import Scene
    from oimppi_warp.usd import load_scene
    from oimppi_warp.world import World

__version__ = "0.1.0"

_MODULES = {
    "Config": "config",
    "ConfigError": "errors",
    "DeviceError": "errors",
    "Episode": "episode",
    "EpisodeLog": "log",
    "Metrics": "metrics",
    "OimppiError": "errors",
    "Scene": "scene",
    "SceneError": "errors",
    "SimulatedPlant": "plant",
    "World": "world",
    "best": "presets",
    "load_scene": "usd",
    "make_planner": "methods",
    "paper": "presets",
    "summarize": "metrics",
}

__all__ = [
    "Config",
    "ConfigError",
    "DeviceError",
    "Episode",
    "EpisodeLog",
    "Metrics",
    "OimppiError",
    "Scene",
    "SceneError",
    "SimulatedPlant",
    "World",
    "best",
    "load_scene",
    "make_planner",
    "paper",
    "summarize",
]

__getattr__, __dir__ = names_on_first_use(__name__, _MODULES, globals())
