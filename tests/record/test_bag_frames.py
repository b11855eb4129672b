"""Frames: the latest transform along a chain, compared with SciPy's rotations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oimppi_warp.record.bag_frames import FrameTree, inverse, multiply, transform_of
from oimppi_warp.record.log import LogError


def message(parent: str, child: str, position: Any = (0, 0, 0), quaternion: Any = (0, 0, 0, 1)) -> Any:
    """Stands for a tf2_msgs/TFMessage with one transform."""
    translation = SimpleNamespace(**dict(zip("xyz", position, strict=True)))
    rotation = SimpleNamespace(**dict(zip("xyzw", quaternion, strict=True)))
    moved = SimpleNamespace(translation=translation, rotation=rotation)
    header = SimpleNamespace(frame_id=parent)
    return SimpleNamespace(transforms=[SimpleNamespace(header=header, child_frame_id=child, transform=moved)])


def x_of(tree: FrameTree, frame: str, time: float) -> float | None:
    found = tree.transform(frame, "world", time)
    return None if found is None else float(found[0])


def test_products_and_inverses_are_those_of_rotations():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = (np.concatenate([rng.normal(size=3), Rotation.random(rng=rng).as_quat()]) for _ in range(2))
        turn, other = Rotation.from_quat(a[3:]), Rotation.from_quat(b[3:])
        product = multiply(a, b)
        np.testing.assert_allclose(product[:3], turn.apply(b[:3]) + a[:3], atol=1e-12)
        assert (Rotation.from_quat(product[3:]) * (turn * other).inv()).magnitude() < 1e-7
        np.testing.assert_allclose(multiply(a, inverse(a))[:3], 0.0, atol=1e-12)
        np.testing.assert_allclose(abs(multiply(a, inverse(a))[6]), 1.0, atol=1e-12)


def test_the_latest_transform_counts_and_before_the_first_there_is_none():
    tree = FrameTree()
    for time, x in ((1.0, 0.1), (2.0, 0.2)):
        tree.add(message("/world", "/block", (x, 0, 0)), time, static=False)
    assert [x_of(tree, "block", time) for time in (0.9, 1.0, 1.9, 2.0, 9.0)] == [None, 0.1, 0.1, 0.2, 0.2]
    assert tree.updates("block") == [1.0, 2.0]
    assert tree.frames == ("block", "world")


def test_a_static_transform_holds_at_all_times_unless_the_frame_moves():
    tree = FrameTree()
    tree.add(message("world", "camera", (1, 0, 0)), 5.0, static=True)
    tree.add(message("camera", "block", (0.5, 0, 0)), 1.0, static=False)
    assert x_of(tree, "block", 1.0) == 1.5
    tree.add(message("camera", "block", (7, 0, 0)), 2.0, static=True)
    assert x_of(tree, "block", 3.0) == 1.5
    assert tree.updates("camera") == []


def test_a_frame_that_is_fixed_to_a_moving_one_is_reported_with_it():
    tree = FrameTree()
    tree.add(message("world", "hand"), 1.0, static=False)
    tree.add(message("hand", "tool", (0.1, 0, 0)), 0.0, static=True)
    assert tree.updates("tool") == [1.0]


def test_two_branches_meet_where_they_begin():
    tree = FrameTree()
    tree.add(message("map", "world", (1, 0, 0)), 0.0, static=True)
    tree.add(message("map", "block", (3, 0, 0)), 0.0, static=True)
    assert x_of(tree, "block", 0.0) == 2.0


def test_frames_without_a_connection_are_named():
    tree = FrameTree()
    tree.add(message("camera", "block"), 0.0, static=False)
    with pytest.raises(
        LogError, match=r"block is not connected to world.*\n  allowed: block, camera\n  to do:   --world"
    ):
        tree.transform("block", "world", 0.0)


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, np.nan), (np.inf, 0, 0, 1)])
def test_what_is_no_rotation_is_not_a_number(quaternion: Any):
    made = message("a", "b", (1, 2, 3), quaternion).transforms[0].transform
    assert np.isnan(transform_of(made.translation, made.rotation)).all()


def test_a_quaternion_need_not_have_length_one():
    made = message("a", "b", (1, 2, 3), (0, 0, 2, 2)).transforms[0].transform
    root = np.sqrt(0.5)
    np.testing.assert_allclose(transform_of(made.translation, made.rotation), [1, 2, 3, 0, 0, root, root])
