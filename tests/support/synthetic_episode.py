"""An episode and a scene that need neither planner nor USD: the object glides along an arc to its goal."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.record.metrics import pose_error
from oimppi_warp.scene import Collider, Joint, Link, Obstacle, PushedObject, Robot, Scene, Table, Tolerance

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
START, GOAL = (0.30, -0.45, 0.0), (0.50, 0.30, 3.1)


def at(x: float, y: float, z: float) -> np.ndarray:
    """A transform that only translates."""
    return np.array([x, y, z, 0.0, 0.0, 0.0, 1.0])


def box(path: str, where: tuple[float, float, float], size: tuple[float, float, float]) -> Collider:
    """A box by its centre and whole size [m]."""
    return Collider(path, "box", at(*where), (size[0] / 2, size[1] / 2, size[2] / 2))


def make_scene() -> Scene:
    """A T block, one cube in its way, and an arm of one joint."""
    base = Link("/robot/base", 2.7, (Collider("/robot/base/c", "cylinder", at(0, 0, 0.1), (0.09, 0.1)),))
    joint = Joint("/robot/joint", IDENTITY, -3.0, 3.0, 1.0, 50.0)
    robot = Robot(
        "/robot", base, (joint,), (Link("/robot/link", 1.0, ()),), at(0, 0, 0.2), "/robot/tip", 0.01, np.zeros(1)
    )
    block = (box("/t/bar", (0, 0, 0), (0.20, 0.05, 0.05)), box("/t/stem", (0, -0.075, 0), (0.05, 0.10, 0.05)))
    return Scene(
        file=Path("synthetic.usda"),
        name="synthetic",
        title="A T around a cube.",
        robot=robot,
        object=PushedObject("/t", 0.5, 0.4, 0.3, np.array([0.0, -0.025, 0.0]), block, 0.025),
        table=Table("/table", (-0.2, -0.9), (1.0, 0.9)),
        obstacles=(Obstacle("/cube", (box("/cube/c", (0.5, 0.05, 0.05), (0.1, 0.1, 0.1)),)),),
        start=START,
        starts=np.array([START, (0.32, -0.43, 0.1)]),
        spread=(0.06, 0.45),
        goal=GOAL,
        tolerance=Tolerance(0.2, 0.5),
        tight_tolerance=Tolerance(0.05, 0.1),
    )


def make_log(*, steps: int = 200, arrive: float = 1.0, method: str = "cloi", plan_ms: float = 10.0) -> EpisodeLog:
    """An episode of ``steps`` control steps that covers the fraction ``arrive`` of the way."""
    header = {
        "scene": "synthetic",
        "file": "synthetic.usda",
        "method": method,
        "engine": "quasistatic",
        "device": "cpu",
        "preset": "best",
        "seed": 3,
        "config": {},
        "start": START,
        "goal": GOAL,
        "tolerance": {"position": 0.2, "yaw": 0.5},
        "tight_tolerance": {"position": 0.05, "yaw": 0.1},
        "hold_seconds": 0.5,
        "control_period": 0.05,
        "cost_terms": ["goal", "reference", "tool_distance", "align"],
        "preplan_time_s": 2.0 if method == "soi" else 0.0,
        "ended": "success" if arrive == 1.0 else "time limit",
        "versions": {"python": "3.11"},
    }
    log = EpisodeLog(header)
    for step in range(steps):
        part = arrive * (step + 1) / steps
        angle = np.pi * part
        pose = np.array(START) * (1 - part) + np.array(GOAL) * part - np.array([0.15 * np.sin(angle), 0, 0])
        position_error, yaw_error = pose_error(pose, GOAL)
        if step % 10 == 0:
            log.add_reference(np.linspace(pose, GOAL, 60))
        log.append(
            time=0.05 * (step + 1),
            joint_position=np.full(6, part),
            joint_velocity=np.full(6, 0.1),
            command=np.full(6, 0.1),
            tool_position=np.array([pose[0] + 0.03 * np.sin(0.3 * step), pose[1] - 0.1, 0.02]),
            object_pose=pose,
            position_error=position_error,
            yaw_error=yaw_error,
            clearance=0.05 + 0.1 * abs(part - 0.6),
            contact_tool_object=2.0 * part,
            contact_object_obstacle=0.0,
            contact_robot_obstacle=0.0,
            plan_ms=plan_ms + step % 7,
            object_plan_ms=3.0 + 0.1 * (step % 5),
            effective_samples=20.0 + 10 * np.sin(step),
            object_effective_samples=50.0,
            min_cost=100 * (1 - part) + 1,
            cost_terms=np.array([5.0, 20.0 * (1 - part), 3.0 * part, 1.0]),
            lost_samples=0,
        )
    return log
