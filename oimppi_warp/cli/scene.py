"""The commands ``oimppi scene new``, ``oimppi scene import`` and ``oimppi scenes``."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from oimppi_warp.authoring import named_shapes
from oimppi_warp.cli.printing import print_rows

if TYPE_CHECKING:
    from oimppi_warp.authoring.object_spec import ShapeOptions
    from oimppi_warp.authoring.objects.flat_object import Pushable
    from oimppi_warp.scene import PushedObject

_Unit = Literal["mm", "cm", "m", "inch"]
_Lay = Literal["stable", "flat", "as-is"]


def _taken_by(option: str, default: str) -> Callable[[str], str]:
    """Returns the hint of an option that only some shapes take, as a function that tyro calls when it shows help.

    Args:
        option: Name of the option.
        default: Description of its default.
    """
    return lambda _: f"(with {', '.join(named_shapes.shapes_taking(option, lambda name, _: name))}; default: {default})"


def _object_hint(default: str) -> str:
    """Returns the hint of an option that takes an object: the specs of all shapes, and the default."""
    return f"({named_shapes.objects()}; default: {default})"


@dataclass(frozen=True, kw_only=True)
class ObjectOptions:
    """Options for making an object."""

    mass: Annotated[
        float | None,
        arg(metavar="KG", help_behavior_hint="(default: that of wood of the same volume, or a stored object's own)"),
    ] = None
    """Mass of the object [kg]."""

    friction: Annotated[
        float | None, arg(metavar="MU", help_behavior_hint="(default: 0.4, or a stored object's own)")
    ] = None
    """Coulomb friction coefficient between object and table."""

    height: Annotated[float | None, arg(metavar="M", help_behavior_hint=_taken_by("height", "0.05"))] = None
    """Thickness of the object, from the table to its top [m]."""

    size: Annotated[
        float | None, arg(metavar="M", help_behavior_hint=_taken_by("size", "0.103, less for long words"))
    ] = None
    """Height of the letters, measured along the table [m]."""

    font: Annotated[
        str | None, arg(metavar="FONT", help_behavior_hint=_taken_by("font", "a built-in alphabet, A to Z"))
    ] = None
    """Name of an installed font, or a font file, for the letters."""

    scale: Annotated[_Unit | None, arg(metavar="{mm,cm,m,inch}", help_behavior_hint=_taken_by("scale", "m"))] = None
    """Length unit of the mesh, which STL and OBJ files do not specify."""

    lay: Annotated[_Lay, arg(help_behavior_hint=_taken_by("lay", "stable"))] = "stable"
    """Pose of the mesh on the table: its most stable pose (stable), its most stable one on a flat side, in which it
    does not roll (flat), or as modelled, with its z axis up (as-is)."""

    wall: Annotated[float | None, arg(metavar="M", help_behavior_hint=_taken_by("wall", "holes are closed"))] = None
    """Thickness of the wall to give to an open mesh, a shell without thickness [m]."""

    out: Annotated[Path, arg(metavar="DIR")] = Path(".")
    """Folder to write to; objects go to DIR/objects."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite existing files."""

    def shape_options(self) -> ShapeOptions:
        """Returns the options with which shapes are made."""
        from oimppi_warp.authoring.object_spec import ShapeOptions

        return ShapeOptions(
            mass=self.mass,
            friction=self.friction,
            height=self.height,
            size=self.size,
            font=self.font,
            scale=self.scale,
            lay=self.lay,
            wall=self.wall,
        )


