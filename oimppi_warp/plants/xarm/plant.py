"""The plant ``xarm``: a real xArm, moved by joint velocities through the vendor's SDK."""

from __future__ import annotations

from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.network import split_address
from oimppi_warp.perception.pose_feed import PORT as POSE_PORT
from oimppi_warp.perception.pose_feed import PoseReceiver
from oimppi_warp.perception.pose_source import PoseSource
from oimppi_warp.plants.real.plant import ArmOptions, ArmPlant, ticks_of
from oimppi_warp.plants.xarm.arm import XArm
from oimppi_warp.plants.xarm.protocol import COMMAND_PORT
from oimppi_warp.priority import real_time_priority
from oimppi_warp.scene import Scene


class XArmPlant(ArmPlant):
    """An xArm at a scene's table, and the object's pose from a camera.

    Args:
        scene: The task.
        config: All settings.
        seed: Not used.
        robot_address: Address of the controller, ``HOST`` or ``HOST:PORT``.
        pose_address: Address of the object's poses (:mod:`oimppi_warp.perception.pose_feed`); empty: that of the
            controller, as with the emulator.
        speed, yes, dry_run, resume, pose_timeout: See :class:`oimppi_warp.plants.real.plant.ArmOptions`.
        poses: Source of the object's poses in this process, such as a camera, instead of an address.

    Raises:
        ConfigError: An option cannot be used, or the SDK is not installed.
        HardwareError: The arm or the camera cannot be used, or the arm was not allowed to move.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        *,
        seed: int = 0,
        robot_address: str = "",
        pose_address: str = "",
        speed: float = 0.0,
        yes: bool = False,
        dry_run: bool = False,
        resume: bool = False,
        pose_timeout: float = 2.5,
        poses: PoseSource | None = None,
    ) -> None:
        if not robot_address:
            raise ConfigError(
                "--plant xarm needs the address of the controller\n  to do:   --robot-address 192.168.1.x"
            )
        options = ArmOptions(speed=speed, yes=yes, dry_run=dry_run, resume=resume, pose_timeout=pose_timeout)
        ticks_of(config)
        host, _ = split_address(robot_address, COMMAND_PORT)
        poses = poses or PoseReceiver(pose_address or f"{host}:{POSE_PORT}")
        try:
            with real_time_priority():  # for the threads of the SDK
                arm = XArm(robot_address)
        except BaseException:
            poses.close()
            raise
        super().__init__(scene, config, arm, poses, options)
