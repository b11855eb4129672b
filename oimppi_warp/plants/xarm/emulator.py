"""An emulated laboratory in real time: the simulated arm behind an emulated controller, and the camera's poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import Observation
from oimppi_warp.perception import pose_feed
from oimppi_warp.perception.pose_feed import PoseServer
from oimppi_warp.plants.realtime_lab import CYCLE, RealTimeLab
from oimppi_warp.plants.xarm.controller import EmulatedController
from oimppi_warp.plants.xarm.protocol import COMMAND_PORT, REPORT_PORTS
from oimppi_warp.plants.xarm.server import ControllerServer
from oimppi_warp.scene import PlanarPose, Scene


class LabEmulator(RealTimeLab):
    """A simulated laboratory whose arm and camera are reachable over TCP like those of a real one.

    The vendor's SDK connects to it as to a real controller.

    Args:
        scene, lab, start, joints, seed: See :class:`oimppi_warp.plants.realtime_lab.RealTimeLab`.
        host: Address to listen on.
        command_port: Port of the controller's commands.
        report_ports: Ports of its reports, by kind.
        pose_port: Port of the object's poses.

    Attributes:
        controller: The controller.
        server: Its servers.
        poses: The server of the object's poses.

    Raises:
        HardwareError: An address cannot be listened on.
    """

    def __init__(
        self,
        scene: Scene,
        lab: LabConfig,
        *,
        start: PlanarPose | None = None,
        joints: np.ndarray | None = None,
        seed: int = 0,
        host: str = "127.0.0.2",
        command_port: int = COMMAND_PORT,
        report_ports: Mapping[str, int] = REPORT_PORTS,
        pose_port: int = pose_feed.PORT,
    ) -> None:
        super().__init__(scene, lab, start=start, joints=joints, seed=seed)
        self.controller = EmulatedController(scene.robot)
        self.sense(self.plant.observe())
        self.server = ControllerServer(self.controller, host, command_port=command_port, report_ports=report_ports)
        try:
            self.poses = PoseServer(host, pose_port)
        except Exception:
            self.server.close()
            raise

    def drive(self) -> np.ndarray:
        """Returns the joint velocities of the next cycle, as the controller drives them, shape [dof] [rad/s]."""
        return self.controller.tick(CYCLE)

    def sense(self, state: Observation) -> None:
        """Tells the controller what the arm's sensors measure."""
        data = self.plant.data
        torques = data.qfrc_gravcomp[self._dofs] + data.qfrc_actuator[self._dofs]
        contact = data.qfrc_constraint[self._dofs]
        tip = tip_frame(self._scene.robot, state.joint_position)[1]
        self.controller.sense(state.joint_position, state.joint_velocity, torques, contact, tip)

    def see(self, pose: np.ndarray, stamp: float) -> None:
        """Serves a detection."""
        self.poses.publish(pose, stamp)

    def disconnect(self) -> None:
        """Ends the servers."""
        self.server.close()
        self.poses.close()
