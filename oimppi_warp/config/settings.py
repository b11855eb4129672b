"""All settings, as frozen dataclasses that define ``--set``, the viewer's settings panel and `docs/settings.md`.

Fields are named after the paper's symbols; the help marks terms that are not in the paper. The defaults are those of
the preset ``best``. Weights multiply stage costs, which are summed over the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from oimppi_warp.config.fields import ExtraWeights, group, label, setting
from oimppi_warp.config.lab import EstimatorConfig, LabConfig
from oimppi_warp.errors import ConfigError


@dataclass(frozen=True)
class Sampling:
    """Settings common to all sampling-based optimizers: K control sequences of H steps around a nominal (equation 9).

    An optimizer defines its settings as a subclass of this, with ``kind`` set to its name in
    :data:`oimppi_warp.registries.OPTIMIZERS`.
    """

    kind: str = label("", "Name of the optimizer.")
    samples: int = setting(1200, "Number of samples, K.", low=2, high=1_000_000)
    horizon: int = setting(25, "Length of the horizon in control steps, H.", low=1, high=10_000)
    iterations: int = setting(1, "Number of updates of the nominal controls per control step.", low=1, high=1_000)
    knots: int = setting(
        6,
        "Number of knots of the cubic splines over the horizon that shape the noise; 0 draws the noise of every step "
        "independently, as the paper does.",
    )
    special_samples: bool = setting(
        True, "Use the nominal control sequence and zero control as the first two samples; not in the paper."
    )

    def check(self, where: str) -> None:
        """Checks that the settings are consistent with each other; subclasses extend the check.

        Args:
            where: Dotted name of these settings, such as ``"robot.optimizer"``, for the message.

        Raises:
            ConfigError: Two settings contradict each other.
        """
        if self.knots == 1 or self.knots > self.horizon:
            raise ConfigError(
                f"{where}.knots = {self.knots}: not possible for a horizon of {self.horizon} steps\n"
                f"  allowed: 0 (independent noise at every step), or 2 to {self.horizon} knots"
            )


@dataclass(frozen=True)
class Mppi(Sampling):
    """MPPI (the paper's Algorithm 1)."""

    kind: str = label("mppi", "Name of the optimizer.")
    temperature: float = setting(
        2.0,
        "Temperature lambda of equation 12, in units of cost; lower values give the cheapest samples more weight.",
        low=1e-6,
    )
    effective_samples: tuple[float, float] = setting(
        (0.0, 0.0),
        "Lower and upper bound of the effective sample size, as fractions of K, enforced by adapting the temperature; "
        "0,0 keeps the temperature fixed, as the paper does.",
        high=1.0,
    )

    def check(self, where: str) -> None:
        """Checks that the settings are consistent with each other; see :meth:`Sampling.check`."""
        super().check(where)
        check_order(f"{where}.effective_samples", self.effective_samples)


@dataclass(frozen=True)
class Cem(Sampling):
    """Cross-entropy method: fits mean and standard deviation of the next samples to the elites; not in the paper."""

    kind: str = label("cem", "Name of the optimizer.")
    elites: float = setting(0.05, "Fraction of the samples, the cheapest, to which the next ones are fitted.", high=1.0)
    smoothing: float = setting(0.2, "Fraction of the old mean and standard deviation that an update retains.", high=1.0)
    least_deviation: float = setting(
        0.5, "Smallest standard deviation, as a fraction of the level's noise; prevents its collapse.", high=1.0
    )
    recovery: float = setting(
        0.5,
        "Fraction by which standard deviations return to the level's noise in each control step; with 1, every plan "
        "starts with the full noise.",
        high=1.0,
    )


@dataclass(frozen=True)
class Uncertainty:
    """Random draws of the world in which the robot level evaluates each control sequence; future work in the paper.

    Planning time is proportional to the number of draws.
    """

    draws: int = setting(0, "Number of draws in which each control sequence is evaluated; 0 for none.", high=1_000)
    shared: bool = setting(True, "Evaluate all sequences in the same draws instead of separate draws for each.")
    friction: float = setting(0.2, "Standard deviation of the logarithm of the friction coefficients.")
    mass: float = setting(0.1, "Standard deviation of the logarithm of the object's mass.")
    pose: tuple[float, float, float] = setting(
        (0.005, 0.005, 0.03),
        "Standard deviations of the error in the object's perceived pose: x, y, yaw.",
        unit="m, m, rad",
    )
    tool: float = setting(
        0.002, "Standard deviation of the tool's offset in each of the two directions across its axis.", unit="m"
    )
    measure: Literal["mean", "worst", "cvar"] = setting(
        "mean",
        "Combination of a sequence's costs over all draws: mean, worst, or mean of the worst (CVaR).",
    )
    tail: float = setting(0.5, "Fraction of the draws that counts as the worst, for measure=cvar.", high=1.0)


@dataclass(frozen=True)
class RobotLevel:
    """The robot level, which plans joint velocities that make the object follow its plan (equation 14)."""

    optimizer: Sampling = group(Mppi(), "Optimizer of the robot level.")
    noise_space: Literal["joint", "tool"] = setting(
        "tool",
        "Space in which the noise covariance Sigma_u is defined: joint space, as in the paper, or the tool's frame, "
        "mapped to the joints by the damped pseudo-inverse of the Jacobian.",
    )
    joint_noise: float = setting(
        0.3,
        "Standard deviation of the velocity noise of each joint, for noise_space=joint (m/s for a sliding joint).",
        unit="rad/s",
    )
    tool_noise: tuple[float, float, float, float, float, float] = setting(
        (0.2, 0.2, 0.06, 0.2, 0.2, 0.5),
        "Standard deviations of the tip's velocity noise along and about x, y and z, for noise_space=tool.",
        unit="m/s, m/s, m/s, rad/s, rad/s, rad/s",
    )
    joint_velocity_limit: float = setting(
        0.6,
        "Largest velocity planned for each joint, unless the robot's own limit is lower (m/s for a sliding joint).",
        unit="rad/s",
        low=1e-3,
    )
    contact_steps: int = setting(
        2, "Number of contact model steps per control step, in the quasi-static engine.", low=1, high=1_000
    )
    substeps: int = setting(4, "Number of physics steps per control step, in the Newton engine.", low=1, high=1_000)
    uncertainty: Uncertainty = group(Uncertainty(), "Uncertainty of the prediction, as random draws of the world.")


@dataclass(frozen=True)
class ObjectLevel:
    """The object level, which plans a wrench that moves the object to its goal without the robot (equation 13)."""

    optimizer: Sampling = group(Mppi(horizon=60, temperature=0.5, knots=5), "Optimizer of the object level.")
    speed_limit: tuple[float, float, float] = setting(
        (0.12, 0.12, 1.0),
        "Largest velocity of the object that the virtual wrench may cause: x, y, yaw.",
        unit="m/s, m/s, rad/s",
        low=1e-3,
    )
    noise: float = setting(
        0.6, "Standard deviation of the wrench noise, as a fraction of the wrench that gives speed_limit."
    )
    noise_range: float = setting(
        0.15,
        "Distance from the goal, yaw error included, below which the noise shrinks in proportion, down to a tenth; 0 "
        "keeps the noise constant; not in the paper.",
        unit="m",
    )
    plan_steps: int = setting(
        600, "Number of control steps after which SOI stops extending an object plan.", low=1, high=100_000
    )
    turn: bool = setting(
        True, "Take the object's yaw into account; turned off for tasks whose tolerance allows every yaw."
    )

    @property
    def yaw_length(self) -> float:
        """Returns the length equivalent to a radian of yaw: the distance that the object can move in that time [m]."""
        return self.speed_limit[0] / self.speed_limit[2] if self.turn else 1e-4


_RING = (
    "Inner and outer radius of the ring around the base in which the arm pushes well, for the xArm6's reach of 0.72 m; "
    "scaled to the reach of other robots, and unbounded for a robot that does not turn about its base."
)


@dataclass(frozen=True)
class ObjectCost:
    """Weights of the object's stage cost l_o at the object level (equation 15)."""

    w_d: float = setting(1.0, "Weight of the squared distance to the goal (equation 16).", unit="1/m^2")
    w_theta: float = setting(
        0.03, "Square of the length equivalent to a yaw error of 1 rad, in the distance of w_d.", unit="m^2/rad^2"
    )
    w_f: float = setting(
        0.05, "Weight of the squared contact force with obstacles above f_0 (equation 15).", unit="1/N^2"
    )
    f_0: float = setting(0.5, "Contact force with obstacles up to which there is no cost (equation 15).", unit="N")
    w_to_go: float = setting(
        4.0, "Weight of the length of the shortest free path to the goal; not in the paper.", unit="1/m"
    )
    w_margin: float = setting(
        2000.0, "Weight of the squared shortfall of clearance below margin; not in the paper.", unit="1/m^2"
    )
    margin: float = setting(0.015, "Clearance between object and obstacles below which w_margin acts.", unit="m")
    w_push_ring: float = setting(20.0, "Weight of the object's distance from push_ring; not in the paper.", unit="1/m")
    push_ring: tuple[float, float] = setting((0.32, 0.60), _RING, unit="m")


@dataclass(frozen=True)
class RobotCost:
    """Weights of the robot level's stage cost ``l_o + l_r + l_c`` (equation 14); help marks terms not in the paper."""

    w_d: float = setting(5.0, "Weight of the object's squared distance to the goal (equation 16).", unit="1/m^2")
    w_theta: float = setting(
        0.1, "Square of the length equivalent to a yaw error of 1 rad, in w_d and in w_reference.", unit="m^2/rad^2"
    )
    w_f: float = setting(
        0.05, "Weight of the object's squared contact force with obstacles above f_0 (equation 15).", unit="1/N^2"
    )
    f_0: float = setting(0.5, "Contact force up to which there is no cost (equation 15).", unit="N")
    w_to_go: float = setting(
        0.0,
        "Weight of the length of the object's shortest free path to the goal, which replaces the object level's "
        "guidance in plain MPPI; computed with object_cost.push_ring and object.speed_limit; not in the paper.",
        unit="1/m",
    )
    w_reference: float = setting(
        300.0, "Weight of the object's squared distance to its plan, the coupling cost l_c.", unit="1/m^2"
    )
    w_ee: float = setting(
        5.0, "Weight of the squared distance between tool and object beyond r_0 (equation 17).", unit="1/m^2"
    )
    r_0: float = setting(0.12, "Distance between tool and object up to which there is no cost (equation 17).", unit="m")
    w_align: float = setting(
        2.0,
        "Weight of the tool not being behind the object, as seen in the object's desired direction of motion "
        "(equation 18).",
    )
    gamma_0: float = setting(
        0.7, "Cosine of the angle up to which the tool counts as behind the object (equation 18).", low=-1.0, high=1.0
    )
    align_ahead: int = setting(
        10, "Number of control steps to look ahead on the object plan for the direction of w_align; not in the paper."
    )
    align_fade: float = setting(
        0.02,
        "Distance from object to target below which w_align fades out, since the direction becomes meaningless; 0 "
        "turns fading off; not in the paper.",
        unit="m",
    )
    w_tilt: float = setting(3.0, "Weight of the tool's tilt from vertical (equation 19).", unit="1/rad")
    w_height: float = setting(1000.0, "Weight of the squared deviation of the tip from height.", unit="1/m^2")
    height: float = setting(0.012, "Desired height of the tip above the table while pushing.", unit="m")
    w_arm_clearance: float = setting(
        1e4, "Weight of the squared shortfall of the arm's clearance phi_3 below arm_clearance.", unit="1/m^2"
    )
    arm_clearance: float = setting(
        0.01, "Clearance between the arm and obstacles or table below which w_arm_clearance acts.", unit="m"
    )
    w_above: float = setting(20.0, "Cost of each control step with the tip above the object; not in the paper.")
    w_push_ring: float = setting(40.0, "Weight of the object's distance from push_ring; not in the paper.", unit="1/m")
    push_ring: tuple[float, float] = setting((0.32, 0.60), _RING, unit="m")
    w_edge: float = setting(
        40.0,
        "Weight of the distance of the object's centre from the rectangle in which all of the object is on the table; "
        "not in the paper.",
        unit="1/m",
    )
    w_press: float = setting(
        1e6,
        "Weight of the squared depth to which the tool presses into an object that cannot yield (phi_1), in the "
        "quasi-static engine.",
        unit="1/m^2",
    )
    w_margin: float = setting(
        2e4,
        "Weight of the squared shortfall of clearance below margin while the object is pushed, in the quasi-static "
        "engine; not in the paper.",
        unit="1/m^2",
    )
    margin: float = setting(0.006, "Clearance between object and obstacles below which w_margin acts.", unit="m")
    w_lift: float = setting(
        50.0,
        "Weight of the squared speed at which the tip rises while pushing, which could tip the object over, in the "
        "quasi-static engine; not in the paper.",
        unit="s^2/m^2",
    )
    w_control: float = setting(0.0, "Weight of the squared joint velocities; not in the paper.", unit="s^2/rad^2")
    w_collision: float = setting(
        0.0,
        "Weight of the contact force above f_0 between arm or tool and obstacles or table, in engines that compute it; "
        "not in the paper.",
        unit="1/N",
    )
    w_overhang: float = setting(
        3e4,
        "Weight of the squared length by which a tilted stick is closer to the object at its rim's height than at the "
        "tip, for objects that a push can tip over; not in the paper.",
        unit="1/m^2",
    )
    w_rush: float = setting(
        100.0,
        "Weight of the squared excess of the approach speed over that set by rush, for objects that a push can tip "
        "over; not in the paper.",
        unit="s^2/m^2",
    )
    rush: float = setting(
        0.4, "Fraction of the object's tipping speed up to which an approach has no cost; not in the paper."
    )
    topple_near: float = setting(
        0.1, "Distance to the object within which w_overhang and w_rush act; not in the paper.", unit="m", low=1e-3
    )
    extra: Mapping[str, float] = group(ExtraWeights(), "Weights of cost terms from outside the package, by name.")

    def __post_init__(self) -> None:
        if not isinstance(self.extra, ExtraWeights):
            object.__setattr__(self, "extra", ExtraWeights(self.extra))


@dataclass(frozen=True)
class Reposition:
    """Repositioning of the tool to push an object that makes no headway from another side; not in the paper."""

    stall_seconds: float = setting(
        3.0, "Time without headway after which the tool is repositioned; 0 disables repositioning.", unit="s"
    )
    headway: float = setting(
        0.01,
        "Amount by which the remaining path to the goal must fall below its minimum since pushing began to count as "
        "headway.",
        unit="m",
    )
    w_waypoint: float = setting(
        400.0, "Weight of the tip's squared distance to its waypoint during repositioning.", unit="1/m^2"
    )
    longest_seconds: float = setting(4.0, "Longest duration of a repositioning.", unit="s")


@dataclass(frozen=True)
class EpisodeConfig:
    """Settings of an episode: its end, and the arm's behaviour when a plan is late."""

    max_sim_seconds: float = setting(40.0, "Time limit in simulated time.", unit="s", low=0.001)
    hold_seconds: float = setting(0.5, "Time for which the object must stay within tolerance for success.", unit="s")
    tight: bool = setting(
        True,
        "Continue a successful episode until the tight tolerance is held as well; both results are reported in either "
        "case.",
    )
    plan_expires: float = setting(
        0.15,
        "Time for which a command is held when the next plan is late in real time, before the arm stops.",
        unit="s",
    )


@dataclass(frozen=True)
class Config:
    """All settings of a run: the two levels, their costs, the episode, the laboratory and the estimator."""

    preset: str = label("best", "Name of the preset that the settings are based on.")
    resolved_for: str = label("", "The task that the settings were resolved for; see oimppi_warp.planning.resolve.")
    control_period: float = setting(
        0.05, "Control period: time from one plan to the next.", unit="s", low=0.001, high=1.0
    )
    reference: Literal["time", "progress"] = setting(
        "progress",
        "Index into the object plan that SOI's robot level tracks: the time since planning, as in the paper, or the "
        "progress of the object along it.",
    )
    reposition: Reposition = group(Reposition(), "Repositioning of the tool to push from another side.")
    robot: RobotLevel = group(RobotLevel(), "The robot level.")
    object: ObjectLevel = group(ObjectLevel(), "The object level.")
    cost: RobotCost = group(RobotCost(), "Cost weights of the robot level.")
    object_cost: ObjectCost = group(ObjectCost(), "Cost weights of the object level.")
    episode: EpisodeConfig = group(EpisodeConfig(), "End of an episode, and late plans.")
    lab: LabConfig = group(LabConfig(), "The simulated laboratory.")
    estimator: EstimatorConfig = group(
        EstimatorConfig(), "Assumptions of the estimator, used in the laboratory and in real time."
    )


def check_order(name: str, bounds: tuple[float, float]) -> None:
    """Checks that a lower bound does not exceed the upper one.

    Raises:
        ConfigError: The lower bound is above the upper one.
    """
    low, high = bounds
    if low > high:
        raise ConfigError(f"{name} = {low:g},{high:g}: the lower bound is above the upper one\n  to do:   swap the two")
