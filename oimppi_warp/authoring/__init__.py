"""Writing tasks, objects and robots as standard USD files; docs/authoring.md shows how.

The public names are imported on first use, so that ``import oimppi_warp.authoring`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oimppi_warp.authoring.check import check_scene
    from oimppi_warp.authoring.letters import letter, word
    from oimppi_warp.authoring.project import Written, write_object, write_task
    from oimppi_warp.authoring.shapes import box, cylinder, flat
    from oimppi_warp.authoring.solid import Solid, import_mesh
    from oimppi_warp.authoring.stored import read_object
    from oimppi_warp.authoring.task import Block, Pillar, Standing, Task
    from oimppi_warp.authoring.thing import Box, Disc, Thing

_MODULES = {
    "Block": "task",
    "Box": "thing",
    "Disc": "thing",
    "Pillar": "task",
    "Solid": "solid",
    "Standing": "task",
    "Task": "task",
    "Thing": "thing",
    "Written": "project",
    "box": "shapes",
    "check_scene": "check",
    "cylinder": "shapes",
    "flat": "shapes",
    "import_mesh": "solid",
    "letter": "letters",
    "read_object": "stored",
    "word": "letters",
    "write_object": "project",
    "write_task": "project",
}

__all__ = [
    "Block",
    "Box",
    "Disc",
    "Pillar",
    "Solid",
    "Standing",
    "Task",
    "Thing",
    "Written",
    "box",
    "check_scene",
    "cylinder",
    "flat",
    "import_mesh",
    "letter",
    "read_object",
    "word",
    "write_object",
    "write_task",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
