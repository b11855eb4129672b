"""Commands to a plant, with limited acceleration and jerk.

A planner gives one joint velocity per control period. Sent as such, the joints' velocities jump: the arm accelerates
beyond the limits of its data sheet, and a tool that touches the object hits it. A :class:`Drive` spreads each change of
the command over a short time instead.
"""

from __future__ import annotations

import math

import numpy as np

from oimppi_warp.config.settings import Safety
from oimppi_warp.plants.plant import Plant, StreamingPlant, latency_of


class Drive:
    """Sends joint velocities to a plant such that the joints' acceleration and jerk stay within limits.

    A change of the command takes the time ``smoothing``. Meanwhile the acceleration rises and then falls linearly, and
    is zero at the end: a change by ``d`` has the largest acceleration ``2 d / smoothing`` and the jerk
    ``4 d / smoothing^2``. A change that would exceed the limits is scaled down, by the same factor for all joints, so
    that the tool keeps its direction. The arm lags behind the commands by half of the smoothing time, less half a tick.

    A plant that takes only one joint velocity per control period (no :class:`StreamingPlant`) has to smooth the changes
    itself; they are limited to the acceleration limit times the control period.

    Args:
        plant: The plant.
        dof: Number of joints.
        safety: Limits; ``None`` sends the commands as they are.

    Attributes:
        plant: The plant.
        control_period: That of the plant [s].
        latency: Time from a command to its effect [s].
        limited: Whether the latest change of the command was scaled down.
        peak_acceleration, peak_jerk: Largest acceleration [rad/s^2] and jerk [rad/s^3] commanded in the latest control
            period; NaN without smoothing, and for a plant that is no :class:`StreamingPlant`.
    """

    def __init__(self, plant: Plant, dof: int, safety: Safety | None = None) -> None:
        self.plant = plant
        self.control_period = plant.control_period
        self.limited = False
        self.peak_acceleration = self.peak_jerk = np.nan
        self._stream = plant if isinstance(plant, StreamingPlant) else None
        self._smoothing, self._most, self._tick = 0.0, np.inf, plant.control_period
        if safety is not None and safety.smoothing > 0.0:
            if self._stream is None:
                self._most = safety.acceleration_limit * self.control_period
            else:
                self._smoothing = safety.smoothing
                self._tick = self.control_period / self._stream.ticks
                self._most = safety.most_change(self.control_period)
        self._transport = latency_of(plant)
        self._lag = 0.5 * max(self._smoothing - self._tick, 0.0)
        self.latency = self._transport + self._lag
        self._time = 0.0
        self._command = np.zeros(dof)
        self._changes: list[tuple[float, np.ndarray]] = []
        self._kept = max(2, math.ceil(self._transport / self._tick - 1e-9))
        self._sent = np.zeros((self._kept, dof))  # the latest velocities that the plant was sent, one per tick

    @property
    def command(self) -> np.ndarray:
        """Returns the joint velocities of the latest command, as it was carried out, shape [dof] [rad/s]."""
        return self._command.copy()

    def allowed(self, joint_velocity: np.ndarray) -> np.ndarray:
        """Returns the joint velocities that :meth:`apply` would move towards, shape [dof] [rad/s]; sends nothing.

        Args:
            joint_velocity: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].

        Raises:
            ValueError: The command is not finite.
        """
        wanted = np.array(joint_velocity, dtype=float)
        if not np.isfinite(wanted).all():
            raise ValueError(f"joint velocities must be finite, got {wanted}")
        change = wanted - self._command
        most = float(np.abs(change).max())
        return wanted if most <= self._most else self._command + self._most / most * change

    def pending(self) -> list[tuple[float, np.ndarray]]:
        """Returns what the arm does until the next command takes effect: durations [s] and joint velocities [rad/s].

        The last pair has no duration: the velocity that the next command changes.
        """
        under_way = math.ceil(self._transport / self._tick - 1e-9)
        coming = self._velocities(math.ceil(self._lag / self._tick - 1e-9))
        durations = np.full(under_way + len(coming), self._tick)
        if under_way:
            durations[0] -= under_way * self._tick - self._transport
        if len(coming):
            durations[-1] -= len(coming) * self._tick - self._lag
        velocities = np.vstack([self._sent[len(self._sent) - under_way :], coming])
        return [*zip(durations.tolist(), velocities, strict=True), (0.0, self._command)]

    def apply(self, joint_velocity: np.ndarray) -> np.ndarray:
        """Moves towards joint velocities, for one control period.

        Args:
            joint_velocity: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].

        Returns:
            The joint velocities that the arm has once the change is over, shape [dof].

        Raises:
            ValueError: The command is not finite.
        """
        wanted = self.allowed(joint_velocity)
        self.limited = not np.array_equal(wanted, joint_velocity)
        change, self._command = wanted - self._command, wanted
        if self._stream is None or self._smoothing == 0.0:
            self._sent = np.vstack([self._sent, wanted])[-self._kept :]
            self.plant.apply(wanted)
            return wanted
        self._changes.append((self._time, change))
        velocities = self._velocities(self._stream.ticks)
        self._measure(velocities)
        self._sent = np.vstack([self._sent, velocities])[-self._kept :]
        try:
            self._stream.stream(velocities)
        finally:  # also after Ctrl-C: what follows goes on from the end of this period
            self._time += self.control_period
            self._changes = [(begin, d) for begin, d in self._changes if self._time - begin < self._smoothing - 1e-9]
        return wanted

    def stop(self) -> None:
        """Brings the arm to rest, and ends with zeros; they are sent at once if the plant raises an error.

        The control periods are sent one after the other, so that a plant that does not wait for their end gets all of
        them at once.
        """
        still = np.zeros_like(self._command)
        periods = np.abs(self._command).max() / self._most + self._smoothing / self.control_period
        try:
            for _ in range(math.ceil(periods) + 1):
                if not np.any(self.apply(still)) and not self._changes:
                    return
        except Exception:
            self.plant.apply(still)
            raise

    def rest(self) -> None:
        """Notes that the arm is at rest, whatever it was commanded; sends nothing."""
        self._command = np.zeros_like(self._command)
        self._changes.clear()
        self._sent[:] = 0.0

    def _velocities(self, ticks: int) -> np.ndarray:
        """Returns the joint velocities at the ends of the next ticks, for the commands so far, shape [ticks, dof]."""
        times = self._time + self._tick * np.arange(1, ticks + 1)
        velocities = np.tile(self._command, (ticks, 1))
        for begin, change in self._changes:
            velocities -= (1.0 - _s_curve((times - begin) / self._smoothing))[:, None] * change
        return velocities

    def _measure(self, velocities: np.ndarray) -> None:
        acceleration = np.diff(np.vstack([self._sent[-2:], velocities]), axis=0) / self._tick
        self.peak_acceleration = float(np.abs(acceleration[1:]).max())
        self.peak_jerk = float(np.abs(np.diff(acceleration, axis=0)).max() / self._tick)


def _s_curve(share: np.ndarray) -> np.ndarray:
    """Returns the part of a change that is over after a share of its time: two parabolas, from 0 to 1."""
    share = np.clip(share, 0.0, 1.0)
    return np.where(share < 0.5, 2.0 * share**2, 1.0 - 2.0 * (1.0 - share) ** 2)
