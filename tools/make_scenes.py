"""Writes all files in ``scenes/`` (schema, robots, objects and tasks), and the schema's page ``docs/schema.md``.

    python tools/make_scenes.py [FOLDER]

If a folder is given, ``scenes/`` and ``docs/`` are written there (the tests compare them with the committed files).
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # imports the package from this checkout

import scene_arm7  # noqa: E402
import scene_gantries  # noqa: E402
import scene_pusht  # noqa: E402
import scene_robot  # noqa: E402
import scene_tasks  # noqa: E402
import scene_tippy  # noqa: E402

from oimppi_warp.authoring import schema, task  # noqa: E402
from oimppi_warp.authoring.objects import catalog  # noqa: E402

NOTE = "Written by tools/make_scenes.py; do not edit by hand."


def write_all(folder: Path) -> None:
    """Write ``scenes/`` and ``docs/schema.md`` below ``folder``."""
    scenes = folder / "scenes"
    schema.write(scenes / "schema")
    (folder / "docs").mkdir(exist_ok=True)
    (folder / "docs" / "schema.md").write_text(schema.page())
    scene_robot.write(scenes / "robots")
    scene_arm7.write(scenes / "robots")
    scene_gantries.write(scenes / "robots")
    for obj in catalog.OBJECTS:
        obj.write(scenes / "objects" / f"{obj.name}.usda", note=NOTE)
    for each in scene_tasks.TASKS:
        task.write(each, scenes, note=NOTE)
    scene_pusht.write(scenes, note=NOTE)
    for each in scene_tippy.TASKS:
        each.object.write(scenes / "tippy" / "objects" / f"{each.object.name}.usda", note=NOTE)
        task.write(each, scenes / "tippy", note=NOTE, robots="../robots")


if __name__ == "__main__":
    write_all(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
