"""Finds a start pose for an arm: its tool upright, the tip slightly above the table in front of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.kinematics import (
    ROUNDED_ANGLE,
    is_level,
    link_frames,
    link_heights,
    parallel,
    revolute_joints,
    tip_frame,
)
from oimppi_warp.geometry.postures import upright_from
from oimppi_warp.geometry.reach import lowest_tip, reach_of
from oimppi_warp.scene import Robot

HEIGHT = 0.05
"""Height of the tip at the start [m]."""
PUSHING = (0.004, 0.03)
"""Range of tip heights allowed for a robot that cannot move its tool vertically [m]."""
ROOM = 0.02
"""Clearance to the table of every link that a joint can lower [m]."""
_DISTANCES = (0.36, 0.45, 0.30, 0.55, 0.25, 0.65, 0.80, 1.0, 0.20, 0.15)
"""Distances from the base at which a tip position is tried, in this order [m]."""
_AZIMUTHS = (-0.588, 0.0, 0.588)
"""Directions in which it is tried, in this order; the first is that of the shipped tasks [rad]."""
_LENGTHS = (0.05, -0.05, 0.1, -0.1, -0.14, 0.2, 0.3)
"""Changes of the stick's length that are tried for an arm that has no start [m]."""
_USUAL_SHOULDER, _FAR_OFF = 0.15, 0.3
"""Usual height of the first joint above the table, and the difference from it that makes one doubt the file [m]."""
_UP = np.array([0.0, 0.0, 1.0])
_TRIES = 60
_SPARE = 0.03
"""Margin that every joint must have to its limits, as a share of its whole range."""


def with_start(arm: Arm, *, file: object = "", links: Sequence[str] = (), joints: Sequence[str] = ()) -> Arm:
    """Returns the arm with a start pose, its joint positions rounded for readability.

    Args:
        arm: The arm, at any joint positions.
        file: Path of the robot's source file, for error messages.
        links, joints: Names of the moving links and of the joints, from base to flange, for error messages.

    Raises:
        SceneError: No start pose was found, or the tip does not get down to the table. The message gives the test that
            all candidates failed.
    """
    robot = arm.robot()
    lower, upper = _ranges(robot)[-1]
    middle, height = (lower + upper) / 2, HEIGHT
    if is_flat(robot):
        height = float(tip_frame(robot, middle)[1][2])
        _check_height(robot, middle, height, file)
    best, rejected = _search_ahead(robot, height)
    if best is None:
        raise _no_start(arm, height, rejected, file, links, joints)
    found = replace(arm, start=best)
    _check_reach(found.robot(), file)
    return found


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Joint positions that hold the tool upright above the table, with what decides whether an arm can start there.

    Attributes:
        joints: Joint positions, shape [dof] [rad; m].
        heights: Height of the lowest point of each link, shape [dof] [m]; see :func:`lowered_heights`.
        spare: Distance of each joint to its limits, as a share of its range, shape [dof].
    """

    joints: np.ndarray
    heights: np.ndarray
    spare: np.ndarray


_Range = tuple[np.ndarray, np.ndarray]
"""Least and greatest joint positions, shape [dof] each [rad; m]."""
_Found = tuple[tuple[float, ...] | None, list[_Candidate]]
"""The best start, ``None`` if there is none, and the candidates that are unusable."""


def _search_ahead(robot: Robot, height: float) -> _Found:
    """Looks for a start in front of the base's origin, or else of the axis about which the arm turns."""
    axis = _first_axis(robot)
    best, rejected = None, list[_Candidate]()
    for within in _ranges(robot):
        best, rejected = _search_within(robot, within, height, _AZIMUTHS[0], _DISTANCES)
        for azimuth in _AZIMUTHS if axis.any() else _AZIMUTHS[1:]:
            if best is None:
                best, more = _search_within(robot, within, height, azimuth, _DISTANCES, axis)
                rejected += more
        if best is not None:
            break
    return best, rejected


def _first_axis(robot: Robot) -> np.ndarray:
    """Returns the place of the first joint if it turns about a vertical axis; otherwise the origin, shape [2] [m]."""
    rotations, positions = link_frames(robot, robot.start)
    turns = robot.joints[0].kind == "revolute" and parallel(rotations[0][:, 2], _UP)
    return positions[0][:2] if turns else np.zeros(2)


def _search(
    robot: Robot,
    height: float,
    azimuth: float,
    distances: Sequence[float] = _DISTANCES,
    center: np.ndarray | None = None,
) -> _Found:
    """Looks for a start with the tip in a direction [rad] from a point [2] [m], by default the origin, at a height."""
    best, rejected = None, list[_Candidate]()
    for within in _ranges(robot):
        if best is None:
            best, rejected = _search_within(robot, within, height, azimuth, distances, center)
    return best, rejected


