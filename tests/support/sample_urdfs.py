"""URDFs for tests: an arm of six joints about all kinds of axes, with fixed parts, meshes and a gripper."""

from __future__ import annotations

from pathlib import Path

import trimesh

INERTIAL = '<inertial><origin xyz="{center}"/><mass value="{mass}"/>{inertia}</inertial>'
INERTIA = '<inertia ixx="0.010" iyy="0.012" izz="0.006" ixy="0.001" ixz="-0.0005" iyz="0.0004"/>'
LIMIT = '<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="2.2"/>'


def link(name: str, *, mass: float = 1.5, center: str = "0 0 0.1", shapes: str = "", inertia: str = INERTIA) -> str:
    """A link; without a mass it has no inertial."""
    inertial = INERTIAL.format(mass=mass, center=center, inertia=inertia) if mass else ""
    return f'<link name="{name}">{inertial}{shapes}</link>'


def shape(geometry: str, origin: str = "") -> str:
    """A collision shape, and a look that is not there."""
    missing = '<visual><geometry><mesh filename="package://nowhere/look.dae"/></geometry></visual>'
    return f"{missing}<collision>{origin}<geometry>{geometry}</geometry></collision>"


def joint(
    name: str, parent: str, child: str, *, kind: str = "revolute", xyz: str = "0 0 0", rpy: str = "0 0 0",
    axis: str = "0 0 1", lower: float = -3.0, upper: float = 3.0, effort: float = 60.0, more: str = "",
) -> str:  # fmt: skip
    """A joint; a fixed one has no limits."""
    limit = "" if kind == "fixed" else LIMIT.format(lower=lower, upper=upper, effort=effort)
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return (
        f'<joint name="{name}" type="{kind}">{ends}<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        f"{limit}{more}</joint>"
    )


def arm_parts() -> dict[str, str]:
    """Links and joints of the arm by their names, to be changed one by one."""
    tube = shape('<cylinder radius="0.05" length="0.25"/>', '<origin xyz="0 0 0.14"/>')
    links = {
        "world": '<link name="world"/>',
        "base": link("base", mass=4.0, shapes=shape('<cylinder radius="0.08" length="0.1"/>')),
        "shoulder": link("shoulder", shapes=shape('<sphere radius="0.07"/>')),
        "upper": link("upper", shapes=tube),
        "fore": link("fore", shapes=shape('<mesh filename="meshes/fore.stl" scale="0.001 0.001 0.001"/>')),
        "cover": link("cover", mass=0.3, shapes=shape('<box size="0.06 0.08 0.1"/>')),
        "roll": link(
            "roll", mass=0.8, center="0 0.01 0.02", shapes=shape('<mesh filename="package://made/elbow.stl"/>')
        ),
        "pitch": link("pitch", mass=0.6, center="0.01 0 0"),
        "turn": link("turn", mass=0.3, center="0 0 0.02", shapes=shape('<cylinder radius="0.03" length="0.02"/>')),
        "tool0": '<link name="tool0"/>',
    }
    joints = {
        "mount": joint("mount", "world", "base", kind="fixed"),
        "j1": joint("j1", "base", "shoulder", xyz="0 0 0.18", rpy="0 0 0.3"),
        "j2": joint("j2", "shoulder", "upper", xyz="0 0.05 0.1", axis="0 1 0", lower=-2.2, upper=2.2),
        "j3": joint("j3", "upper", "fore", xyz="0 -0.02 0.36", rpy="0 0 0", axis="0 -1 0", lower=-2.7, upper=2.7),
        "cap": joint("cap", "fore", "cover", kind="fixed", xyz="0.02 0 0.1", rpy="0.2 0.1 0.4"),
        "j4": joint("j4", "cover", "roll", xyz="-0.02 0 0.1", axis="0 0 -1", kind="continuous"),
        "j5": joint("j5", "roll", "pitch", xyz="0 0 0.12", rpy="0.5 0 0", axis="1 0 0", lower=-2.4, upper=2.4),
        "j6": joint("j6", "pitch", "turn", xyz="0 0 0.07", axis="0 0 1", effort=15.0),
        "end": joint("end", "turn", "tool0", kind="fixed", xyz="0 0 0.03", rpy="0 -1.5707963267948966 0"),
    }
    return links | joints


def write_urdf(folder: Path, parts: dict[str, str], name: str = "made") -> Path:
    """Write a URDF of these parts and its meshes, a straight one and one that is bent; returns its file."""
    (folder / "meshes").mkdir(exist_ok=True)
    trimesh.creation.capsule(height=180.0, radius=45.0).export(folder / "meshes" / "fore.stl")
    (folder / "made").mkdir(exist_ok=True)
    bent = [trimesh.creation.box((0.05, 0.05, 0.12)), trimesh.creation.box((0.05, 0.14, 0.05))]
    bent[1].apply_translation((0.0, 0.06, 0.05))
    trimesh.util.concatenate(bent).export(folder / "made" / "elbow.stl")
    file = folder / f"{name}.urdf"
    file.write_text(f'<robot name="{name}">{"".join(parts.values())}</robot>')
    return file


