"""Settings of the simulated lab and of the estimator, which are part of :mod:`oimppi_warp.config.settings`."""

from __future__ import annotations

from dataclasses import dataclass

from oimppi_warp.config.fields import setting


@dataclass(frozen=True)
class LabConfig:
    """Imperfections of the simulated laboratory (:class:`oimppi_warp.plants.lab.LabPlant`).

    The camera's rate is the paper's. Its noise is typical of fitting a known shape to the points of a depth camera at a
    distance of 1 m. The arm's limits and rates are from the xArm6's data sheet.
    """

    rate: float = setting(1.0, "Rate at which the camera detects the object.", unit="1/s", low=0.01, high=100.0)
    delay: float = setting(0.15, "Time from taking an image until the pose detected in it is available.", unit="s")
    position_noise: float = setting(
        0.005, "Standard deviation of a detection's position error, in each of x and y.", unit="m"
    )
    yaw_noise: float = setting(0.03, "Standard deviation of a detection's yaw error.", unit="rad")
    outlier_probability: float = setting(0.05, "Probability that a detection is an outlier.", high=1.0)
    outlier_size: float = setting(
        0.15,
        "Mean distance of an outlier from the object; the yaw of an outlier is drawn from all angles.",
        unit="m",
    )
    camera: tuple[float, float, float] = setting(
        (0.9, 0.0, 0.9),
        "Position of the camera (x, y, z); the camera does not detect the object while the arm occludes it.",
        unit="m",
        low=-100.0,
        high=100.0,
    )
    joint_noise: float = setting(
        0.0005,
        "Standard deviation of the error of each joint's measured position (m for a sliding joint).",
        unit="rad",
    )
    command_latency: float = setting(
        0.02,
        "Time from sending a command until the arm follows it, rounded to whole intervals between joint reports "
        "(10 ms); at most the control period.",
        unit="s",
    )
    acceleration_limit: float = setting(
        19.98,
        "Largest acceleration of each joint (m/s^2 for a sliding joint); the xArm's controller allows 1145 deg/s^2.",
        unit="rad/s^2",
        low=0.1,
    )


@dataclass(frozen=True)
class EstimatorConfig:
    """Assumptions of the estimator about detections and its prediction (:mod:`oimppi_warp.runtime.estimator`).

    They are independent of the laboratory's true noise.
    """

    position_noise: float = setting(0.005, "Assumed standard deviation of a detection's position error.", unit="m")
    yaw_noise: float = setting(0.03, "Assumed standard deviation of a detection's yaw error.", unit="rad")
    position_drift: float = setting(
        0.15, "Assumed error of the predicted position, as a fraction of the distance the object is predicted to move."
    )
    yaw_drift: float = setting(
        0.3, "Assumed error of the predicted yaw, as a fraction of the angle the object is predicted to turn."
    )
    touch_drift: float = setting(
        0.01,
        "Growth of the position uncertainty while the tool is within `estimator.touch` of the object and could push it "
        "unnoticed.",
        unit="m/sqrt(s)",
    )
    touch: float = setting(
        0.01, "Distance between tool and object below which `estimator.touch_drift` applies.", unit="m"
    )
    gate: float = setting(
        4.0,
        "Difference between detection and prediction, in standard deviations of this difference, beyond which the "
        "detection is rejected as an outlier.",
        low=0.1,
    )
    memory: float = setting(
        3.0,
        "Time for which measured joint positions are kept, so that a late detection is applied at its own time.",
        unit="s",
        low=0.05,
        high=5.0,
    )
