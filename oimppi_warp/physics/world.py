"""Physics models of a scene, built on demand."""

from __future__ import annotations

from functools import cached_property

from oimppi_warp.physics.mujoco_model import MujocoModel, translate_scene
from oimppi_warp.physics.newton_model import NewtonModel, build_model
from oimppi_warp.scene import Scene


class World:
    """Physics models of a scene, built on demand.

    Attributes:
        scene: The scene that they are built from.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def newton(self) -> NewtonModel:
        """Returns the Newton model of the scene, with the poses of its bodies at the start."""
        import newton

        built = build_model(self.scene)
        model = built.model
        newton.eval_fk(model, model.joint_q, model.joint_qd, model)  # pyright: ignore[reportArgumentType]
        return built

    @cached_property
    def mujoco(self) -> MujocoModel:
        """Returns the model for MuJoCo's C engine, as translated by Newton's SolverMuJoCo."""
        return translate_scene(self.scene, sensing=False)

    @cached_property
    def mujoco_sensing(self) -> MujocoModel:
        """Returns the model :attr:`mujoco` with contact force sensors, for rollouts."""
        return translate_scene(self.scene, sensing=True)
