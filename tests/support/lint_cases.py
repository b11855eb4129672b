"""Scenes that are allowed but hardly meant, each with the prim, the beginning of the warning and what more it says."""

from __future__ import annotations

from pxr import Gf, Sdf, Usd
from support.bad_scenes import add, prim, put

ROBOT, OBJECT, CUBE = "/World/Robot", "/World/Object", "/World/Obstacles/Cube"


def several(*changes):
    """All changes, one after the other."""

    def change(stage: Usd.Stage) -> None:
        for each in changes:
            each(stage)

    return change


def author(path: str, name: str, kind: Sdf.ValueTypeName, value: object):
    """Give a prim an attribute that it does not have."""
    return lambda stage: prim(stage, path).CreateAttribute(name, kind, custom=True).Set(value)


def texture(path: str):
    return author("/World/Table", "inputs:file", Sdf.ValueTypeNames.Asset, Sdf.AssetPath(path))


def timed(stage: Usd.Stage) -> None:
    prim(stage, "/World/Obstacles/Cube").GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.5, 0.05, 0.05), 1.0)


double, double2 = Sdf.ValueTypeNames.Double, Sdf.ValueTypeNames.Double2
LINT_CASES = {
    "a misspelt attribute": (
        author("/World", "oimppi:tolerence", double2, Gf.Vec2d(0.1)),
        ("/World", "the attribute oimppi:tolerence is unknown", "did you mean oimppi:tolerance?"),
    ),
    "a misspelt namespace": (
        author("/World", "oimpi:goal", double2, Gf.Vec2d(0.1)),
        ("/World", "the attribute oimpi:goal is unknown", "did you mean oimppi:goal?"),
    ),
    "an attribute in the wrong place": (
        author(OBJECT, "oimppi:goal", double2, Gf.Vec2d(0.1)),
        (OBJECT, "oimppi:goal has no effect on this prim", "on a prim with OimppiTaskAPI"),
    ),
    "a misspelt schema": (
        add("/World/Table", "OimppiObstackleAPI"),
        ("/World/Table", "the API schema OimppiObstackleAPI is unknown", "did you mean OimppiObstacleAPI?"),
    ),
    "a prim that moves in time": (
        timed,
        (CUBE, "time samples are ignored: xformOp:translate", "default value"),
    ),
    "a texture that is not there": (
        texture("./wood.png"),
        ("/World/Table", "inputs:file refers to a missing file: ./wood.png", "relative to the file"),
    ),
    "a texture from elsewhere": (
        texture(__file__),
        ("/World/Table", f"a file outside the scene's folder is used: {__file__}", "copy it there"),
    ),
    "an inertia that no body has": (
        put(f"{ROBOT}/link3", "physics:diagonalInertia", Gf.Vec3f(0.001, 0.001, 0.01)),
        (
            f"{ROBOT}/link3",
            "physics:diagonalInertia is (0.001, 0.001, 0.01), which is physically impossible",
            "leave it out",
        ),
    ),
    "the moon's gravity": (
        put("/World/PhysicsScene", "physics:gravityMagnitude", 1.62),
        ("/World/PhysicsScene", "gravity is 1.62 m/s^2 along (0, 0, -1)", "9.81 m/s^2 downwards"),
    ),
    "gravity to the side": (
        put("/World/PhysicsScene", "physics:gravityDirection", Gf.Vec3f(0, -1, 0)),
        ("/World/PhysicsScene", "gravity is 9.81 m/s^2 along (0, -1, 0)", "leave out physics:gravityDirection"),
    ),
    "an object of feathers": (
        several(put(OBJECT, "physics:mass", 0.001), put(OBJECT, "physics:diagonalInertia", Gf.Vec3f(0.0))),
        (OBJECT, "a mass of 0.001 kg in a volume of 0.75 litres is 1.33 kg/m^3", "10 (foam) to 20000 (gold)"),
    ),
    "an object heavier than gold": (
        several(put(OBJECT, "physics:mass", 50.0), put(OBJECT, "physics:diagonalInertia", Gf.Vec3f(0.0))),
        (OBJECT, "a mass of 50 kg in a volume of 0.75 litres is 6.67e+04 kg/m^3", "correct physics:mass"),
    ),
    "an inertia of another object": (
        put(OBJECT, "physics:diagonalInertia", Gf.Vec3f(0.09, 0.12, 0.19)),
        (OBJECT, "physics:diagonalInertia is 96", "0.25 to 4 times"),
    ),
    "a centre of mass beside the object": (
        put(OBJECT, "physics:centerOfMass", Gf.Vec3f(0.2, 0.0, 0.0)),
        (OBJECT, "physics:centerOfMass (0.2, 0, 0) is outside the object", "leave it out"),
    ),
}
