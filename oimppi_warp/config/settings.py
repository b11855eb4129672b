"""All settings, as frozen dataclasses that define ``--set``, the viewer's settings panel and `docs/settings.md`.

Fields are named after the paper's symbols, and the help marks settings that are not in the paper. The defaults are
those of the preset ``best``. A weight multiplies the cost of one control step, and these costs are summed over the
horizon. Help texts name other settings in full and in backticks, as in `cost.height`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from oimppi_warp.config.fields import ExtraWeights, group, label, setting
from oimppi_warp.config.lab import EstimatorConfig, LabConfig
from oimppi_warp.errors import ConfigError


@dataclass(frozen=True)
class Sampling:
    """Settings common to all sampling-based optimizers, which draw K control sequences of H steps (equation 9).

    An optimizer defines its settings as a subclass of this, with ``kind`` set to its name in
    :data:`oimppi_warp.registries.OPTIMIZERS`.
    """

    kind: str = label("", "Name of the optimizer.")
    samples: int = setting(1200, "Number of sampled control sequences, K.", low=2, high=1_000_000)
    horizon: int = setting(25, "Length of the horizon, H, in control steps.", low=1, high=10_000)
    iterations: int = setting(
        1, "Number of updates of the nominal control sequence per control step.", low=1, high=1_000
    )
    knots: int = setting(
        6,
        "Number of knots of the random cubic splines over the horizon that form the noise; 0 draws the noise of every "
        "step independently, as in the paper.",
    )
    least_noise: float = setting(
        1.0,
        "Smallest factor on the noise. The noise of the samples is scaled by factors from 1 down to this, in geometric "
        "progression, so that some samples explore and others refine; 1 gives all samples the same noise, as in the "
        "paper.",
        low=1e-3,
        high=1.0,
    )
    special_samples: bool = setting(
        True, "Use the nominal control sequence and the zero sequence as the first two samples; not in the paper."
    )

    def check(self, where: str) -> None:
        """Checks that the number of knots fits the horizon; subclasses extend the check to their own settings.

        Args:
            where: Dotted name of these settings, such as ``"robot.optimizer"``, for the message.

        Raises:
            ConfigError: Two settings contradict each other, such as one knot, or more knots than steps in the horizon.
        """
        if self.knots == 1 or self.knots > self.horizon:
            steps = "1 step" if self.horizon == 1 else f"{self.horizon} steps"
            splines = f", or 2 to {self.horizon}" if self.horizon > 1 else ""
            raise ConfigError(
                f"{where}.knots = {self.knots} is not possible for a horizon of {steps}\n"
                f"  allowed: 0 (independent noise at every step){splines}"
            )


@dataclass(frozen=True)
class Mppi(Sampling):
    """Settings of MPPI (the paper's Algorithm 1)."""

    kind: str = label("mppi", "Name of the optimizer.")
    temperature: float = setting(
        2.0,
        "Temperature lambda of equation 12, in units of cost; a lower value gives the cheapest samples more weight.",
        low=1e-6,
    )
    effective_samples: tuple[float, float] = setting(
        (0.0, 0.0),
        "Lower and upper bound of the effective sample size, as fractions of K; the temperature is adapted to keep "
        "the size within them. 0,0 keeps the temperature fixed, as in the paper.",
        high=1.0,
    )

    def check(self, where: str) -> None:
        """Checks also that the bounds of ``effective_samples`` are in order; see :meth:`Sampling.check`."""
        super().check(where)
        check_order(f"{where}.effective_samples", self.effective_samples)


@dataclass(frozen=True)
class Cem(Sampling):
    """Settings of the cross-entropy method, which fits the sampling distribution to the elites; not in the paper."""

    kind: str = label("cem", "Name of the optimizer.")
    elites: float = setting(
        0.05, "Fraction of the samples, cheapest first, to which the sampling distribution is fitted.", high=1.0
    )
    smoothing: float = setting(0.2, "Fraction of the old mean and standard deviation that an update keeps.", high=1.0)
    least_deviation: float = setting(
        0.5,
        "Smallest standard deviation, as a fraction of the noise set for the level; it keeps the sampling distribution "
        "from collapsing.",
        high=1.0,
    )
    recovery: float = setting(
        0.5,
        "Fraction by which the standard deviations return, in each control step, towards the noise set for the level; "
        "with 1, every plan starts with the full noise.",
        high=1.0,
    )


@dataclass(frozen=True)
class Uncertainty:
    """Random draws of the world under which the robot level evaluates control sequences; future work in the paper.

    Planning time is proportional to the number of draws.
    """

    draws: int = setting(
        0,
        "Number of random draws of the world under which each control sequence is evaluated; 0 evaluates the nominal "
        "model only.",
        high=1_000,
    )
    shared: bool = setting(True, "Evaluate all sequences under the same draws, instead of drawing separately for each.")
    friction: float = setting(
        0.2,
        "Standard deviation of the logarithm of the factors on the friction coefficients between object and table, and "
        "between object and tool.",
    )
    mass: float = setting(0.1, "Standard deviation of the logarithm of the factor on the object's mass.")
    pose: tuple[float, float, float] = setting(
        (0.005, 0.005, 0.03),
        "Standard deviations of the error of the object's perceived pose (x, y, yaw).",
        unit="m, m, rad",
    )
    tool: float = setting(
        0.002, "Standard deviation of the tip's offset in each of the two directions across the tool.", unit="m"
    )
    measure: Literal["mean", "worst", "cvar"] = setting(
        "mean",
        "How a sequence's costs over the draws are combined: their mean (`mean`), the worst (`worst`), or the mean of "
        "the worst fraction `robot.uncertainty.tail` (`cvar`).",
    )
    tail: float = setting(
        0.5, "Fraction of the draws that counts as the worst, with `robot.uncertainty.measure=cvar`.", high=1.0
    )


@dataclass(frozen=True)
class RobotLevel:
    """The robot level, which plans a motion of the arm that makes the object follow its plan (equation 14)."""

    optimizer: Sampling = group(Mppi(least_noise=0.1), "Optimizer of the robot level.")
    controls: Literal["joint", "tool"] = setting(
        "tool",
        "Controls that are sampled: joint velocities (`joint`), as in the paper, or velocities of the tip (`tool`). In "
        "the latter case a servo holds the tool upright and the tip at the height `cost.height`, by resolved-rate "
        "control, in the rollouts and on the arm.",
    )
    tip_noise: float = setting(
        0.35,
        "Standard deviation of the noise of the tip's velocity along each axis, with `robot.controls=tool`; vertical "
        "noise only while the tool is lifted over the object.",
        unit="m/s",
    )
    tip_speed_limit: float = setting(
        0.3, "Largest speed of the tip along each axis, with `robot.controls=tool`.", unit="m/s", low=1e-3
    )
    arm_margin: float = setting(
        0.003,
        "Clearance that arm and tool keep to obstacles, table and the border of the tip's reach, in the rollouts and "
        "on the arm, with `robot.controls=tool`; -1 sets no bound; not in the paper.",
        unit="m",
        low=-1.0,
    )
    object_margin: float = setting(
        0.002,
        "Clearance to obstacles and to the table's edge below which the tool does not push the object, in the rollouts "
        "and on the arm, with `robot.controls=tool`; -1 sets no bound; not in the paper.",
        unit="m",
        low=-1.0,
    )
    touch_speed: float = setting(
        0.085,
        "Largest speed towards the object with which the tool touches it, in the rollouts and on the arm, with "
        "`robot.controls=tool`. It is also the largest speed at which an object at its margin to an obstacle is "
        "pushed; farther away, 0.08 m/s faster for each centimetre. Not in the paper.",
        unit="m/s",
        low=1e-3,
    )
    noise_space: Literal["joint", "tool"] = setting(
        "tool",
        "Space in which the noise covariance Sigma_u (equation 9) of joint velocities is defined: that of the joints "
        "(`joint`), as in the paper, or of the tip (`tool`), whose velocities are mapped to the joints by the damped "
        "pseudo-inverse of the Jacobian; with `robot.controls=joint`.",
    )
    joint_noise: float = setting(
        0.3,
        "Standard deviation of the velocity noise of each joint (m/s for a sliding joint), with `robot.controls=joint` "
        "and `robot.noise_space=joint`.",
        unit="rad/s",
    )
    tool_noise: tuple[float, float, float, float, float, float] = setting(
        (0.2, 0.2, 0.06, 0.2, 0.2, 0.5),
        "Standard deviations of the noise of the tip's velocity along, and then about, the world's x, y and z axes, "
        "with `robot.controls=joint` and `robot.noise_space=tool`.",
        unit="m/s, m/s, m/s, rad/s, rad/s, rad/s",
    )
    joint_velocity_limit: float = setting(
        1.2,
        "Largest velocity planned for each joint (m/s for a sliding joint), unless the robot's own limit is lower.",
        unit="rad/s",
        low=1e-3,
    )
    contact_steps: int = setting(
        2,
        "Number of steps of the contact model per control step, in the quasi-static engine. With "
        "`robot.controls=tool`, it is raised if the tip could otherwise move by more than 1.35 times the tool's radius "
        "in one of them.",
        low=1,
        high=1_000,
    )
    substeps: int = setting(4, "Number of physics steps per control step, in the Newton engine.", low=1, high=1_000)
    uncertainty: Uncertainty = group(
        Uncertainty(),
        "Random draws of the world, with different friction, mass, perceived pose and tool offset, under which the "
        "robot level evaluates control sequences.",
    )


@dataclass(frozen=True)
class ObjectLevel:
    """The object level, which plans a wrench that moves the object to its goal without the robot (equation 13)."""

    optimizer: Sampling = group(
        Mppi(horizon=60, temperature=0.5, knots=5, least_noise=0.1),
        "Optimizer of the object level. With a plant that has a fixed control period, the number of steps of the "
        "horizon is changed so that the horizon covers the same time.",
    )
    speed_limit: tuple[float, float, float] = setting(
        (0.2, 0.2, 5.0 / 3.0),
        "Largest velocity of the object (x, y, yaw) that the virtual wrench (the wrench with which the object level "
        "moves the object) may cause.",
        unit="m/s, m/s, rad/s",
        low=1e-3,
    )
    noise: float = setting(
        0.6,
        "Standard deviation of the virtual wrench's noise, as a fraction of the wrench that moves the object at "
        "`object.speed_limit`.",
    )
    noise_range: float = setting(
        0.15,
        "Distance of the object from the goal, yaw error included, below which the noise decreases in proportion to "
        "the distance, down to a tenth; 0 keeps the noise constant; not in the paper.",
        unit="m",
    )
    ends_at_goal: bool = setting(
        True,
        "Replace CLOI's object plan by the straight path to the goal when the object is within 5 cm of the goal, yaw "
        "error included; not in the paper.",
    )
    plan_steps: int = setting(
        600,
        "Number of control steps after which SOI stops extending an object plan that has not reached the goal.",
        low=1,
        high=100_000,
    )
    plans: int = setting(
        4,
        "Number of object plans that SOI makes at the start, each with different noise; it follows the one with the "
        "smallest sum of the cost-to-go of its poses. Each takes up to half a second. The paper makes one.",
        low=1,
        high=1_000,
    )
    turn: bool = setting(
        True, "Take the object's yaw into account; set to false for tasks whose tolerance allows every yaw."
    )

    @property
    def yaw_length(self) -> float:
        """Returns the length equivalent to 1 rad of yaw: the distance along x moved while yaw changes by 1 rad [m].

        Both move at ``speed_limit``; the length is negligible (1e-4 m) if ``turn`` is false.
        """
        return self.speed_limit[0] / self.speed_limit[2] if self.turn else 1e-4


_RING = (
    "Inner and outer radius of the ring around the base in which the arm pushes well. Values are for the xArm6, which "
    "reaches 0.72 m; they are scaled to the reach of other robots. The ring is widened to a goal outside it. A robot "
    "that does not turn about its base has no such ring."
)


@dataclass(frozen=True)
class ObjectCost:
    """Weights of the object's stage cost l_o at the object level (equation 15)."""

    w_d: float = setting(1.0, "Weight of the object's squared distance to the goal (equation 16).", unit="1/m^2")
    w_theta: float = setting(
        0.03,
        "Square of the length equivalent to a yaw error of 1 rad, in the squared distance that `object_cost.w_d` "
        "weights (equation 16).",
        unit="m^2/rad^2",
    )
    w_f: float = setting(
        0.05,
        "Weight of the squared amount by which the contact force between object and obstacles exceeds "
        "`object_cost.f_0` (equation 15).",
        unit="1/N^2",
    )
    f_0: float = setting(
        0.5, "Contact force between object and obstacles up to which there is no cost (equation 15).", unit="N"
    )
    w_to_go: float = setting(
        4.0, "Weight of the length of the object's shortest free path to the goal; not in the paper.", unit="1/m"
    )
    w_margin: float = setting(
        2000.0,
        "Weight of the squared amount by which the clearance between object and obstacles (phi_2) falls below "
        "`object_cost.margin`; not in the paper.",
        unit="1/m^2",
    )
    margin: float = setting(
        0.015,
        "Clearance between object and obstacles below which `object_cost.w_margin` applies; not in the paper.",
        unit="m",
    )
    w_push_ring: float = setting(
        20.0,
        "Weight of the distance by which the object's centre lies outside the ring `object_cost.push_ring`; not in the "
        "paper.",
        unit="1/m",
    )
    push_ring: tuple[float, float] = setting((0.32, 0.60), _RING, unit="m")


@dataclass(frozen=True)
class RobotCost:
    """Weights of the robot level's stage cost ``l_o + l_r + l_c`` (equation 14); help marks terms not in the paper."""

    w_d: float = setting(0.0, "Weight of the object's squared distance to the goal (equation 16).", unit="1/m^2")
    w_theta: float = setting(
        0.0225,
        "Square of the length equivalent to a yaw error of 1 rad, in the distances that `cost.w_d`, `cost.w_reference` "
        "and `cost.w_track` weight (equation 16), and in the agreement of a push with the wanted motion.",
        unit="m^2/rad^2",
    )
    w_f: float = setting(
        0.05,
        "Weight of the squared amount by which the contact force between object and obstacles exceeds `cost.f_0` "
        "(equation 15).",
        unit="1/N^2",
    )
    f_0: float = setting(
        0.5,
        "Contact force up to which there is no cost (equation 15); used with `cost.w_f` and `cost.w_collision`.",
        unit="N",
    )
    w_to_go: float = setting(
        0.0,
        "Weight of the length of the object's shortest free path to the goal. In plain MPPI this cost takes the place "
        "of the object level's guidance. The path is computed with `object_cost.push_ring` and `object.speed_limit`; "
        "not in the paper.",
        unit="1/m",
    )
    w_reference: float = setting(
        0.0,
        "Weight of the object's squared distance to its reference on the object plan, the coupling cost l_c "
        "(equation 14).",
        unit="1/m^2",
    )
    w_track: float = setting(
        100.0,
        "Weight of the object's distance to its reference on the object plan, not squared, so that millimetres still "
        "count near the goal; not in the paper.",
        unit="1/m",
    )
    w_stance: float = setting(
        20.0,
        "Weight of the tool's remaining way around the object to a place from which a push moves the object towards "
        "its target, yaw included; a worse place counts as a longer way. It takes the place of psi_align; not in the "
        "paper.",
        unit="1/m",
    )
    stance_fade: float = setting(
        0.01,
        "Distance between the object and its target below which the cost of `cost.w_stance` decreases in proportion; "
        "not in the paper.",
        unit="m",
    )
    w_ee: float = setting(
        0.0,
        "Weight of the amount by which the squared distance between tip and object centre exceeds the square of "
        "`cost.r_0` (equation 17).",
        unit="1/m^2",
    )
    r_0: float = setting(
        0.12, "Distance between tip and object centre up to which there is no cost (equation 17).", unit="m"
    )
    w_align: float = setting(
        0.0,
        "Weight of psi_align, which penalizes a tool that is not behind the object relative to the object's desired "
        "direction of motion (equation 18).",
    )
    gamma_0: float = setting(
        0.7,
        "Cosine of the largest angle, between the direction from tip to object centre and the desired direction of "
        "motion, at which the tool counts as behind the object (equation 18).",
        low=-1.0,
        high=1.0,
    )
    align_ahead: int = setting(
        10,
        "Number of control steps by which the target of `cost.w_align` and `cost.w_stance` is ahead on the object "
        "plan; the object's desired direction of motion points to this target; not in the paper.",
    )
    align_fade: float = setting(
        0.02,
        "Distance between the object and the target of `cost.w_align` below which the cost decreases in proportion, "
        "because the direction becomes meaningless; 0 turns this off; not in the paper.",
        unit="m",
    )
    w_tilt: float = setting(3.0, "Weight of the tool's tilt from vertical (equation 19).", unit="1/rad")
    w_height: float = setting(
        1000.0,
        "Weight of the squared difference between the tip's height above the table and `cost.height`; not in the "
        "paper.",
        unit="1/m^2",
    )
    height: float = setting(
        0.012, "Desired height of the tip above the table while pushing; not in the paper.", unit="m"
    )
    w_arm_clearance: float = setting(
        1e4,
        "Weight of the squared amount by which the clearance of the arm (tool included) to obstacles and table falls "
        "below `cost.arm_clearance`; this term replaces the paper's constraint phi_3 >= 0.",
        unit="1/m^2",
    )
    arm_clearance: float = setting(
        0.01,
        "Clearance of the arm (tool included) to obstacles and table below which `cost.w_arm_clearance` applies.",
        unit="m",
    )
    w_above: float = setting(20.0, "Cost of each control step with the tip above the object; not in the paper.")
    w_push_ring: float = setting(
        40.0,
        "Weight of the distance by which the object's centre lies outside the ring `cost.push_ring`; not in the paper.",
        unit="1/m",
    )
    push_ring: tuple[float, float] = setting((0.32, 0.60), _RING, unit="m")
    w_edge: float = setting(
        40.0,
        "Weight of the distance by which the object's centre lies outside the rectangle that keeps the whole object on "
        "the table (and within reach, for a robot that does not turn about its base); not in the paper.",
        unit="1/m",
    )
    w_press: float = setting(
        1e6,
        "Weight of the squared depth to which the tool presses into an object that is jammed against an obstacle, in "
        "the quasi-static engine; this term replaces the paper's constraint phi_1 >= 0.",
        unit="1/m^2",
    )
    w_margin: float = setting(
        2e4,
        "Weight of the squared amount by which the clearance between object and obstacles (phi_2) falls below "
        "`cost.margin` while the object is pushed, in the quasi-static engine; not in the paper.",
        unit="1/m^2",
    )
    margin: float = setting(
        0.006,
        "Clearance between object and obstacles below which `cost.w_margin` applies; not in the paper.",
        unit="m",
    )
    w_lift: float = setting(
        50.0,
        "Weight of the squared speed at which the tip rises while it pushes, which could tip the object over; in the "
        "quasi-static engine; not in the paper.",
        unit="s^2/m^2",
    )
    w_control: float = setting(
        0.0,
        "Weight of the sum of the squared joint velocities; in the quasi-static engine with `robot.controls=tool`, of "
        "the squared velocity of the tip [s^2/m^2]; not in the paper.",
        unit="s^2/rad^2",
    )
    w_collision: float = setting(
        0.0,
        "Weight of the amount by which the contact force of arm and tool on obstacles and table exceeds `cost.f_0`, in "
        "engines that compute this force (the quasi-static engine does not); not in the paper.",
        unit="1/N",
    )
    w_overhang: float = setting(
        3e4,
        "Weight of the squared overhang of a tilted stick: how much nearer the stick is to the object at the height of "
        "the object's upper rim than at the tip; only for objects that a push can tip over; not in the paper.",
        unit="1/m^2",
    )
    w_rush: float = setting(
        100.0,
        "Weight of the squared amount by which the approach speed (the tip's speed towards the object) exceeds the "
        "limit given by `cost.rush`; only for objects that a push can tip over; not in the paper.",
        unit="s^2/m^2",
    )
    rush: float = setting(
        0.4,
        "Approach speed up to which there is no cost, as a fraction of the speed at which the object tips over when "
        "its far edge is stopped; not in the paper.",
    )
    topple_near: float = setting(
        0.1,
        "Distance to the object within which `cost.w_overhang` and `cost.w_rush` apply; they fade out towards this "
        "distance; not in the paper.",
        unit="m",
        low=1e-3,
    )
    extra: Mapping[str, float] = group(ExtraWeights(), "Weights of cost terms from outside the package, by name.")

    def __post_init__(self) -> None:
        if not isinstance(self.extra, ExtraWeights):
            object.__setattr__(self, "extra", ExtraWeights(self.extra))


@dataclass(frozen=True)
class Reposition:
    """Repositioning of the tool: an object that makes no headway is pushed from elsewhere; not in the paper."""

    stall_seconds: float = setting(
        3.0,
        "Time without headway (see `reposition.headway`) after which the tool is repositioned; 0 disables "
        "repositioning, and keeps the reference's pace.",
        unit="s",
    )
    headway: float = setting(
        0.01,
        "Decrease of the object's remaining path to the goal that counts as headway; a tenth of the remaining path, if "
        "that is less. It is measured from the last headway, at first from the start of pushing.",
        unit="m",
    )
    least_pace: float = setting(
        0.2,
        "Least pace of the reference, as a fraction of the object plan's. Without headway, the reference slows down "
        "from 1 s on, so that it would stop after `reposition.stall_seconds`; 1 keeps the pace.",
        low=0.01,
        high=1.0,
    )
    w_waypoint: float = setting(
        1000.0, "Weight of the tip's squared distance to its current waypoint during repositioning.", unit="1/m^2"
    )
    longest_seconds: float = setting(
        4.0, "Duration after which a repositioning is abandoned, and likewise the push that follows it.", unit="s"
    )


@dataclass(frozen=True)
class Safety:
    """Limits on the commands to the arm, whatever the planner (:mod:`oimppi_warp.plants.drive`); not in the paper.

    The defaults are those of the xArm6: 1145 deg/s^2 and 28647 deg/s^3.
    """

    smoothing: float = setting(
        0.05,
        "Time over which a change of the commanded joint velocities is spread; 0 lets them jump from one control "
        "period to the next, without any limit. Plans start from the state of the arm half of this time ahead. The "
        "shorter it is, the smaller are the changes that `safety.jerk_limit` allows.",
        unit="s",
        high=1.0,
    )
    acceleration_limit: float = setting(
        19.98, "Largest acceleration of each joint (m/s^2 for a sliding joint).", unit="rad/s^2", low=0.1
    )
    jerk_limit: float = setting(
        499.98, "Largest jerk of each joint (m/s^3 for a sliding joint).", unit="rad/s^3", low=1.0
    )

    filter: bool = setting(
        True,
        "Change commands that would take the arm too close to table, obstacles or itself, or a joint to its limit, "
        "whatever planned them.",
    )
    margin: float = setting(0.002, "Distance that the filter keeps the arm from all of these.", unit="m", low=0.0)

    def most_change(self, period: float) -> float:
        """Returns the largest change of a joint's velocity per control period [rad/s; m/s for a prismatic joint].

        It is infinite without smoothing.

        Args:
            period: Control period [s].
        """
        if self.smoothing == 0.0:
            return math.inf
        most = min(0.5 * self.acceleration_limit * self.smoothing, 0.25 * self.jerk_limit * self.smoothing**2)
        return most / math.ceil(self.smoothing / period - 1e-9)  # so many changes overlap


@dataclass(frozen=True)
class EpisodeConfig:
    """Settings of an episode: its end, and the arm's behaviour when a plan is late."""

    max_sim_seconds: float = setting(40.0, "Time limit of an episode, in simulated time.", unit="s", low=0.001)
    hold_seconds: float = setting(
        0.5, "Time for which the object must stay within the tolerance of its goal for success.", unit="s"
    )
    tight: bool = setting(
        True,
        "Continue a successful episode until the scene's tight tolerance is held as well, instead of ending it at "
        "success. Results for both tolerances are reported in either case.",
    )
    exact: bool = setting(
        True,
        "Continue a successful episode until the exact tolerance (5 mm, 0.02 rad) is held as well. Success within it "
        "is reported in either case.",
    )
    tolerance: tuple[float, float] = setting(
        (0.0, 0.0),
        "Tolerance for success, position and yaw (the option `--tolerance`); `0,0` takes the scene's. A scene that "
        "allows every yaw still does.",
        unit="m, rad",
    )
    plan_expires: float = setting(
        0.15,
        "Time for which the last command is held in real time while the next plan is late; then the arm is stopped.",
        unit="s",
    )


@dataclass(frozen=True)
class Config:
    """All settings of a run: the two levels, their costs, the episode, the laboratory and the estimator."""

    preset: str = label("best", "Name of the preset that the settings are based on.")
    resolved_for: str = label("", "The task that the settings were resolved for; see oimppi_warp.planning.resolve.")
    control_period: float = setting(
        0.05, "Control period: duration of a control step, from one plan to the next.", unit="s", low=0.001, high=1.0
    )
    reference: Literal["time", "progress"] = setting(
        "progress",
        "How SOI's robot level picks its reference on the object plan: by elapsed time, as in the paper (`time`), or "
        "by the object's progress along the plan (`progress`).",
    )
    reposition: Reposition = group(
        Reposition(),
        "Repositioning of the tool: an object that makes no headway is pushed from elsewhere; not in the paper.",
    )
    robot: RobotLevel = group(
        RobotLevel(),
        "The robot level, which plans a motion of the arm that makes the object follow its plan (equation 14).",
    )
    object: ObjectLevel = group(
        ObjectLevel(), "The object level, which plans how the object moves to its goal without the robot (equation 13)."
    )
    cost: RobotCost = group(RobotCost(), "Cost weights of the robot level (equations 14, 15 and 17).")
    object_cost: ObjectCost = group(ObjectCost(), "Cost weights of the object level (equation 15).")
    episode: EpisodeConfig = group(EpisodeConfig(), "End of an episode, and commands while a plan is late.")
    safety: Safety = group(Safety(), "Limits on the commands to the arm, whatever the planner; not in the paper.")
    lab: LabConfig = group(LabConfig(), "The simulated laboratory (`--plant lab`).")
    estimator: EstimatorConfig = group(
        EstimatorConfig(),
        "Assumptions of the estimator of the object's pose, which is used in the laboratory and in real time.",
    )


def check_order(name: str, bounds: tuple[float, float]) -> None:
    """Checks that a lower bound does not exceed the upper one.

    Args:
        name: Dotted name of the setting, for the message.
        bounds: Lower and upper bound.

    Raises:
        ConfigError: The lower bound is above the upper one.
    """
    low, high = bounds
    if low > high:
        raise ConfigError(
            f"{name} = {low:g},{high:g}: the lower bound is above the upper one\n  to do:   swap the two numbers"
        )
