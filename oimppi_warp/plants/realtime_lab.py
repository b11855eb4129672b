"""A laboratory simulated in real time, behind whatever interface its arm and its camera have."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque

import numpy as np

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.physics.world import World
from oimppi_warp.plants.detector import Detection, Detector
from oimppi_warp.plants.plant import Contacts, SimulatedPlant
from oimppi_warp.priority import real_time_priority, without_pauses
from oimppi_warp.scene import PlanarPose, Scene

CYCLE = 0.004
"""Cycle of the arm's controller [s]."""
_SUBSTEPS = 2
"""Physics steps per cycle."""
_LATE = 0.1
"""Largest delay behind the clock that the simulation catches up; beyond it, simulated time stands still [s]."""


class RealTimeLab(ABC):
    """A scene's arm and object, simulated in real time, and a camera.

    It runs in a thread from :meth:`start` to :meth:`close`, and can be watched and disturbed meanwhile.

    Args:
        scene: The task.
        lab: Errors of the camera.
        start: Start pose of the object; ``None``: the scene's.
        joints: Joint positions to begin with, shape [dof] [rad]; ``None``: the scene's start pose of the arm.
        seed: Seed of the camera's errors.

    Attributes:
        plant: The simulated arm and object.
        seeing: Whether the camera works; to be switched off as a fault.
        shift: Offset that the camera adds to every pose, shape [3] [m, m, rad], as a fault.
        clock_error: Offset of the camera's clock [s], as a fault.
        forces: Largest contact forces so far.
        late: Longest time that the simulation was behind the clock [s].
    """

    def __init__(
        self,
        scene: Scene,
        lab: LabConfig,
        *,
        start: PlanarPose | None = None,
        joints: np.ndarray | None = None,
        seed: int = 0,
    ) -> None:
        world = World(scene)
        self._scene, self._lab = scene, lab
        self.plant = SimulatedPlant(world, start=start, control_period=CYCLE, substeps=_SUBSTEPS)
        if joints is not None:
            pose = scene.start if start is None else start
            self.plant.place(joints, planar_transform(pose, scene.object.rest_height))
        self._dofs = world.mujoco.joint_qvel
        self._detector = Detector(world, lab, seed=seed)
        self.seeing, self.shift, self.clock_error = True, np.zeros(3), 0.0
        self.forces = Contacts(0.0, 0.0, 0.0, 0.0)
        self.late = 0.0
        self._open = True
        self._failure: BaseException | None = None
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="oimppi-lab", daemon=True)

    @abstractmethod
    def drive(self) -> np.ndarray:
        """Returns the joint velocities of the next :data:`CYCLE`, shape [dof] [rad/s]."""

    @abstractmethod
    def sense(self, state: Observation) -> None:
        """Takes the exact state after each :data:`CYCLE`, as the arm's sensors measure it."""

    @abstractmethod
    def see(self, pose: np.ndarray, stamp: float) -> None:
        """Takes a detection of the object.

        Args:
            pose: Planar pose, shape [3] [m, m, rad].
            stamp: Time at which the image was taken, in seconds since 1970.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Ends what serves the arm and the camera."""

    def start(self) -> None:
        """Begins to simulate."""
        self._thread.start()

    def close(self) -> None:
        """Stops simulating and serving.

        Raises:
            FloatingPointError: The simulation had diverged.
        """
        self._open = False
        if self._thread.is_alive():
            self._thread.join()
        self.disconnect()
        if self._failure is not None:
            raise self._failure

    @property
    def running(self) -> bool:
        """Returns whether the simulation goes on."""
        return self._thread.is_alive()

    def state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns joint positions [dof], joint velocities [dof] and the object's planar pose [3], all exact."""
        with self._lock:
            seen = self.plant.observe()
        return seen.joint_position, seen.joint_velocity, seen.object_pose

    def _run(self) -> None:
        with real_time_priority(), without_pauses():  # as a controller of its own would have
            self._simulate()

    def _simulate(self) -> None:
        began = time.monotonic()
        cycle, next_picture = 0, 0.0
        pictures: deque[tuple[Detection, float]] = deque()
        try:
            while self._open:
                now = cycle * CYCLE
                with self._lock:
                    self.plant.apply(self.drive())
                    self.sense(self.plant.observe())
                    forces, before = vars(self.plant.contacts), vars(self.forces)
                self.forces = Contacts(**{name: max(before[name], forces[name]) for name in before})
                if now >= next_picture - 1e-9:
                    next_picture += 1.0 / self._lab.rate
                    found = self._detector.detect(self.plant.observe(), now)
                    if found is not None and self.seeing:
                        pictures.append((found, time.time()))
                while pictures and pictures[0][0].due <= now:
                    found, stamp = pictures.popleft()
                    self.see(found.pose + self.shift, stamp + self.clock_error)
                cycle += 1
                left = began + cycle * CYCLE - time.monotonic()
                self.late = max(self.late, -left)
                if left > 0.0:
                    time.sleep(left)
                elif left < -_LATE:  # this machine was too slow: time stood still meanwhile
                    began -= left
        except FloatingPointError as error:
            self._failure = error
