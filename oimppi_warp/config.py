"""Every setting of the planner, in frozen dataclasses; the command line and the presets are made from them.

Fields carry the paper's symbols; where the paper has no such term, the docstring says so. The defaults are those of the
preset ``best``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from oimppi_warp.lab_config import EstimatorConfig, LabConfig

Method = Literal["mppi", "soi", "cloi"]
PlantKind = Literal["ideal", "lab"]
Mode = Literal["lockstep", "realtime"]


@dataclass(frozen=True)
class Mppi:
    """One MPPI (the paper's Algorithm 1), at either level.

    Attributes:
        samples: Number of samples K.
        horizon: Number of control steps H.
        temperature: lambda of equation 12, in units of cost.
        effective_samples: Lower and upper bound of the effective sample size, as fractions of K, between which the
            temperature is adapted; (0, 0) holds it fixed as the paper does.
        iterations: Updates per control step.
        knots: Number of cubic-spline knots of the noise over the horizon; 0 draws every step on its own (the paper).
        special_samples: Keep one sample on the nominal and one on zero control.
    """

    samples: int = 1200
    horizon: int = 25
    temperature: float = 2.0
    effective_samples: tuple[float, float] = (0.0, 0.0)
    iterations: int = 1
    knots: int = 6
    special_samples: bool = True


@dataclass(frozen=True)
class Uncertainty:
    """What the robot level's prediction may be wrong about; the paper's future work.

    Each control sequence is rolled out in several draws of the world: plans take that many times as long.

    Attributes:
        draws: Draws that each control sequence is tried in; 0 turns all of this off.
        shared: Whether all sequences are tried in the same draws, or each in its own.
        friction: Spread of the friction coefficients (standard deviation of their logarithm).
        mass: The same of the object's mass.
        pose: Standard deviations of the error of the object's perceived pose: x, y [m], yaw [rad].
        tool: Standard deviation of the tool's offset across its axis, in either direction [m].
        measure: What the costs in all draws become: their mean, the worst, or the mean of the worst (CVaR).
        tail: Share of the draws that counts as the worst, for ``measure="cvar"``.
    """

    draws: int = 0
    shared: bool = True
    friction: float = 0.2
    mass: float = 0.1
    pose: tuple[float, float, float] = (0.005, 0.005, 0.03)
    tool: float = 0.002
    measure: Literal["mean", "worst", "cvar"] = "mean"
    tail: float = 0.5


@dataclass(frozen=True)
class RobotLevel:
    """Robot level: equations 14 and 17.

    Attributes:
        mppi: Sampling and update.
        noise_space: Where Sigma_u is given: in joint space (the paper) or in the tool's frame of motion, mapped to
            joints by the damped pseudo-inverse of the Jacobian.
        joint_noise: Standard deviation of each joint's velocity [rad/s; m/s where it slides], for
            ``noise_space="joint"``.
        tool_noise: Standard deviations of the tip's velocity (x, y, z [m/s], rotation about x, y, z [rad/s]), for
            ``noise_space="tool"``.
        joint_velocity_limit: Bound of each joint's velocity [rad/s], if lower than the robot's own. For joints that
            slide the same number counts as m/s: a robot made of them sets the pace itself, by its own limits.
        contact_steps: Steps of the contact model in one control step, in the quasi-static engine.
        substeps: Steps of the physics in one control step, in the Newton engine.
        uncertainty: What the prediction may be wrong about.
    """

    mppi: Mppi = field(default_factory=Mppi)
    noise_space: Literal["joint", "tool"] = "tool"
    joint_noise: float = 0.3
    tool_noise: tuple[float, float, float, float, float, float] = (0.2, 0.2, 0.06, 0.2, 0.2, 0.5)
    joint_velocity_limit: float = 0.6
    contact_steps: int = 2
    substeps: int = 4
    uncertainty: Uncertainty = field(default_factory=Uncertainty)


@dataclass(frozen=True)
class ObjectLevel:
    """Object level: equations 5, 6, 15.

    Attributes:
        mppi: Sampling and update.
        speed_limit: Object speeds that the virtual wrench may reach: (x, y [m/s], yaw [rad/s]).
        noise: Standard deviation of the wrench as a fraction of the one that gives ``speed_limit``.
        noise_range: Distance from the goal (turning counted) [m] within which the noise shrinks in proportion, down to
            a tenth; 0 keeps it as it is. Not in the paper.
        plan_steps: Control steps that SOI's plan may take before it is given up.
        turn: Whether the object's yaw counts; planners turn it off for tasks whose tolerance allows every yaw.
    """

    mppi: Mppi = field(default_factory=lambda: Mppi(samples=1200, horizon=60, temperature=0.5, knots=5))
    speed_limit: tuple[float, float, float] = (0.12, 0.12, 1.0)
    noise: float = 0.6
    noise_range: float = 0.15
    plan_steps: int = 600
    turn: bool = True

    @property
    def yaw_length(self) -> float:
        """Length that turning by one radian counts as: how far the object could be moved in the same time [m]."""
        return self.speed_limit[0] / self.speed_limit[2] if self.turn else 1e-4


@dataclass(frozen=True)
class ObjectCost:
    """Weights of the object's stage cost at the object level (equations 15 and 16).

    Attributes:
        w_d: Squared distance to the goal [1/m^2].
        w_theta: Squared yaw error in it [m^2/rad^2].
        w_f: Squared contact force on obstacles above ``f_0`` [1/N^2].
        f_0: Contact force that costs nothing [N].
        w_to_go: Length of the shortest free way to the goal [1/m]; not in the paper.
        w_margin: Squared lack of clearance below ``margin`` [1/m^2]; not in the paper.
        margin: [m].
        w_reach: Distance of the object's centre to the ring in which the arm can push well [1/m]; not in the paper.
        reach: Inner and outer radius of that ring for an arm that reaches as far as the xArm6, 0.72 m; for others in
            proportion, and for a robot that does not turn about its base there is no ring [m].
    """

    w_d: float = 1.0
    w_theta: float = 0.03
    w_f: float = 0.05
    f_0: float = 0.5
    w_to_go: float = 4.0
    w_margin: float = 2000.0
    margin: float = 0.015
    w_reach: float = 20.0
    reach: tuple[float, float] = (0.32, 0.60)


@dataclass(frozen=True)
class RobotCost:
    """Weights of the stage cost at the robot level (equations 15 to 19, summed over the horizon).

    The first group is the paper's, the second ours.

    Attributes:
        w_d, w_theta, w_f, f_0: As in :class:`ObjectCost`, for the simulated object.
        w_to_go: Length of the object's shortest free way to the goal [1/m]; not in the paper. It gives plain MPPI what
            the others have from the object level, and is made with ``object_cost.reach`` and ``object.speed_limit``.
        w_reference: Squared distance to the object plan, the paper's coupling cost l_c [1/m^2].
        w_ee: Squared distance between tool and object beyond ``r_0`` [1/m^2].
        r_0: [m].
        w_align: Tool not behind the object, seen along the way that the object should go.
        gamma_0: Cosine above which the tool counts as behind the object.
        align_ahead: Steps along the reference at which "where the object should go" is read.
        align_fade: Closer to its target than this the direction loses its meaning, and the term its weight; 0 turns
            that off [m].
        w_tilt: Tilt of the tool [1/rad].
        w_height: Squared distance of the tip from ``height`` above the table [1/m^2].
        height: [m].
        w_clearance: Squared lack of room below ``clearance`` between arm and obstacles or table (phi_3) [1/m^2].
        clearance: [m].
        w_above: Each step with the tip above the object.
        w_reach: Distance of the object's centre to the ring in which the arm can push well [1/m].
        reach: Inner and outer radius of that ring for an arm that reaches as far as the xArm6, 0.72 m; for others in
            proportion, and for a robot that does not turn about its base there is no ring [m].
        w_edge: Distance of the object's centre to where all of it is on the table for sure [1/m].
        w_press: Squared depth by which the tool presses into an object that cannot yield [1/m^2]; in the quasi-static
            engine, as the next three: the others feel the forces that these stand for.
        w_margin: Squared lack of clearance below ``margin`` of an object that is being pushed [1/m^2].
        margin: [m].
        w_lift: Squared speed at which the tip rises while it pushes, which would lift the object and tip it [s^2/m^2].
        w_control: Squared joint velocity [s^2/rad^2].
        w_collision: Contact force of arm and tool on obstacles and table above ``f_0`` [1/N], in engines that know it.
        w_overhang: Squared length by which a stick that leans over the object is nearer to its rim than the tip is
            [1/m^2]. This and the next are for objects that a push may tip (:func:`oimppi_warp.tipping.can_tip`), within
            ``topple_near`` of them; for others they are off.
        w_rush: Squared speed of the tool towards the object above ``rush`` [s^2/m^2].
        rush: Share of the object's tipping speed (:func:`oimppi_warp.tipping.tipping_speed`) that costs nothing.
        topple_near: [m].
    """

    w_d: float = 5.0
    w_theta: float = 0.1
    w_f: float = 0.05
    f_0: float = 0.5
    w_to_go: float = 0.0
    w_reference: float = 300.0
    w_ee: float = 5.0
    r_0: float = 0.12
    w_align: float = 2.0
    gamma_0: float = 0.7
    align_ahead: int = 10
    align_fade: float = 0.02
    w_tilt: float = 3.0

    w_height: float = 1000.0
    height: float = 0.012
    w_clearance: float = 1e4
    clearance: float = 0.01
    w_above: float = 20.0
    w_reach: float = 40.0
    reach: tuple[float, float] = (0.32, 0.60)
    w_edge: float = 40.0
    w_press: float = 1e6
    w_margin: float = 2e4
    margin: float = 0.006
    w_lift: float = 50.0
    w_control: float = 0.0
    w_collision: float = 0.0
    w_overhang: float = 3e4
    w_rush: float = 100.0
    rush: float = 0.4
    topple_near: float = 0.1


@dataclass(frozen=True)
class Regrasp:
    """Letting go of an object that no longer gets on, and pushing it from another side; not in the paper.

    Attributes:
        stall_seconds: Time without headway after which the arm lets go [s]; 0 turns all of this off.
        headway: What counts as headway: less to go than ever since the arm took hold, by this much [m].
        w_guide: Squared distance of the tip from where it is called to [1/m^2].
        longest_seconds: Time after which a call is given up [s].
    """

    stall_seconds: float = 3.0
    headway: float = 0.01
    w_guide: float = 400.0
    longest_seconds: float = 4.0


@dataclass(frozen=True)
class EpisodeConfig:
    """The closed loop.

    Attributes:
        max_sim_seconds: Time limit [s].
        hold_seconds: How long the object must stay within tolerance [s].
        tight: Go on until the tight tolerance is held too (or the time is up). Success is having held the tolerance,
            and both are reported in any case.
        plan_expires: In real time: how long a command is kept up when the next plan is late; then the arm is told to
            stop [s].
    """

    max_sim_seconds: float = 40.0
    hold_seconds: float = 0.5
    tight: bool = True
    plan_expires: float = 0.15


@dataclass(frozen=True)
class Config:
    """All settings.

    Attributes:
        preset: Name of the preset that it began as.
        control_period: [s].
        reference: How SOI's robot level reads the object plan: by the time since it was made (the paper) or by progress
            (from where the object is, along the plan or back to it).
        regrasp: When an object that no longer gets on is let go.
        robot, object: The two levels.
        cost: Weights of the robot level.
        object_cost: Weights of the object level.
        episode: The closed loop.
        lab: The simulated lab.
        estimator: Where the object is believed to be, in the lab and in real time.
    """

    preset: str = "best"
    control_period: float = 0.05
    reference: Literal["time", "progress"] = "progress"
    regrasp: Regrasp = field(default_factory=Regrasp)
    robot: RobotLevel = field(default_factory=RobotLevel)
    object: ObjectLevel = field(default_factory=ObjectLevel)
    cost: RobotCost = field(default_factory=RobotCost)
    object_cost: ObjectCost = field(default_factory=ObjectCost)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    lab: LabConfig = field(default_factory=LabConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
