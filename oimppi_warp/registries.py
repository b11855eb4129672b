"""All registries, with the locations of their shipped entries. Importing this module does not import the entries."""

from __future__ import annotations

from typing import Any

from oimppi_warp.registry import Registry

METHODS: Registry[Any] = Registry(
    "method",
    "oimppi_warp.methods",
    {
        "mppi": "oimppi_warp.planning.planner:Planner",
        "soi": "oimppi_warp.planning.soi:SequentialPlanner",
        "cloi": "oimppi_warp.planning.cloi:ClosedLoopPlanner",
    },
)
"""Planning methods: subclasses of :class:`oimppi_warp.planning.planner.Planner`."""

OPTIMIZERS: Registry[Any] = Registry(
    "optimizer",
    "oimppi_warp.optimizers",
    {"mppi": "oimppi_warp.planning.optimizers.mppi:Mppi", "cem": "oimppi_warp.planning.optimizers.cem:Cem"},
)
"""Sampling-based optimisers of a control sequence, for both levels: subclasses of
:class:`oimppi_warp.planning.optimizers.optimizer.Optimizer`."""

ENGINES: Registry[Any] = Registry(
    "engine",
    "oimppi_warp.engines",
    {
        "quasistatic": "oimppi_warp.planning.engines.quasistatic:QuasistaticDynamics",
        "newton": "oimppi_warp.planning.engines.factory:newton",
    },
)
"""Rollout engines of the robot level (:class:`oimppi_warp.planning.engines.dynamics.RobotDynamics`)."""

PLANTS: Registry[Any] = Registry(
    "plant",
    "oimppi_warp.plants",
    {
        "ideal": "oimppi_warp.plants.plant:ideal_plant",
        "lab": "oimppi_warp.plants.lab:lab_plant",
        "pusht": "oimppi_warp.plants.pusht:PushT",
        "xarm": "oimppi_warp.plants.xarm.plant:XArmPlant",
        "ros2": "oimppi_warp.plants.ros2.plant:Ros2Plant",
    },
    from_files=True,
)
"""Functions or classes that make a plant to control, ``(scene, config, *, seed) -> Plant``
(:class:`oimppi_warp.plants.plant.Plant`), of which ``config`` and ``seed`` may be left out; further keyword arguments
are options (``--plant-options``)."""

COST_TERMS: Registry[Any] = Registry("cost term", "oimppi_warp.cost_terms", {})
"""Cost terms of the robot level, in addition to the built-in ones (:class:`oimppi_warp.CostTerm`)."""

SHAPES: Registry[Any] = Registry(
    "shape",
    "oimppi_warp.shapes",
    {
        "t-block": "oimppi_warp.authoring.named_shapes:T_BLOCK",
        "lab-t": "oimppi_warp.authoring.named_shapes:LAB_T",
        "soup-can": "oimppi_warp.authoring.named_shapes:SOUP_CAN",
        "letter-i": "oimppi_warp.authoring.named_shapes:LETTER_I",
        "letter-r": "oimppi_warp.authoring.named_shapes:LETTER_R",
        "letter-o": "oimppi_warp.authoring.named_shapes:LETTER_O",
        "letter-s": "oimppi_warp.authoring.named_shapes:LETTER_S",
        "letter": "oimppi_warp.authoring.named_shapes:LETTER",
        "text": "oimppi_warp.authoring.named_shapes:TEXT",
        "box": "oimppi_warp.authoring.named_shapes:BOX",
        "cylinder": "oimppi_warp.authoring.named_shapes:CYLINDER",
        "prism": "oimppi_warp.authoring.named_shapes:PRISM",
        "mesh": "oimppi_warp.authoring.named_shapes:MESH",
        "mjcf": "oimppi_warp.authoring.named_shapes:MJCF",
    },
)
"""Named shapes of objects and obstacles, such as ``letter:S`` (:class:`oimppi_warp.authoring.named_shapes.Shape`)."""