def _search_within(
    robot: Robot,
    within: _Range,
    height: float,
    azimuth: float,
    distances: Sequence[float],
    center: np.ndarray | None = None,
) -> _Found:
    """Looks for a start like :func:`_search`, with joint positions within a range."""
    lower, upper = within
    guesses, best = _guesses(robot, within, np.random.default_rng(0), azimuth), (-np.inf, ())
    rejected: list[_Candidate] = []
    for distance in distances:
        target = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
        if center is not None:
            target[:2] += center
        solved, good = upright_from(robot, guesses, target)
        for joints in solved[good]:
            joints = _rounded(robot, within, joints)
            spare = np.minimum(joints - lower, upper - joints) / (upper - lower)
            found = _Candidate(joints, lowered_heights(robot, joints), spare)
            if found.heights.min() < ROOM or found.spare.min() < _SPARE:  # also if it is outside of the range
                rejected.append(found)
            else:
                best = max(best, (_score(robot, within, found), tuple(joints.tolist())))
        if best[1]:
            return best[1], rejected
    return None, rejected


def _no_start(
    arm: Arm,
    height: float,
    rejected: list[_Candidate],
    file: object,
    links: Sequence[str],
    joints: Sequence[str],
) -> SceneError:
    """Returns the error for an arm without a start: it names what all candidates failed."""
    robot = arm.robot()
    clear = [each for each in rejected if each.heights.min() >= ROOM]
    if clear:
        nearest = max(clear, key=lambda each: each.spare.min())
        number = int(np.argmin(nearest.spare))
        lower, upper = robot.joints[number].lower, robot.joints[number].upper
        name = joints[number] if joints else f"joint {number + 1}"
        return SceneError(
            f"the tool can be held upright above the table only with joint {name} at a limit "
            f"({nearest.joints[number]:.3g}, where it goes from {lower:.3g} to {upper:.3g})",
            file=file,
            allowed=f"{100 * _SPARE:g} % of its range between each joint and its limits",
            fix="choose another --tool-length, --tool-axis or --flange, or correct the limits of the joint",
        )
    if rejected:
        highest = max(rejected, key=lambda each: each.heights.min())
        number = int(np.argmin(highest.heights))
        name = links[number] if links else f"{number + 1}"
        return SceneError(
            f"of {len(rejected)} joint positions that hold the tool upright above the table, the best has link {name} "
            f"{highest.heights[number]:.3f} m above it",
            file=file,
            allowed=f"at least {ROOM:g} m below every link",
            fix="use a longer --tool-length, or correct the collision shapes of the link",
        )
    bends = revolute_joints(robot) & ~is_level(robot)
    if bends.any() and robot.dof < 4:
        return SceneError(
            f"the robot has only {robot.dof} joints: it cannot hold the stick upright and move it over the table",
            file=file,
            allowed="four joints or more, or joints that move the stick without tilting it",
            fix="with --flange, name a link further out, if there is one",
        )
    return SceneError(
        "no joint positions were found that hold the tool upright above the table in front of the arm",
        file=file,
        allowed=f"a tip {HEIGHT:g} m above z = 0, {min(_DISTANCES):g} to {max(_DISTANCES):g} m from the base along x",
        fix=_remedy(arm, height)
        or "check --flange, --tool-axis and --tool-length, and that z points up and is zero at the table's top",
    )


def _remedy(arm: Arm, height: float) -> str:
    """Returns what gives an arm a start: its base turned or on the table, or another stick; else nothing."""
    robot, stick = arm.robot(), arm.stick
    for name, azimuth in {"-x": np.pi, "y": np.pi / 2, "-y": -np.pi / 2}.items():
        if _search(robot, height, azimuth, _DISTANCES[::3], _first_axis(robot))[0]:
            return f"turn its base: the tool gets to the table on the side of {name}"
    first = robot.joints[0]
    height_there = float(first.parent_transform[2])
    raised = first.parent_transform.copy()
    raised[2] = _USUAL_SHOULDER
    on_table = replace(robot, joints=(replace(first, parent_transform=raised), *robot.joints[1:]))
    if abs(height_there - _USUAL_SHOULDER) > _FAR_OFF and _search(on_table, height, _AZIMUTHS[0])[0]:
        side = "below" if height_there < 0.0 else "above"
        return f"put its base on the table, z = 0: its first joint is {abs(height_there):.2f} m {side} that"
    lengths = [stick.length + more for more in _LENGTHS if stick.length + more > 2.0 * stick.radius]
    for length in lengths:
        if _search(replace(arm, stick=replace(stick, length=length)).robot(), height, _AZIMUTHS[0])[0]:
            return f"give a --tool-length of {length:.3g} m"
    axes = link_frames(robot, robot.start)[0][revolute_joints(robot), :, 2]
    if tip_frame(robot, robot.start)[0][2, 2] > 0.9 and parallel(axes, _UP).all():
        return "give the opposite --tool-axis: no joint turns the stick, which points up"
    return ""


