"""The commands ``oimppi scene new`` and ``oimppi scene import``."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from oimppi_warp.authoring import named_shapes

if TYPE_CHECKING:
    from oimppi_warp.authoring.object_spec import ShapeOptions
    from oimppi_warp.scene import PushedObject

_Unit = Literal["mm", "cm", "m", "inch"]
_Lay = Literal["stable", "as-is"]


def _taken_by(option: str, default: str) -> Callable[[str], str]:
    """Hint of an option that some shapes take: which do, and its default; read when help is asked for."""
    return lambda _: f"(with {', '.join(named_shapes.shapes_taking(option, lambda name, _: name))}; default: {default})"


def _object_hint(default: str) -> str:
    """Hint of an option that takes an object."""
    return f"({named_shapes.objects()}; default: {default})"


@dataclass(frozen=True, kw_only=True)
class ObjectOptions:
    """How an object is made."""

    mass: Annotated[float | None, arg(metavar="KG", help_behavior_hint="(default: what wood of its volume weighs)")] = (
        None
    )
    """The object's mass."""

    friction: Annotated[float | None, arg(metavar="MU", help_behavior_hint="(default: 0.4 or the object's)")] = None
    """Coulomb coefficient between object and table."""

    height: Annotated[float | None, arg(metavar="M", help_behavior_hint=_taken_by("height", "0.05"))] = None
    """Thickness in metres, where the word does not say it."""

    size: Annotated[
        float | None, arg(metavar="M", help_behavior_hint=_taken_by("size", "0.103, less for long words"))
    ] = None
    """Height of a letter as it lies, in metres."""

    font: Annotated[
        str | None, arg(metavar="FONT", help_behavior_hint=_taken_by("font", "an alphabet of our own, A to Z"))
    ] = None
    """Take letters from an installed font, or from a font's file."""

    scale: Annotated[_Unit | None, arg(help_behavior_hint=_taken_by("scale", "m"))] = None
    """Unit that a mesh is in: STL and OBJ do not say."""

    lay: Annotated[_Lay, arg(help_behavior_hint=_taken_by("lay", "stable"))] = "stable"
    """How a mesh is laid on the table: in its most stable pose, or with its z axis up as it was modelled."""

    out: Annotated[Path, arg(metavar="DIR")] = Path(".")
    """Folder to write to; objects go to its objects/, the robot to its robots/."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite what is there."""

    def shape_options(self) -> ShapeOptions:
        """The options as the words take them."""
        from oimppi_warp.authoring.object_spec import ShapeOptions

        return ShapeOptions(
            mass=self.mass,
            friction=self.friction,
            height=self.height,
            size=self.size,
            font=self.font,
            scale=self.scale,
            lay=self.lay,
        )


