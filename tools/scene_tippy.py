"""Tasks with objects that a careless push tips over: letters of thin strokes, a can, and a tall box."""

from __future__ import annotations

from oimppi_warp.authoring.object_spec import parse_object
from oimppi_warp.authoring.task import Block, Task

_OBJECTS = {
    **{f"tippy_{letter.lower()}": f"letter:{letter}" for letter in "ILTVY"},
    "tippy_can": "cylinder:0.033x0.101",
    "tippy_box": "box:0.04x0.04x0.12",
}
_START, _GOAL = (0.40, -0.30, 1.0), (0.40, 0.30, -1.0)
_SLOT = (Block("Near", (0.27, 0.0), (0.20, 0.10, 0.10)), Block("Far", (0.67, 0.0), (0.30, 0.10, 0.10)))

TASKS = tuple(
    Task(name, f"Push an object that tips easily through a slot: {spec}", parse_object(spec), _START, _GOAL, _SLOT)
    for name, spec in _OBJECTS.items()
)
