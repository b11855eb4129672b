"""Write every file of ``scenes/``: schema, robot, objects and tasks, and the schema's page of the manual.

    python tools/make_scenes.py [FOLDER]

With a folder, ``scenes/`` and ``docs/`` go below it instead (the tests compare them with what is committed).
"""

from __future__ import annotations

import sys
from pathlib import Path

import scene_objects
import scene_robot
import scene_schema

ROOT = Path(__file__).resolve().parent.parent


def write_all(folder: Path) -> None:
    """Write ``scenes/`` and ``docs/schema.md`` below ``folder``."""
    scenes = folder / "scenes"
    scene_schema.write(scenes / "schema")
    (folder / "docs").mkdir(exist_ok=True)
    (folder / "docs" / "schema.md").write_text(scene_schema.page())
    scene_robot.write(scenes / "robots" / "xarm6.usda")
    for thing in scene_objects.THINGS:
        thing.write(scenes / "objects" / f"{thing.name}.usda")

    import scene_tasks  # reads scenes, and so the schema

    for task in scene_tasks.TASKS:
        scene_tasks.write(task, scenes)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))  # the package as it stands beside this script
    write_all(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
