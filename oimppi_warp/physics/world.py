"""A scene as physics, built when it is asked for."""

from __future__ import annotations

from functools import cached_property

from oimppi_warp.physics.mujoco_model import MujocoModel, translate_scene
from oimppi_warp.physics.newton_model import NewtonModel, build_model
from oimppi_warp.scene import Scene


class World:
    """A scene's physics, built when it is asked for.

    Attributes:
        scene: What it is built from, and all that it is built from.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def newton(self) -> NewtonModel:
        """The Newton model of the scene."""
        return build_model(self.scene)

    @cached_property
    def mujoco(self) -> MujocoModel:
        """The same for MuJoCo's C engine, as Newton's SolverMuJoCo translates it."""
        return translate_scene(self.scene, sensing=False)

    @cached_property
    def mujoco_sensing(self) -> MujocoModel:
        """:attr:`mujoco` with sensors of the contact forces, for rollouts."""
        return translate_scene(self.scene, sensing=True)
