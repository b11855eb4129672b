"""Object-informed MPPI: plans, on a CPU or a GPU, how an arm pushes an object to its goal.

Public names are imported when they are first used, so that ``import oimppi_warp`` is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oimppi_warp.lazy import names_on_first_use

if TYPE_CHECKING:
    from oimppi_warp.config.overrides import set_option
    from oimppi_warp.config.presets import best, paper, paper_printed
    from oimppi_warp.config.run_spec import RunSpec
    from oimppi_warp.config.settings import Config
    from oimppi_warp.errors import ConfigError, DeviceError, ObservationError, OimppiError, SceneError
    from oimppi_warp.observation import Observation, planar_pose, planar_transform
    from oimppi_warp.physics.world import World
    from oimppi_warp.planning.engines.cost_terms import CostTerm
    from oimppi_warp.planning.factory import make_planner
    from oimppi_warp.planning.plan import Plan, PlanDetails
    from oimppi_warp.planning.planner import Planner
    from oimppi_warp.plants.plant import Contacts, Plant, SimulatedPlant
    from oimppi_warp.record.log import EpisodeLog
    from oimppi_warp.record.metrics import Metrics, summarize
    from oimppi_warp.registries import COST_TERMS, ENGINES, METHODS, OPTIMIZERS, PLANTS, SHAPES
    from oimppi_warp.runtime.episode import Episode
    from oimppi_warp.scene import Scene
    from oimppi_warp.usd import load_scene

__version__ = "0.1.0"

_MODULES = {
    "COST_TERMS": "registries",
    "ENGINES": "registries",
    "METHODS": "registries",
    "OPTIMIZERS": "registries",
    "PLANTS": "registries",
    "SHAPES": "registries",
    "Config": "config.settings",
    "ConfigError": "errors",
    "Contacts": "plants.plant",
    "CostTerm": "planning.engines.cost_terms",
    "DeviceError": "errors",
    "Episode": "runtime.episode",
    "EpisodeLog": "record.log",
    "Metrics": "record.metrics",
    "Observation": "observation",
    "ObservationError": "errors",
    "OimppiError": "errors",
    "Plan": "planning.plan",
    "PlanDetails": "planning.plan",
    "Planner": "planning.planner",
    "Plant": "plants.plant",
    "RunSpec": "config.run_spec",
    "Scene": "scene",
    "SceneError": "errors",
    "SimulatedPlant": "plants.plant",
    "World": "physics.world",
    "best": "config.presets",
    "load_scene": "usd",
    "make_planner": "planning.factory",
    "paper": "config.presets",
    "paper_printed": "config.presets",
    "planar_pose": "observation",
    "planar_transform": "observation",
    "set_option": "config.overrides",
    "summarize": "record.metrics",
}

__all__ = [
    "COST_TERMS",
    "ENGINES",
    "METHODS",
    "OPTIMIZERS",
    "PLANTS",
    "SHAPES",
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
    "PlanDetails",
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
    "paper_printed",
    "planar_pose",
    "planar_transform",
    "set_option",
    "summarize",
]

__getattr__, __dir__ = names_on_first_use(__name__, _MODULES, globals())
