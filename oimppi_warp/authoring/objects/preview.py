"""Draws an object from above and from the side, as the planner sees it."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
from matplotlib.patches import Polygon as Patch

from oimppi_warp.authoring.meshes.convex import vertical_projection
from oimppi_warp.authoring.meshes.solid import MeshObject
from oimppi_warp.authoring.objects.flat_object import Pushable
from oimppi_warp.geometry.footprint import core_points, footprint, limit_surface
from oimppi_warp.plots.style import FAINT, GOAL, INK, START, STYLE, add_rings, rendered
from oimppi_warp.record.log import write_atomically
from oimppi_warp.scene import PushedObject

STICK = 0.008
"""Radius of the shipped arm's stick [m], drawn for scale."""


def draw_preview(obj: Pushable, body: PushedObject, file: str | Path) -> Path:
    """Draws an object's convex pieces, footprint, friction centre and limit surface.

    Args:
        obj: The object.
        body: The planner's model of the object.
        file: The PNG file to write.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.4), layout="constrained")
        above, side, surface = figure.subplots(1, 3, width_ratios=[1.3, 1.0, 1.0])
        _draw_above(above, obj, body)
        _draw_side(side, body)
        _draw_limit_surface(surface, body)
        content = rendered(figure, dpi=110)
    write_atomically(file, content)
    return Path(file)


def _draw_above(axes: Axes, obj: Pushable, body: PushedObject) -> None:
    """Draws the pieces seen from above over the mesh's own outline, with the stick for scale."""
    if isinstance(obj, MeshObject):
        for corners, triangles in obj.surface:
            projection = vertical_projection(corners, triangles)
            rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(projection)]
            add_rings(axes, rings, fc=FAINT, ec="none", zorder=1)
    for piece in footprint(body.colliders):
        shape = piece.polygon()
        axes.add_patch(Patch(shapely.get_coordinates(shape), fc=(*to_rgb(START), 0.12), ec=START, lw=0.9, zorder=2))
    center = limit_surface(body).center
    axes.plot(*center, marker="+", color=GOAL, ms=11, mew=1.6, ls="none", label="friction centre", zorder=4)
    axes.autoscale_view()
    x, y = axes.get_xlim()[1], axes.get_ylim()[0]
    axes.add_patch(Circle((x + STICK, y + STICK), STICK, fc=INK, ec="none", label="the stick", zorder=3))
    pieces = len(body.colliders)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"{obj.name}, {body.mass:g} kg")
    axes.autoscale_view()
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, fontsize=8)
    axes.set_title(f"{pieces} convex piece{'' if pieces == 1 else 's'}", loc="right", fontsize=8, fontweight="normal")


def _draw_side(axes: Axes, body: PushedObject) -> None:
    """Draws the pieces seen along y, standing on the table, and the centre of mass."""
    for collider in body.colliders:
        points, radius = core_points(collider)
        flat = np.column_stack([points[:, 0], points[:, 2] + body.rest_height])
        shape = shapely.MultiPoint(flat).convex_hull.buffer(radius)
        if shape.geom_type == "Polygon":
            axes.add_patch(Patch(shapely.get_coordinates(shape), fc=(*to_rgb(START), 0.12), ec=START, lw=0.9))
    x, _, z = body.center_of_mass
    axes.plot(x, z + body.rest_height, marker="o", color=GOAL, ms=4, ls="none")
    axes.axhline(0.0, color=INK, lw=1.2)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", title="side view")
    axes.annotate("centre of mass", (x, z + body.rest_height), (6, 3), textcoords="offset points", fontsize=7)


def _draw_limit_surface(axes: Axes, body: PushedObject) -> None:
    """Draws the friction ellipsoid, cut along one force and the torque."""
    surface = limit_surface(body)
    torque = 1000.0 * surface.radius * surface.force
    axes.add_patch(Ellipse((0.0, 0.0), 2 * surface.force, 2 * torque, fc=(*to_rgb(GOAL), 0.10), ec=GOAL, lw=1.4))
    axes.set(
        xlim=(-1.15 * surface.force, 1.15 * surface.force),
        ylim=(-1.15 * torque, 1.15 * torque),
        xlabel="force [N]",
        ylabel="torque [N mm]",
        title="limit surface",
    )
    axes.set_box_aspect(1.0)
    axes.set_title(f"friction {body.friction:g}", loc="right", fontsize=8, fontweight="normal")