@dataclass(frozen=True, kw_only=True)
class New(ObjectOptions):
    """Write a new task: a scene with what is pushed, from where to where, and what stands in the way.

    It is checked before it is left there: nothing overlaps, and the arm reaches start and goal. The file says at each
    attribute what it means; edit it by hand as you like. Exit status: 0, or 2 for a task that cannot be done.
    Try `oimppi scene new push_s --object letter:S --goal 0.5,0.2,1.57 --obstacle box:0.1,0.1,0.1@0.5,-0.1`.
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of the task: NAME.usda is written."""

    object: Annotated[str, arg(help_behavior_hint=_object_hint)] = "t-block"
    """What is pushed: the name of an object in DIR/objects, or one of these:"""

    start: Annotated[str, arg(metavar="X,Y,YAW")] = "0.3,-0.45,0"
    """Where the object starts: metres and radians, from the centre of the arm's base. Write --start=-0.1,... if it
    begins with a minus."""

    goal: Annotated[str, arg(metavar="X,Y,YAW")] = "0.5,0.3,3.14159"
    """Where it should go."""

    obstacle: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="OBJECT@X,Y[,YAW]", help_behavior_hint="(repeatable)")
    ] = ()
    """What stands in the way: whatever can be pushed, standing fast, as box:0.1x0.1x0.1@0.5,0.05 or
    letter:O@0.5,0.3,-1.57."""

    title: Annotated[str | None, arg(metavar="TEXT", help_behavior_hint="")] = None
    """One line about the task."""

    robot: str = "xarm6"
    """A shipped robot, one in DIR/robots, or a USD file of one."""

    def execute(self) -> int:
        """Write it; returns the exit status."""
        from oimppi_warp.authoring.object_spec import check_used, checked_pose, parse_object, parse_obstacles
        from oimppi_warp.authoring.project import write_task
        from oimppi_warp.authoring.task import PAPER, Task
        from oimppi_warp.geometry.tipping import can_tip, tipping_height

        start, goal = checked_pose("--start", self.start), checked_pose("--goal", self.goal)
        options = self.shape_options()
        check_used(options, (self.object, *self.obstacle))
        with _working("making the object"):
            obj = parse_object(self.object, options, folder=self.out)
        task = Task(
            name=self.name.removesuffix(".usda"),
            title=self.title or f"Push {_with_article(obj.doc)} to its goal",
            object=obj,
            start=start,
            goal=goal,
            obstacles=parse_obstacles(self.obstacle, options, folder=self.out),
            tolerance=PAPER if obj.yaw_matters else (PAPER[0], math.inf),
            tight=(0.05, 0.1 if obj.yaw_matters else math.inf),
            robot=self.robot,
        )
        written = write_task(task, self.out, force=self.force)
        for file in written.files:
            print(f"wrote {file}")
        body = written.scene.object
        print(_summary(obj.doc, body))
        if can_tip(body):
            print(
                f"a push above {1000 * tipping_height(body):.0f} mm tips it over: the planner touches it low and slowly"
            )
        print("checked: nothing overlaps, the arm reaches start and goal")
        print("next:")
        for command in ("scene check", "view", "run"):
            print(f"  oimppi {command} {shlex.quote(str(written.file))}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Import(ObjectOptions):
    """Make an object from a mesh: closed, laid on the table, cut into convex pieces, with a picture beside it.

    It says how far the pieces are from the mesh. A mesh that cannot be pushed is refused with the reason. Other shapes
    can be had as well, as letter:X or text:WORD. Exit status: 0, or 2 for one that cannot be an object.
    Try `oimppi scene import bracket.stl --scale mm --mass 0.4`.
    """

    source: Annotated[Positional[str], arg(metavar="MESH")]
    """STL, OBJ, GLB, PLY or OFF file, or any other object that `oimppi scene new --help` lists."""

    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: that of the file)")] = None
    """Name of the object: DIR/objects/NAME.usda is written."""

    def execute(self) -> int:
        """Write it; returns the exit status."""
        from dataclasses import replace

        from oimppi_warp.authoring.meshes.solid import MeshObject, plain_name
        from oimppi_warp.authoring.object_spec import check_used, parse_object
        from oimppi_warp.authoring.objects.stored import read_body
        from oimppi_warp.authoring.project import write_object

        check_used(self.shape_options(), (self.source,))
        with _working("making the object"):
            obj = parse_object(self.source, self.shape_options())
        if self.name is not None:
            obj = replace(obj, name=plain_name(self.name))  # pyright: ignore[reportArgumentType]
        file = write_object(obj, self.out, force=self.force, picture=True)
        print(f"wrote {file}")
        print(f"wrote {file.with_suffix('.png')}")
        print(_summary(obj.doc, read_body(file)))
        for note in obj.notes if isinstance(obj, MeshObject) else ():
            print(f"  {note}")
        out = [] if self.out == Path(".") else ["--out", str(self.out)]
        print("next:")
        print("  " + shlex.join(["oimppi", "scene", "new", f"push_{obj.name}", "--object", obj.name, *out]))
        return 0


def _working(on: str) -> AbstractContextManager[object]:
    """Says on a terminal that something is being done."""
    from rich.console import Console

    return Console(stderr=True).status(on)


def _summary(doc: str, body: PushedObject) -> str:
    """A line about an object."""
    pieces = len(body.colliders)
    of = "one convex piece" if pieces == 1 else f"{pieces} convex pieces"
    return f"{doc}: {body.mass:g} kg, friction {body.friction:g}, {of}"


def _with_article(doc: str) -> str:
    """What an object is, as it stands in the middle of a sentence."""
    short = doc.partition(":")[0].partition(", ")[0]
    return f"{short[0].lower()}{short[1:]}" if short.startswith(("A ", "The ")) else f"the {short}"
