"""Presets of the settings.

Preset :func:`best` (the default) has the best settings that we found. Preset :func:`paper` has the paper's algorithms,
and values found by search where the paper prints none; :func:`paper_printed` has those of its baseline there. Preset
:func:`lab` is for an object that is detected once a second and a planner that shares two cores with the
plant.
"""

from __future__ import annotations

from dataclasses import replace

from oimppi_warp.config.settings import (
    Config,
    EpisodeConfig,
    Mppi,
    ObjectCost,
    ObjectLevel,
    Reposition,
    RobotCost,
    RobotLevel,
    Safety,
)
from oimppi_warp.registries import METHODS


def best(method: str = "cloi") -> Config:
    """Returns the preset ``best``: the best settings that we found for a method (`docs/results.md` has the ablation).

    Args:
        method: Name of the method. In every preset, methods from outside the package have the settings of ``cloi``.

    Raises:
        ConfigError: No method has this name.
    """
    METHODS.check(method)
    base = Config()
    if method == "mppi":  # tracks only the goal, along the shortest free path
        return replace(base, cost=replace(base.cost, w_to_go=200.0, w_track=0.0))
    if method == "soi":
        return replace(
            base,
            object=replace(base.object, optimizer=replace(base.object.optimizer, horizon=90)),
            object_cost=replace(base.object_cost, w_margin=5000.0, margin=0.02),
        )
    return base


def paper(method: str = "cloi") -> Config:
    """Returns the preset ``paper``: the paper's algorithms, costs, K and horizons, with values found by search.

    It is :func:`paper_printed` with other values for what the paper does not print. They were chosen by the success of
    SOI and CLOI alone, on trials 100 to 107 (`tools/search_paper.py`, `docs/results/paper-search.json`), and are the
    same for all tasks and methods. Plain MPPI has the weight of the coupling cost too: its reference is the goal.
    Nothing of ours is on that the paper does not have: no cost-to-go, no repositioning, no ring.

    Args:
        method: Name of the method; see :func:`best`.
    """
    base = paper_printed(method)
    return replace(
        base,
        preset="paper",
        robot=replace(
            base.robot,
            optimizer=replace(
                base.robot.optimizer, knots=6, special_samples=True, effective_samples=(0.0, 0.0), temperature=0.5
            ),
            noise_space="tool",
            joint_velocity_limit=1.0,
        ),
        object=replace(
            base.object,
            optimizer=replace(base.object.optimizer, knots=5, special_samples=True),
            speed_limit=(0.12, 0.12, 1.0),
        ),
        cost=replace(
            base.cost,
            w_d=1.0,
            w_theta=0.03,
            w_reference=400.0,
            w_align=6.0,
            w_height=1000.0,
        ),
        object_cost=replace(base.object_cost, w_d=10.0, w_theta=0.03, w_f=1.0),
    )


def paper_printed(method: str = "cloi") -> Config:
    """Returns the preset ``paper-printed``: the paper's algorithms and equations as printed (`docs/paper.md`).

    The paper gives K, both horizons, white noise in joint space, one update per control step and a reference indexed by
    time. Values that the paper does not give are taken from the baseline that its authors built on
    (tud-airlab/mppi-isaac) and from their scenes for this baseline: control period 0.05 s, joint velocities within
    0.2 rad/s, noise variance 0.1, a temperature that keeps 5 to 10 effective samples, weights 100 and 8 for the
    object's distance and yaw error to the goal, 5 for the tool's distance (``w_ee``), 45 for ``w_align`` and 20 for
    ``w_height``.

    The paper gives the coupling cost l_c no weight; here its weight is that of the goal, since both use d^2. We chose
    ``r_0``, ``gamma_0``, ``f_0``, ``w_f``, ``w_tilt`` and the object level's noise, which neither source gives. The
    terms that replace the constraints phi_1 >= 0 and phi_3 >= 0 (``w_press``, ``w_arm_clearance``) and the term for the
    table's edge (``w_edge``) are kept; our other additions are off. There is no terminal cost l_f (equations 8, 10, 13
    and 14), since the paper gives no formula for it. SOI's object plan ends in the exact goal.

    Args:
        method: Name of the method; see :func:`best`.
    """
    METHODS.check(method)
    samples = 1200
    horizon = {"mppi": 25, "soi": 25}.get(method, 15)
    object_horizon = {"soi": 90}.get(method, 60)
    mppi = Mppi(
        samples=samples,
        horizon=horizon,
        effective_samples=(5 / samples, 10 / samples),
        knots=0,
        special_samples=False,
    )
    return Config(
        preset="paper-printed",
        reference="time",
        reposition=Reposition(stall_seconds=0.0, least_pace=1.0),
        robot=RobotLevel(
            optimizer=mppi, controls="joint", noise_space="joint", joint_noise=0.316, joint_velocity_limit=0.2
        ),
        object=ObjectLevel(
            optimizer=replace(mppi, horizon=object_horizon),
            speed_limit=(0.12, 0.12, 1.0),
            noise_range=0.0,
            ends_at_goal=False,
            plans=1,
        ),
        cost=RobotCost(
            w_d=100.0,
            w_theta=0.08,
            w_reference=0.0 if method == "mppi" else 100.0,
            w_track=0.0,
            w_stance=0.0,
            w_ee=5.0,
            w_align=45.0,
            align_ahead=0,
            align_fade=0.0,
            w_height=20.0,
            w_press=1e4,
            w_margin=0.0,
            w_lift=0.0,
            w_above=0.0,
            w_push_ring=0.0,
            w_overhang=0.0,
            w_rush=0.0,
        ),
        episode=EpisodeConfig(tight=False, exact=False),
        safety=Safety(smoothing=0.0, filter=False),
        object_cost=ObjectCost(w_d=100.0, w_theta=0.08, w_to_go=0.0, w_margin=0.0, w_push_ring=0.0),
    )


def lab(method: str = "cloi") -> Config:
    """Returns the preset ``lab``: ``best`` with lower demands on perception and on the processor.

    The tip moves at up to 0.15 m/s, half as fast as with ``best``: an object that moves less between two detections is
    located more accurately, and an object that is hit more slowly does not tip over. The slower arm has more time to
    make headway before the tool is repositioned. Between two detections the object drifts 2 to 3 cm from where it is
    estimated, so plans keep it 45 mm from obstacles, and it is not pushed closer than 30 mm. Both levels have K = 512,
    so that a plan takes a fraction of the control period on one core. An episode does not go on to the exact tolerance.
    The object level, its margins included, and the reference's pace are those with which the lab tasks were measured:
    the same noise for all samples, a single plan of SOI, and no slowing down.

    Args:
        method: Name of the method; see :func:`best`.
    """
    base = best(method)
    return replace(
        base,
        preset="lab",
        robot=replace(
            base.robot,
            optimizer=replace(base.robot.optimizer, samples=512),
            tip_speed_limit=0.15,
            joint_velocity_limit=0.8,
            object_margin=0.03,
        ),
        reposition=replace(base.reposition, stall_seconds=7.5, least_pace=1.0, longest_seconds=8.0),
        episode=replace(base.episode, exact=False),
        object=replace(
            base.object,
            optimizer=replace(base.object.optimizer, samples=512, least_noise=1.0),
            plans=1,
            speed_limit=(0.12, 0.12, 1.0),
        ),
        object_cost=replace(base.object_cost, w_margin=2000.0, margin=0.045),
    )


PRESETS = {"best": best, "paper": paper, "paper-printed": paper_printed, "lab": lab}
