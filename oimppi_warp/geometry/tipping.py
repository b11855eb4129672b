"""Closed-form conditions under which a push tips an object over instead of sliding it."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import shapely
from shapely import Polygon

from oimppi_warp.geometry.footprint import GRAVITY, footprint, height_range, outline
from oimppi_warp.scene import PushedObject


def support_margin(body: PushedObject) -> float:
    """Returns the distance of the centre of mass to the edge of the footprint's hull, from above [m]; 0 outside it."""
    hull = cast(Polygon, outline(footprint(body.colliders)).convex_hull)
    center = shapely.Point(np.asarray(body.center_of_mass[:2], dtype=float))
    return float(shapely.distance(hull.exterior, center)) if hull.contains(center) else 0.0


def tipping_height(body: PushedObject) -> float:
    """Returns the height above which a slow push tips the object instead of sliding it [m].

    A push that slides it overcomes the friction ``mu m g``. At the height ``z`` its moment about the far edge is
    ``mu m g z``, against ``m g s`` of the weight with the support margin ``s``: the object tips from ``z = s / mu``.
    """
    return support_margin(body) / max(body.friction, 1e-6)


def can_tip(body: PushedObject) -> bool:
    """Returns whether the object's top is above its :func:`tipping_height`, so that a push there tips it over."""
    return body.rest_height + height_range(body.colliders)[1] > tipping_height(body)


def tipping_speed(body: PushedObject) -> float:
    """Returns the speed at which the object topples when its far edge is stopped [m/s].

    Its energy then lifts the centre of mass from its height ``h`` to the point above the edge, at distance ``s``:
    ``v^2 / 2 = g (sqrt(s^2 + h^2) - h)``.
    """
    h = body.rest_height + float(body.center_of_mass[2])
    return math.sqrt(2.0 * GRAVITY * (math.hypot(support_margin(body), h) - h))