def ur_parts() -> dict[str, str]:
    """An arm with the joints of a UR5 (lengths from its data sheet), its shapes made up."""
    half = "1.5707963267948966"

    def tube(length: float, radius: float, axis: str = "z") -> str:
        rpy = {"z": "0 0 0", "y": f"{half} 0 0"}[axis]
        middle = {"z": f"0 0 {length / 2}", "y": f"0 {length / 2} 0"}[axis]
        return shape(f'<cylinder radius="{radius}" length="{length}"/>', f'<origin xyz="{middle}" rpy="{rpy}"/>')

    links = {
        "base": link("base", mass=4.0, shapes=shape('<cylinder radius="0.075" length="0.04"/>')),
        "shoulder": link("shoulder", mass=3.7, shapes=tube(0.1, 0.06, "y")),
        "upper": link("upper", mass=8.4, shapes=tube(0.425, 0.055)),
        "fore": link("fore", mass=2.3, shapes=tube(0.392, 0.05)),
        "wrist1": link("wrist1", mass=1.2, shapes=tube(0.08, 0.04, "y")),
        "wrist2": link("wrist2", mass=1.2, shapes=tube(0.08, 0.04)),
        "wrist3": link("wrist3", mass=0.2, shapes=tube(0.05, 0.035, "y")),
        "tool0": '<link name="tool0"/>',
    }
    turn = {"lower": -6.28, "upper": 6.28}
    joints = {
        "j1": joint("j1", "base", "shoulder", xyz="0 0 0.0892", **turn),
        "j2": joint("j2", "shoulder", "upper", xyz="0 0.1358 0", rpy=f"0 {half} 0", axis="0 1 0", **turn),
        "j3": joint("j3", "upper", "fore", xyz="0 -0.1197 0.425", axis="0 1 0", lower=-3.14, upper=3.14),
        "j4": joint("j4", "fore", "wrist1", xyz="0 0 0.3922", rpy=f"0 {half} 0", axis="0 1 0", **turn),
        "j5": joint("j5", "wrist1", "wrist2", xyz="0 0.093 0", **turn),
        "j6": joint("j6", "wrist2", "wrist3", xyz="0 0 0.0946", axis="0 1 0", **turn),
        "end": joint("end", "wrist3", "tool0", kind="fixed", xyz="0 0.0823 0", rpy=f"-{half} 0 0"),
    }
    return links | joints


def panda_parts() -> dict[str, str]:
    """An arm with the seven joints of a Panda (lengths and limits from its data sheet), its shapes made up."""
    half = "1.5707963267948966"
    round_about = {"lower": -2.8973, "upper": 2.8973}

    def ball(radius: float, at: str = "0 0 0") -> str:
        return shape(f'<sphere radius="{radius}"/>', f'<origin xyz="{at}"/>')

    links = {
        "link0": link("link0", mass=3.0, shapes=shape('<cylinder radius="0.09" length="0.1"/>')),
        "link1": link("link1", mass=3.0, shapes=ball(0.07, "0 0 -0.1")),
        "link2": link("link2", mass=3.0, shapes=ball(0.07, "0 -0.1 0")),
        "link3": link("link3", mass=3.0, shapes=ball(0.06, "0 0 -0.1") + ball(0.06, "0.06 0 0")),
        "link4": link("link4", mass=3.0, shapes=ball(0.06, "-0.06 0.1 0")),
        "link5": link("link5", mass=3.0, shapes=ball(0.055, "0 0 -0.25") + ball(0.05, "0 0.05 -0.1")),
        "link6": link("link6", mass=1.5, shapes=ball(0.05, "0.05 0 0")),
        "link7": link(
            "link7", mass=0.7, shapes=shape('<cylinder radius="0.045" length="0.06"/>', '<origin xyz="0 0 0.06"/>')
        ),
        "flange": '<link name="flange"/>',
    }
    joints = {
        "j1": joint("j1", "link0", "link1", xyz="0 0 0.333", **round_about),
        "j2": joint("j2", "link1", "link2", rpy=f"-{half} 0 0", lower=-1.7628, upper=1.7628),
        "j3": joint("j3", "link2", "link3", xyz="0 -0.316 0", rpy=f"{half} 0 0", **round_about),
        "j4": joint("j4", "link3", "link4", xyz="0.0825 0 0", rpy=f"{half} 0 0", lower=-3.0718, upper=-0.0698),
        "j5": joint("j5", "link4", "link5", xyz="-0.0825 0.384 0", rpy=f"-{half} 0 0", **round_about),
        "j6": joint("j6", "link5", "link6", rpy=f"{half} 0 0", lower=-0.0175, upper=3.7525),
        "j7": joint("j7", "link6", "link7", xyz="0.088 0 0", rpy=f"{half} 0 0", **round_about),
        "end": joint("end", "link7", "flange", kind="fixed", xyz="0 0 0.107"),
    }
    return links | joints
