"""Decomposes a flat shape into convex pieces that do not overlap, as required for colliders."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import cast

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

GRID = 1e-5
"""Spacing of the grid that corners are rounded to [m]."""

LEAST_AREA = 1e-8
"""Smaller pieces are rounding artefacts and are dropped [m^2]."""


def convex_pieces(shape: BaseGeometry) -> tuple[np.ndarray, ...]:
    """Cuts a shape into convex pieces.

    It is triangulated (constrained Delaunay), and neighbours whose union is convex are merged again, those with the
    longest common edge first (Hertel and Mehlhorn, 1983: at most four times the minimum number of pieces).

    Args:
        shape: One or more polygons, which may have holes [m].

    Returns:
        Convex polygons, counter-clockwise, shape [n, 2] each [m]; ordered from left to right.
    """
    clean = shapely.set_precision(shape, GRID)
    triangles = [cast(Polygon, part) for part in shapely.constrained_delaunay_triangles(clean).geoms]
    pieces = _join(part for part in triangles if part.area > LEAST_AREA)
    corners = [_corners(piece) for piece in pieces]
    return tuple(sorted(corners, key=lambda polygon: tuple(np.round(polygon.mean(axis=0), 6))))


def _join(parts: Iterable[Polygon]) -> list[Polygon]:
    """Merges neighbours as long as their union is convex."""
    alive = dict(enumerate(parts))
    edges = {(i, j): _common(alive[i], alive[j]) for i, j in combinations(alive, 2)}
    edges = {pair: length for pair, length in edges.items() if length > GRID}
    while edges:
        (i, j), _ = max(edges.items(), key=lambda item: (round(item[1], 9), item[0]))
        joined = shapely.union(alive[i], alive[j], grid_size=GRID)
        if not isinstance(joined, Polygon) or joined.convex_hull.area - joined.area > LEAST_AREA:
            del edges[i, j]
            continue
        number = max(alive) + 1
        del alive[i], alive[j]
        alive[number] = joined
        around = {a if b in (i, j) else b for a, b in edges if {a, b} & {i, j}} - {i, j}
        edges = {pair: length for pair, length in edges.items() if not {i, j} & set(pair)}
        edges |= {(k, number): _common(alive[k], joined) for k in around}
    return list(alive.values())


def _common(a: Polygon, b: Polygon) -> float:
    """Returns the length of the edge that two polygons share [m]."""
    return shapely.length(shapely.intersection(a.exterior, b.exterior)) if a.intersects(b) else 0.0


def _corners(piece: Polygon) -> np.ndarray:
    """Returns a convex polygon's corners, counter-clockwise, without those that lie on a straight edge."""
    hull = cast(Polygon, piece.convex_hull.simplify(GRID / 2))
    return np.round(np.asarray(orient(hull).exterior.coords)[:-1], 6)
