"""Object-informed MPPI: an xArm6 pushes an object to its goal, planned on a CPU or a GPU.

The public names are imported on first use, so that ``import oimppi_warp`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oimppi_warp.lazy import names_on_first_use

if TYPE_CHECKING:
    from oimppi_warp.config import Config
    from oimppi_warp.cost_terms import CostTerm
    from oimppi_warp.episode import Episode
    from oimppi_warp.errors import ConfigError, DeviceError, ObservationError, OimppiError, SceneError
    from oimppi_warp.log import EpisodeLog
    from oimppi_warp.methods import make_planner
    from oimppi_warp.metrics import Metrics, summarize
    from oimppi_warp.observation import Observation, planar_pose, planar_transform
    from oimppi_warp.planner import Plan, Planner
    from oimppi_warp.plant import Contacts, Plant, SimulatedPlant
    from oimppi_warp.presets import best, paper
    from oimppi_warp.registries import COST_TERMS, ENGINES, METHODS, OPTIMIZERS, PLANTS
    from oimppi_warp.run_spec import RunSpec
    from oimppi_warp.scene import Scene
    from oimppi_warp.settings import set_option
    from oimppi_warp.usd import load_scene
    from oimppi_warp.world import World

__version__ = "0.1.0"

_MODULES = {
    "COST_TERMS": "registries",
    "ENGINES": "registries",
    "METHODS": "registries",
    "OPTIMIZERS": "registries",
    "PLANTS": "registries",
    "Config": "config",
    "ConfigError": "errors",
    "Contacts": "plant",
    "CostTerm": "cost_terms",
    "DeviceError": "errors",
    "Episode": "episode",
    "EpisodeLog": "log",
    "Metrics": "metrics",
    "Observation": "observation",
    "ObservationError": "errors",
    "OimppiError": "errors",
    "Plan": "planner",
    "Planner": "planner",
    "Plant": "plant",
    "RunSpec": "run_spec",
    "Scene": "scene",
    "SceneError": "errors",
    "SimulatedPlant": "plant",
    "World": "world",
    "best": "presets",
    "load_scene": "usd",
    "make_planner": "methods",
    "paper": "presets",
    "planar_pose": "observation",
    "planar_transform": "observation",
    "set_option": "settings",
    "summarize": "metrics",
}

__all__ = [
    "COST_TERMS",
    "ENGINES",
    "METHODS",
    "OPTIMIZERS",
    "PLANTS",
    "Config",
    "ConfigError",
    "Contacts",
    "CostTerm",
    "DeviceError",
    "Episode",
    "EpisodeLog",
    "Metrics",
    "Observation",
    "ObservationError",
    "OimppiError",
    "Plan",
    "Planner",
    "Plant",
    "RunSpec",
    "Scene",
    "SceneError",
    "SimulatedPlant",
    "World",
    "best",
    "load_scene",
    "make_planner",
    "paper",
    "planar_pose",
    "planar_transform",
    "set_option",
    "summarize",
]

__getattr__, __dir__ = names_on_first_use(__name__, _MODULES, globals())