def _check_reach(robot: Robot, file: object) -> None:
    """Raises SceneError if the tip does not get down to the table."""
    if reach_of(robot).radius > 0.0:
        return
    low = lowest_tip(robot, robot.start)
    raise SceneError(
        f"the tip gets no lower than {low:.3f} m with the tool upright",
        file=file,
        allowed="a tip that gets down to the table, at z = 0",
        fix=f"give a --tool-length that is longer by {low:.3f} m",
    )


def _ranges(robot: Robot) -> list[_Range]:
    """Returns the ranges of joint positions in which a start is looked for, one after the other.

    The first is within half a turn of zero, where an arm is usually stretched: beyond it, the elbow of many arms is
    folded. The last is between the joints' limits; of a joint that turns further than once, the turn nearest to zero.
    """
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    turns = revolute_joints(robot)
    further = turns & (upper - lower > 2.0 * np.pi)
    from_ = np.where(further, np.clip(-np.pi, lower, upper - 2.0 * np.pi), lower)
    to = np.where(further, from_ + 2.0 * np.pi, upper)
    near = turns & (np.minimum(to, np.pi) - np.maximum(from_, -np.pi) > 0.1)
    usual = np.where(near, np.maximum(from_, -np.pi), from_), np.where(near, np.minimum(to, np.pi), to)
    whole = from_, to
    return [whole] if np.array_equal(usual, whole) else [usual, whole]


def _into(lower: np.ndarray | float, joints: np.ndarray | float) -> np.ndarray:
    """Returns angles in the turn that begins at ``lower`` [rad]."""
    return np.mod(joints - lower, 2.0 * np.pi) + lower


def _guesses(robot: Robot, within: _Range, random: np.random.Generator, azimuth: float) -> np.ndarray:
    """Returns initial guesses of joint positions: the first joint turned to a direction, some of the others bent."""
    lower, upper = within
    middle, guesses = (lower + upper) / 2, []
    turned = _into(lower[0], azimuth)
    ahead = turned if turned <= upper[0] else azimuth
    for _ in range(_TRIES):
        bent = np.where(random.random(robot.dof) < 0.6, random.uniform(lower, upper), middle)
        bent[0] = np.clip(ahead, lower[0], upper[0]) if revolute_joints(robot)[0] else middle[0]
        guesses.append(bent)
    return np.array([middle, *guesses])


def _score(robot: Robot, within: _Range, found: _Candidate) -> float:
    """Rates a start by table clearance, margin to the limits and lack of twists."""
    lower, upper = within
    twisted = float(np.linalg.norm((found.joints - (lower + upper) / 2) * revolute_joints(robot)))
    return min(float(found.heights.min()), 0.1) + 0.2 * min(float(found.spare.min()), 0.2) - 0.02 * twisted


def _rounded(robot: Robot, within: _Range, joints: np.ndarray) -> np.ndarray:
    """Returns the joint positions without whole turns, where the range allows, rounded to a few digits."""
    lower, upper = within
    wrapped = _into(lower, joints)
    allowed = revolute_joints(robot) & (lower <= wrapped) & (wrapped <= upper)
    return np.clip(np.round(np.where(allowed, wrapped, joints), 4) + 0.0, lower, upper)


def is_flat(robot: Robot) -> bool:
    """Returns whether the tool moves only horizontally.

    That is the case if every revolute axis is vertical and every prismatic axis is horizontal.
    """
    return bool(is_level(robot).all())


def lowered_heights(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Returns the height of the lowest point of each moving link, without the stick, shape [dof] [m].

    It is infinite for a link without shapes, and for one that no joint can lower, such as a turret.
    """
    return np.where(is_level(robot), np.inf, link_heights(robot, joints))


def _check_height(robot: Robot, joints: np.ndarray, height: float, file: object) -> None:
    """Raises SceneError if a robot without vertical motion has a tilted tool, or one at a wrong height for pushing."""
    if tip_frame(robot, joints)[0][2, 2] > -np.cos(ROUNDED_ANGLE):
        raise SceneError(
            "the stick does not point down",
            file=file,
            allowed="a stick that points down",
            fix="choose another axis of the flange with --tool-axis",
        )
    low, high = PUSHING
    if not low <= height <= high:
        raise SceneError(
            f"the robot cannot raise or lower its tool, and the tip is at {height:.3f} m",
            file=file,
            allowed=f"{low:g} to {high:g} m above the table",
            fix=f"{'increase' if height > high else 'decrease'} --tool-length by {abs(height - 0.012):.3f} m",
        )