@dataclass(frozen=True, kw_only=True)
class New(ObjectOptions):
    """Write a new task: a scene with an object to push, its start and goal, and obstacles.

    The task is written only if nothing overlaps and the arm can reach the start and the goal. Comments in the file
    explain each attribute, for editing by hand. Exit status: 0, or 2 for an infeasible task or bad input.

    For example:

    oimppi scene new push_s --object letter:S --goal 0.5,0.2,1.57 --obstacle box:0.1x0.1x0.1@0.5,-0.1
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of the task; DIR/NAME.usda is written."""

    out: Annotated[Path, arg(metavar="DIR")] = Path(".")
    """Folder to write to; objects go to DIR/objects, the robot to DIR/robots."""

    object: Annotated[str, arg(metavar="OBJECT", help_behavior_hint=_object_hint)] = "t-block"
    """Object to push: the name of an object in DIR/objects (DIR is that of --out), or one of the following specs."""

    start: Annotated[str, arg(metavar="X,Y,YAW")] = "0.3,-0.45,0"
    """Start pose of the object relative to the centre of the arm's base, in metres and radians."""

    goal: Annotated[str, arg(metavar="X,Y,YAW")] = "0.5,0.3,3.14159"
    """Goal pose of the object, in the form of --start."""

    obstacle: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="OBJECT@X,Y[,YAW]", help_behavior_hint="(repeatable)")
    ] = ()
    """Obstacle: any OBJECT, fixed at a pose, such as box:0.1x0.1x0.1@0.5,0.05 or letter:O@0.5,0.3,-1.57."""

    title: Annotated[
        str | None, arg(metavar="TEXT", help_behavior_hint="(default: made from the object's description)")
    ] = None
    """One-line description of the task."""

    robot: Annotated[str, arg(metavar="ROBOT")] = "xarm6"
    """Robot: the name of a shipped robot or of a robot in DIR/robots, or the USD file of a robot."""

    def execute(self) -> int:
        """Writes the task and returns the exit status."""
        from oimppi_warp.authoring.object_spec import check_used, checked_pose, parse_object, parse_obstacles
        from oimppi_warp.authoring.project import write_task
        from oimppi_warp.authoring.task import PAPER, Task
        from oimppi_warp.geometry.tipping import can_tip, tipping_height

        start, goal = checked_pose("--start", self.start), checked_pose("--goal", self.goal)
        options = self.shape_options()
        check_used(options, (self.object, *self.obstacle))
        with _working():
            obj = parse_object(self.object, options, folder=self.out)
            obstacles = parse_obstacles(self.obstacle, options, folder=self.out)
        task = Task(
            name=self.name.removesuffix(".usda"),
            title=self.title or f"Push {_with_article(obj.doc)} to its goal",
            object=obj,
            start=start,
            goal=goal,
            obstacles=obstacles,
            tolerance=PAPER if obj.yaw_matters else (PAPER[0], math.inf),
            tight=(0.05, 0.1 if obj.yaw_matters else math.inf),
            robot=self.robot,
        )
        written = write_task(task, self.out, force=self.force)
        for file in written.files:
            print(f"wrote {file}")
        body = written.scene.object
        print(_summary(obj, body))
        for note in getattr(obj, "notes", ()):
            if note.startswith("warning"):
                print(note)
        _warn_of_rolling(body)
        if can_tip(body):
            print(
                f"a push higher than {1000 * tipping_height(body):.0f} mm above the table tips the object over, so "
                "the planner pushes low and slowly"
            )
        print("checked: nothing overlaps, the arm reaches start and goal")
        print("next:")
        for command, start in (("scene check", ""), ("view", " --start 0"), ("run", " --start 0")):
            print(f"  oimppi {command} {shlex.quote(str(written.file))}{start}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Import(ObjectOptions):
    """Convert a mesh to an object: close it, lay it on the table, split it into convex pieces, and render a picture.

    The deviation of the pieces from the mesh is reported, with a warning if it is large, and a mesh that cannot be
    pushed is rejected with the reason. The rigid body in an MJCF file is converted as well, and so are other shapes,
    such as letter:X or text:WORD. Exit status: 0, or 2 for an unusable file or bad input.

    For example:

    oimppi scene import bracket.stl --scale mm --mass 0.4
    """

    source: Annotated[Positional[str], arg(metavar="MESH")]
    """STL, OBJ, GLB, PLY or OFF file, MJCF file, or any other object listed by `oimppi scene new --help`."""

    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: the file's name)")] = None
    """Name of the object; DIR/objects/NAME.usda is written."""

    def execute(self) -> int:
        """Writes the object and its picture and returns the exit status."""
        from dataclasses import replace

        from oimppi_warp.authoring.meshes.solid import MeshObject, plain_name
        from oimppi_warp.authoring.object_spec import check_used, parse_object
        from oimppi_warp.authoring.objects.stored import read_body
        from oimppi_warp.authoring.project import write_object

        check_used(self.shape_options(), (self.source,))
        with _working():
            obj = parse_object(self.source, self.shape_options())
        if self.name is not None:
            obj = replace(obj, name=plain_name(self.name))  # pyright: ignore[reportArgumentType]
        file = write_object(obj, self.out, force=self.force, picture=True)
        print(f"wrote {file}")
        print(f"wrote {file.with_suffix('.png')}")
        body = read_body(file)
        print(_summary(obj, body))
        for note in obj.notes if isinstance(obj, MeshObject) else ():
            print(f"  {note}")
        _warn_of_rolling(body)
        out = [] if self.out == Path(".") else ["--out", str(self.out)]
        print("next:")
        print("  " + shlex.join(["oimppi", "scene", "new", f"push_{obj.name}", "--object", obj.name, *out]))
        return 0


def _warn_of_rolling(body: PushedObject) -> None:
    """Prints a warning about an object that rolls instead of sliding."""
    from oimppi_warp.geometry.rolling import IN_WORDS, REMEDY, rolling

    if rolls := rolling(body):
        print(f"warning: {IN_WORDS[rolls]}, while the planner predicts sliding only\n  to do:   {REMEDY}")


@dataclass(frozen=True)
class Scenes:
    """List the shipped scenes, one per line."""

    def execute(self) -> int:
        """Prints the scenes and returns the exit status."""
        from oimppi_warp.usd import shipped_scenes

        print_rows({scene.name: scene.title for scene in shipped_scenes()}, name_style="bold")
        return 0


@contextmanager
def _working() -> Iterator[None]:
    """Returns a context in which a progress bar is shown while an object is made, if stderr is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from oimppi_warp.authoring.meshes.progress import listening

    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("making the object", total=1.0)
        with listening(lambda doing, share: bar.update(task, description=doing, completed=share)):
            yield


def _summary(obj: Pushable, body: PushedObject) -> str:
    """Returns one line with an object's description, mass, friction coefficient and number of convex pieces."""
    pieces = len(body.colliders)
    of = "one convex piece" if pieces == 1 else f"{pieces} convex pieces"
    whose = " (the table's)" if obj.friction is None else ""
    return f"{obj.doc}: {body.mass:g} kg, friction {body.friction:g}{whose}, {of}"


def _with_article(doc: str) -> str:
    """Returns an object's short description with an article, for use within a sentence."""
    short = doc.partition(":")[0].partition(", ")[0]
    return f"{short[0].lower()}{short[1:]}" if short.startswith(("A ", "The ")) else f"the {short}"
