"""Straight pushes of an object: where the tool has to be, and where they bring the object. Not in the paper.

Under a force that is constant in the object's frame, the object moves with a constant twist ``x_o' = D w``
(equation 5): along an arc. A push is possible if on it the object comes too close to no obstacle, and neither do the
tool and the arm, which have to get to its beginning as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely

from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import planar_points
from oimppi_warp.planning.stance import Outline

SPACING = 0.01
"""Distance between the poses of a push, a radian counted as the outline's ``yaw_length`` [m]."""
_STEPS = 10
"""Number of these distances in the longest push."""
_EVERY = 2
"""Pushes begin at every second point of the outline."""
_DIRECTIONS = (-0.7, 0.0, 0.7)
"""Tangential forces, as shares of those at which the tool would begin to slide."""
_COMFORT = 0.002
"""Clearance below which a push must not bring the object nearer to an obstacle [m]."""
_ALLOWANCES = (0.0005, 0.005)
"""Amounts by which an object that is as near already may come nearer still: of every push, and if none is possible [m].
A wedged object slides along walls, which an arc does not."""
_LITTLE = 5e-4
"""Depth to which the tool may be in the object where it touches it [m]."""
_SAME_PLACE = 0.03
"""Distance of two places of the tool below which they count as the same [m]."""
_TRIED = 0.3
"""Added to the cost-to-go of a place for each time that it was tried before [m]; close to obstacles, a metre of way
costs up to 11."""


@dataclass(frozen=True, eq=False)
class Push:
    """A straight push.

    Attributes:
        place: Position of the tool's axis at its beginning, beside the object and in its frame, shape [2] [m].
        path: Poses of the object's friction centre, :data:`SPACING` apart, from the present one on, shape [n, 3]
            [m, m, rad].
    """

    place: np.ndarray
    path: np.ndarray


class Pushes:
    """All straight pushes of an object, from points around its outline.

    Args:
        geometry: Distance fields of the scene.
        outline: The object's outline.
        radius: The tool's radius [m].
        gap: Gap between tool and outline at the beginning of a push [m].
        blocked: Function of tool positions, shape [n, 2] [m], that returns whether the tool cannot be there, shape [n].
    """

    def __init__(
        self,
        geometry: Geometry,
        outline: Outline,
        *,
        radius: float,
        gap: float,
        blocked: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self._geometry = geometry
        self._blocked = blocked
        contact, places = outline.beside(radius), outline.beside(radius + gap)
        room = [shapely.distance(outline.shape, shapely.points(at)) > radius - _LITTLE for at in (contact, places)]
        kept = np.flatnonzero(room[0] & room[1])[::_EVERY]  # none in an inner corner, or in another part of the object
        self._contact, self._places = contact[kept], places[kept]
        twists = np.stack([outline.twists(share)[kept] for share in _DIRECTIONS], axis=1)
        self._arcs = _arcs(twists, SPACING * np.arange(1, _STEPS + 1))
        geometry.obstruction_at(np.zeros(3))  # reads the field from the device now, not while the arm moves

    def possible(self, pose: np.ndarray, *, allowance: float = _ALLOWANCES[0]) -> tuple[np.ndarray, np.ndarray]:
        """Returns all pushes of an object at a pose, and which of them are possible.

        Args:
            pose: Planar pose of the friction centre, shape [3] [m, m, rad].
            allowance: Amount by which an object that is close to an obstacle may come closer [m].

        Returns:
            Poses of the friction centre, shape [place, direction, step, 3] [m, m, rad], and whether the push is
            possible up to there, shape [place, direction, step].
        """
        paths = np.concatenate([planar_points(pose, self._arcs[..., :2]), pose[2] + self._arcs[..., 2:]], axis=-1)
        least = min(_COMFORT, float(self._geometry.obstruction_at(pose)) - allowance)
        possible = self._geometry.obstruction_at(paths) >= least
        cos, sin = np.cos(paths[..., 2]), np.sin(paths[..., 2])
        x, y = self._contact.T[:, :, None, None]
        tips = paths[..., :2] + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        possible &= ~self._blocked(tips.reshape(-1, 2)).reshape(possible.shape)
        possible &= ~self._blocked(planar_points(pose, self._places))[:, None, None]
        return paths, np.logical_and.accumulate(possible, axis=-1)

    def best(self, pose: np.ndarray, to_go_from: Callable[[np.ndarray], float], tried: list[np.ndarray]) -> Push | None:
        """Returns the possible push at whose end the object has the least way to go; ``None`` if no push is possible.

        Args:
            pose: Planar pose of the friction centre, shape [3] [m, m, rad].
            to_go_from: Function of such a pose that returns the remaining distance to the goal [m].
            tried: Places that were tried before in vain, which others are preferred to, shape [2] each [m].
        """
        for allowance in _ALLOWANCES:
            paths, possible = self.possible(pose, allowance=allowance)
            if possible.any():
                break
        else:
            return None
        to_go = np.full(possible.shape, np.inf)
        to_go[possible] = [to_go_from(end) for end in paths[possible]]
        for place in tried:
            to_go[np.linalg.norm(self._places - place, axis=1) < _SAME_PLACE] += _TRIED
        place, direction, last = np.unravel_index(np.argmin(to_go), to_go.shape)
        return Push(self._places[place], np.vstack([pose, paths[place, direction, : last + 1]]))


def _arcs(twists: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Returns the displacements (x, y, yaw) in the object's frame after moving along constant twists in that frame.

    Args:
        twists: Twists, shape [..., 3] [m, m, rad per unit of length].
        lengths: Lengths, shape [n].

    Returns:
        Shape [..., n, 3] [m, m, rad].
    """
    x, y, turn = np.moveaxis(twists[..., None, :] * lengths[:, None], -1, 0)
    straight = np.abs(turn) < 1e-6
    safe = np.where(straight, 1.0, turn)
    along = np.where(straight, 1.0, np.sin(safe) / safe)
    aside = np.where(straight, 0.5 * turn, (1.0 - np.cos(safe)) / safe)
    return np.stack([along * x - aside * y, aside * x + along * y, turn], axis=-1)
