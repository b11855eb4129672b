"""Files of objects with random damage (meshes, MJCF, USD), and a process that imports them one after the other.

    PYTHONPATH=tests python -m support.object_fuzzing SEED FIRST COUNT FOLDER

It prints a line after each file. A file that takes longer than :data:`LIMIT` ends the process, as a crash would.
"""

from __future__ import annotations

import faulthandler
import random
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

from support.fuzzing import MARK, MOST, NUMBERS, TOKEN, Outcome

LIMIT = 60.0
"""Time that one file may take [s]."""

ENDINGS = ("obj", "ply", "stl", "glb", "off", "xml", "usda")


@cache
def base(ending: str) -> bytes:
    """A sound file with this ending."""
    from support.meshes import bracket

    if ending == "xml":
        return b"""<mujoco model="thing">
  <compiler angle="degree"/>
  <default><geom density="500" friction="0.3 0.005 0.0001"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="thing" pos="0 0 0.5" euler="0 0 30">
      <freejoint/>
      <inertial pos="0 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
      <geom type="box" size="0.05 0.02 0.02"/>
      <geom type="capsule" size="0.01 0.03" pos="0.03 0.03 0" euler="90 0 0"/>
      <geom type="ellipsoid" size="0.03 0.02 0.02" pos="-0.04 0.03 0" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""
    if ending == "usda":
        return b"""#usda 1.0
(
    defaultPrim = "Thing"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "Thing" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
)
{
    float physics:density = 700
    def Cube "Left" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"]
    )
    {
        double size = 0.06
        float physics:mass = 0.1
    }
    def Cylinder "Right" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]
    )
    {
        double radius = 0.02
        double height = 0.06
        rel material:binding:physics = </Thing/Wood>
        double3 xformOp:translate = (0.05, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Material "Wood" (
        prepend apiSchemas = ["PhysicsMaterialAPI"]
    )
    {
        float physics:dynamicFriction = 0.4
        float physics:density = 500
    }
}
"""
    options = {"ply": {"encoding": "ascii"}, "stl": {}, "obj": {}, "off": {}, "glb": {}}[ending]
    kind = "stl_ascii" if ending == "stl" else ending
    made = bracket().export(file_type=kind, **options)
    return made if isinstance(made, bytes) else made.encode()


def damaged(seed: int, number: int) -> tuple[str, bytes]:
    """The ending and the content of a file with one to four pieces of damage, the same for the same numbers."""
    chance = random.Random(f"objects {seed} {number}")
    ending = ENDINGS[number % len(ENDINGS)]
    raw = base(ending)
    for _ in range(chance.randint(1, 2)):
        raw = _bytes(raw, chance) if ending == "glb" or chance.random() < 0.05 else _text(raw, chance)
    return ending, raw


def _text(raw: bytes, chance: random.Random) -> bytes:
    """Another number in the place of one, or a word or a line taken out or repeated."""
    text = raw.decode(errors="replace")
    tokens, lines = TOKEN.findall(text), text.splitlines(keepends=True)
    numbers = [i for i, token in enumerate(tokens) if re.fullmatch(r"-?\d[\d.eE+-]*|inf|nan", token)]
    (damage,) = chance.choices(("number", "gone", "repeated", "word"), (6, 2, 2, 1))
    here, there = (chance.randrange(len(lines)) for _ in range(2))
    if damage == "number" and numbers:
        tokens[chance.choice(numbers)] = chance.choice((*NUMBERS, *(tokens[i] for i in numbers[:12])))
        return "".join(tokens).encode()
    if damage == "word":
        del tokens[chance.randrange(len(tokens))]
        return "".join(tokens).encode()
    if damage == "gone":
        del lines[here]
    else:
        lines.insert(there, lines[here])
    return "".join(lines).encode()


def _bytes(raw: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(raw))
    match chance.randrange(3):
        case 0:
            return raw[:at] + bytes(chance.randrange(256) for _ in range(3)) + raw[at:]
        case 1:
            return raw[:at] + raw[at + chance.randint(1, 4) :]
        case _:
            return raw[:at] + bytes([raw[at] ^ (1 << chance.randrange(8))]) + raw[at + 1 :]


def outcomes(seed: int, count: int, folder: Path) -> list[Outcome]:
    """Imports damaged files in a process of its own, which is started again after each that it does not survive."""
    found: list[Outcome] = []
    while len(found) < count and sum(not outcome.is_sound for outcome in found) < MOST:
        command = [sys.executable, "-m", __name__, *map(str, (seed, len(found), count - len(found), folder))]
        ended = subprocess.run(
            command, cwd=Path(__file__).parents[1], capture_output=True, text=True, errors="replace", check=False
        )
        lines = [line.split(" ", 2) for line in ended.stdout.splitlines() if line.startswith(f"{MARK} ")]
        found += [Outcome(int(number), words) for _, number, words in lines]
        if len(found) < count:
            found.append(Outcome(len(found), f"exit status {ended.returncode}: {ended.stderr[-2000:]}"))
    return found


def imported(file: Path, folder: Path) -> str:
    """What comes of a file, in a word: it is written as an object and read again, or refused with a reason."""
    from oimppi_warp.authoring import write_object
    from oimppi_warp.authoring.object_spec import parse_object
    from oimppi_warp.errors import OimppiError

    try:
        write_object(parse_object(str(file)), folder, force=True)
    except OimppiError as error:
        assert "allowed:" in str(error), str(error)
        return "refused"
    return "scene"


def main() -> None:
    """Imports files and says what came of each."""
    import traceback

    seed, first, count = map(int, sys.argv[1:4])
    folder = Path(sys.argv[4])
    for number in range(first, first + count):
        ending, content = damaged(seed, number)
        file = folder / f"damaged{number}.{ending}"
        file.write_bytes(content)
        faulthandler.dump_traceback_later(LIMIT, exit=True)
        try:
            words = imported(file, folder)
        except Exception as error:
            ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "oimppi_warp" in frame.filename]
            place = f"{ours[-1].filename}:{ours[-1].lineno}" if ours else "no code of ours"
            words = f"{type(error).__name__} ({ending}) at {place}: {str(error)[:200]}".replace("\n", " ")
        faulthandler.cancel_dump_traceback_later()
        file.unlink()
        print(f"\n{MARK}", number, words, flush=True)


if __name__ == "__main__":
    main()
