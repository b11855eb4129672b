"""Converts frames and numbers between USD and the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Gf


def scales(frame: Gf.Matrix4d) -> np.ndarray:
    """Returns the scale of a frame along each of its axes, shape [3]; all 1 without scaling."""
    return np.array([frame.GetRow3(i).GetLength() for i in range(3)])


def is_rigid(frame: Gf.Matrix4d) -> bool:
    """Returns whether a frame is neither scaled nor mirrored.

    It may be sheared; :func:`is_orthogonal` tests that. The shapes of a sheared body are reported as sheared when they
    are read.
    """
    return bool(np.allclose(scales(frame), 1.0, atol=1e-5)) and frame.GetDeterminant() > 0


def is_orthogonal(frame: Gf.Matrix4d) -> bool:
    """Returns whether a frame's axes are orthogonal: possibly scaled, but not sheared."""
    rows = np.array([frame.GetRow3(i).GetNormalized() for i in range(3)])
    return bool(np.allclose(rows @ rows.T, np.eye(3), atol=1e-5))


def transform(frame: Gf.Matrix4d) -> np.ndarray:
    """Converts a frame, ignoring its scale and shear, to position [m] and quaternion xyzw, shape [7]."""
    q = frame.GetOrthonormalized().ExtractRotationQuat().GetNormalized()
    return np.array([*frame.ExtractTranslation(), *q.GetImaginary(), q.GetReal()])


def matrix(position: Any, orientation: Any) -> Gf.Matrix4d:
    """Returns the frame with the given position and orientation.

    Args:
        position: Position, shape [3] [m]; rounded to the shortest decimals of single precision.
        orientation: A Gf quaternion of any precision; it is normalized.
    """
    q = Gf.Quatd(float(orientation.GetReal()), Gf.Vec3d(orientation.GetImaginary())).GetNormalized()
    return Gf.Matrix4d().SetTransform(Gf.Rotation(q), Gf.Vec3d(*map(shortest_decimal, position)))


def shortest_decimal(value: float) -> float:
    """Returns the shortest decimal that rounds to a single-precision value: 0.4, not 0.4000000059604645."""
    return float(str(np.float32(value)))


def format_numbers(values: np.ndarray) -> str:
    """Formats numbers for a message, to 4 significant digits: ``(0.1, -2)``."""
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
