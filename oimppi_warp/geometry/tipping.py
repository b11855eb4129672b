"""Whether a push tips an object over instead of moving it along, in closed form."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import shapely
from shapely import Polygon

from oimppi_warp.geometry.footprint import GRAVITY, footprint, height_range, outline
from oimppi_warp.scene import PushedObject


def support_margin(body: PushedObject) -> float:
    """Distance of the centre of mass, seen from above, to the edge of what the object stands on [m]."""
    hull = cast(Polygon, outline(footprint(body.colliders)).convex_hull)
    center = shapely.Point(np.asarray(body.center_of_mass[:2], dtype=float))
    return float(shapely.distance(hull.exterior, center)) if hull.contains(center) else 0.0


def tipping_height(body: PushedObject) -> float:
    """Height from which a slow push tips the object rather than moves it [m].

    A push that moves it bears its friction ``mu m g``; at the height ``z`` that is the moment ``mu m g z`` about the
    far edge, against ``m g s`` of its weight with the support margin ``s``: it tips from ``z = s / mu``.
    """
    return support_margin(body) / max(body.friction, 1e-6)


def can_tip(body: PushedObject) -> bool:
    """Whether it can be touched higher than at its :func:`tipping_height`."""
    return body.rest_height + height_range(body.colliders)[1] > tipping_height(body)


def tipping_speed(body: PushedObject) -> float:
    """Speed at which the object topples when its far edge is stopped [m/s].

    The energy that lifts the centre of mass from its height ``h`` to right above the edge, at distance ``s``:
    ``v^2 / 2 = g (sqrt(s^2 + h^2) - h)``.
    """
    h = body.rest_height + float(body.center_of_mass[2])
    return math.sqrt(2.0 * GRAVITY * (math.hypot(support_margin(body), h) - h))
