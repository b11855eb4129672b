"""Every registry, and where its shipped entries are. Importing this module imports none of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oimppi_warp.registry import Registry

if TYPE_CHECKING:
    from oimppi_warp.authoring.shapes import Shape

METHODS: Registry[Any] = Registry(
    "method",
    "oimppi_warp.methods",
    {
        "mppi": "oimppi_warp.planner:Planner",
        "soi": "oimppi_warp.methods:SequentialPlanner",
        "cloi": "oimppi_warp.methods:ClosedLoopPlanner",
    },
)
"""Who replans when: subclasses of :class:`oimppi_warp.planner.Planner`."""

OPTIMIZERS: Registry[Any] = Registry(
    "optimizer", "oimppi_warp.optimizers", {"mppi": "oimppi_warp.mppi:Mppi", "cem": "oimppi_warp.cem:Cem"}
)
"""Sampling-based optimisers of a control sequence, for either level."""

ENGINES: Registry[Any] = Registry(
    "engine",
    "oimppi_warp.engines",
    {
        "quasistatic": "oimppi_warp.dynamics.quasistatic:QuasistaticDynamics",
        "newton": "oimppi_warp.dynamics.engines:newton",
    },
)
"""Rollout engines of the robot level (:class:`oimppi_warp.dynamics.base.RobotDynamics`)."""

PLANTS: Registry[Any] = Registry(
    "plant",
    "oimppi_warp.plants",
    {"ideal": "oimppi_warp.plant:ideal_plant", "lab": "oimppi_warp.lab:lab_plant"},
)
"""What is moved: ``(scene, config, *, seed) -> Plant`` (:class:`oimppi_warp.plant.Plant`)."""

COST_TERMS: Registry[Any] = Registry("cost term", "oimppi_warp.cost_terms", {})
"""Cost terms of the robot level beside the built-in ones (:class:`oimppi_warp.cost_terms.CostTerm`)."""

SHAPES: Registry[Shape] = Registry(
    "shape",
    "oimppi_warp.shapes",
    {
        "t-block": "oimppi_warp.authoring.shapes:T_BLOCK",
        "lab-t": "oimppi_warp.authoring.shapes:LAB_T",
        "soup-can": "oimppi_warp.authoring.shapes:SOUP_CAN",
        "letter-i": "oimppi_warp.authoring.shapes:LETTER_I",
        "letter-r": "oimppi_warp.authoring.shapes:LETTER_R",
        "letter-o": "oimppi_warp.authoring.shapes:LETTER_O",
        "letter-s": "oimppi_warp.authoring.shapes:LETTER_S",
        "letter": "oimppi_warp.authoring.shapes:LETTER",
        "text": "oimppi_warp.authoring.shapes:TEXT",
        "box": "oimppi_warp.authoring.shapes:BOX",
        "cylinder": "oimppi_warp.authoring.shapes:CYLINDER",
        "prism": "oimppi_warp.authoring.shapes:PRISM",
        "mesh": "oimppi_warp.authoring.shapes:MESH",
    },
)
"""Objects and obstacles by words, as ``letter:S`` (:class:`oimppi_warp.authoring.shapes.Shape`)."""
