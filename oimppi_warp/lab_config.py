"""Settings of the simulated lab and of the estimator, as :mod:`oimppi_warp.config` takes them up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LabConfig:
    """How imperfect the simulated lab is (:class:`oimppi_warp.lab.LabPlant`).

    The rate is the paper's; the noise is what fitting a known shape to a depth camera's points at a metre's distance
    gives, the limits and rates of the arm are the manufacturer's.

    Attributes:
        rate: Pictures a second.
        delay: From taking a picture to knowing the pose [s].
        position_noise, yaw_noise: Standard deviation of a detection in x and in y [m], and in yaw [rad].
        outlier_probability: Share of the detections that are wrong.
        outlier_size: Mean distance of a wrong detection from the object [m]; it may have any yaw.
        camera: Position of the camera [m]: above the far side of the table, looking towards the arm.
        joint_noise: Standard deviation of each joint's measured position [rad; m where it slides].
        command_latency: From sending a command to its effect, in whole reports of the joints [s].
        acceleration_limit: Of each joint [rad/s^2; m/s^2 where it slides]; the xArm's controller has 1145 deg/s^2.
    """

    rate: float = 1.0
    delay: float = 0.15
    position_noise: float = 0.005
    yaw_noise: float = 0.03
    outlier_probability: float = 0.05
    outlier_size: float = 0.15
    camera: tuple[float, float, float] = (0.9, 0.0, 0.9)
    joint_noise: float = 0.0005
    command_latency: float = 0.02
    acceleration_limit: float = 19.98


@dataclass(frozen=True)
class EstimatorConfig:
    """What the estimator takes for granted of detections and of its own prediction; it is not told how the lab is.

    Attributes:
        position_noise, yaw_noise: Standard deviation of a detection [m], [rad].
        position_drift, yaw_drift: Error of the predicted push, as a share of how far the object is predicted to move.
        touch_drift: Error that gathers while the tool is close enough to move the object unnoticed [m/sqrt(s)].
        touch: How close that is [m].
        gate: A detection further from the prediction than this many standard deviations of their difference is
            rejected.
        memory: How far back joint positions are kept at the least; a detection that is older is of no use [s].
    """

    position_noise: float = 0.005
    yaw_noise: float = 0.03
    position_drift: float = 0.15
    yaw_drift: float = 0.3
    touch_drift: float = 0.01
    touch: float = 0.01
    gate: float = 4.0
    memory: float = 3.0
