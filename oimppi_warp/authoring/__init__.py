"""Writes tasks, objects and robots as standard USD files; see docs/authoring.md.

The public names are imported on first use, so that ``import oimppi_warp.authoring`` stays cheap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oimppi_warp.lazy import names_on_first_use

if TYPE_CHECKING:
    from oimppi_warp.authoring.checks.check import check_scene
    from oimppi_warp.authoring.letters.letters import letter, word
    from oimppi_warp.authoring.meshes.solid import MeshObject, import_mesh
    from oimppi_warp.authoring.named_shapes import Parameter, Shape
    from oimppi_warp.authoring.objects.flat_object import Box, Disc, FlatObject
    from oimppi_warp.authoring.objects.outlines import box, cylinder, extrusion
    from oimppi_warp.authoring.objects.stored import read_object
    from oimppi_warp.authoring.project import WrittenTask, write_object, write_task
    from oimppi_warp.authoring.task import Block, Pillar, StaticObject, Task

_MODULES = {
    "Block": "task",
    "Box": "objects.flat_object",
    "Disc": "objects.flat_object",
    "FlatObject": "objects.flat_object",
    "MeshObject": "meshes.solid",
    "Parameter": "named_shapes",
    "Pillar": "task",
    "Shape": "named_shapes",
    "StaticObject": "task",
    "Task": "task",
    "WrittenTask": "project",
    "box": "objects.outlines",
    "check_scene": "checks.check",
    "cylinder": "objects.outlines",
    "extrusion": "objects.outlines",
    "import_mesh": "meshes.solid",
    "letter": "letters.letters",
    "read_object": "objects.stored",
    "word": "letters.letters",
    "write_object": "project",
    "write_task": "project",
}

__all__ = [
    "Block",
    "Box",
    "Disc",
    "FlatObject",
    "MeshObject",
    "Parameter",
    "Pillar",
    "Shape",
    "StaticObject",
    "Task",
    "WrittenTask",
    "box",
    "check_scene",
    "cylinder",
    "extrusion",
    "import_mesh",
    "letter",
    "read_object",
    "word",
    "write_object",
    "write_task",
]

__getattr__, __dir__ = names_on_first_use(__name__, _MODULES, globals())
