"""An edited scene is the task for all: planner, plant, engines, viewer and caches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import newton
import numpy as np
import pytest
from support import small_tasks
from support.drawn import Drawn
from support.engines import make, roll

from oimppi_warp.compute.cache import content_of_data
from oimppi_warp.config.lab import LabConfig
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.geometry.footprint import limit_surface
from oimppi_warp.observation import planar_transform
from oimppi_warp.physics import mujoco_model as module
from oimppi_warp.physics.newton_model import ROLES, build_model
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.newton import NewtonDynamics
from oimppi_warp.planning.engines.newton_threads import NewtonThreads
from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds
from oimppi_warp.plants.lab import LabPlant
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.scene import Obstacle, Scene
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.editing import save_scene
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.posed_scene import PosedScene
from oimppi_warp.view.shapes import Shape, visible_shapes

G = 9.81
"""[m/s^2]"""

CUBE = "/World/Obstacles/Cube"
"""The obstacle of task 02: a cube of 0.1 m at (0.5, 0.05)."""


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """An empty cache of one's own."""
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def compiled(cache, monkeypatch):
    """How many different models were compiled and kept so far; to be quick, always the same is kept."""
    made = World(small_tasks.shipped("point01")).mujoco
    monkeypatch.setattr(module, "build_model", lambda scene: None)
    monkeypatch.setattr(module, "_translate", lambda built, sensing: made)
    return lambda: len(list(cache.glob("mujoco-*.npz"))) - 1


@pytest.fixture
def scene() -> Scene:
    return small_tasks.shipped("task02")


def heavier(scene: Scene, mass: float) -> Scene:
    return replace(scene, object=replace(scene.object, mass=mass))


def roles_of(world: World) -> list[str]:
    return [ROLES[role] for role in world.mujoco.roles]


def force_on_table(plant: SimulatedPlant, world: World) -> float:
    """Normal force between object and table, once all is at rest [N]."""
    for _ in range(10):
        plant.apply(np.zeros(world.scene.robot.dof))
    contact, pair = plant.data.contact, {ROLES.index("object"), ROLES.index("table")}
    active = contact.efc_address >= 0
    between = [set(each) == pair for each in world.mujoco.roles[contact.geom[active]].tolist()]
    return float(plant.data.efc_force[contact.efc_address[active]][between].sum())


def slid(scene: Scene, speed: float) -> float:
    """How far the object slides on the table when it is knocked along x at a speed [m/s]; [m]."""
    world = World(scene)
    plant = SimulatedPlant(world)
    plant.knock(scene.object.mass * np.array([speed, 0.0, 0.0]))
    before = plant.observe().object_pose
    for _ in range(30):
        plant.apply(np.zeros(scene.robot.dof))
    return float(plant.observe().object_pose[0] - before[0])


# The defect


def test_the_plant_has_the_mass_and_the_obstacles_that_the_planner_has(device: str):
    """A T of 5 kg and no obstacles, made of task 03, whose file has one of 0.5 kg and two cubes."""
    scene = small_tasks.shipped("task03")
    assert (scene.object.mass, len(scene.obstacles)) == (0.5, 2)
    edited = replace(scene, object=replace(scene.object, mass=5.0), obstacles=())
    world = World(edited)
    assert limit_surface(edited.object).force == pytest.approx(10.0 * limit_surface(scene.object).force)
    assert force_on_table(SimulatedPlant(world), world) == pytest.approx(5.0 * G, rel=1e-3)
    assert "obstacle" not in roles_of(world)
    on_the_cube = np.array([*scene.obstacles[0].center[:2], 0.0])
    assert build_geometry(scene, device).clearance_at(on_the_cube) <= 0.0
    assert build_geometry(edited, device).clearance_at(on_the_cube) > 0.05

    again = World(load_scene("task03"))
    assert roles_of(again).count("obstacle") == 2
    assert force_on_table(SimulatedPlant(again), again) == pytest.approx(0.5 * G, rel=1e-3)


# The object


@pytest.mark.parametrize("mass", [0.1, 0.5, 5.0])
def test_the_object_presses_on_the_table_with_its_weight(scene, mass):
    world = World(heavier(scene, mass))
    assert force_on_table(SimulatedPlant(world), world) == pytest.approx(mass * G, rel=1e-3)


def test_inertia_grows_with_the_mass(scene):
    light, heavy = (World(each).mujoco for each in (scene, heavier(scene, 10.0 * scene.object.mass)))
    inertia = [mapped.model.body_inertia[mapped.object_body] for mapped in (light, heavy)]
    np.testing.assert_allclose(inertia[1], 10.0 * inertia[0], rtol=1e-5)


def test_a_knocked_object_slides_as_far_as_its_friction_lets_it(scene):
    """Knocked by a force m v / T that lasts for a period T: v^2 / (2 mu g) - v T / 2."""
    for friction, speed in ((0.4, 0.6), (0.2, 0.6), (0.1, 1.0)):
        edited = replace(scene, object=replace(scene.object, friction=friction))
        wanted = speed**2 / (2.0 * friction * G) - speed * 0.05 / 2.0
        assert slid(edited, speed) == pytest.approx(wanted, rel=0.03)


def test_the_tool_grips_with_its_own_friction(scene):
    edited = replace(scene, object=replace(scene.object, tool_friction=0.9))
    mapped = World(edited).mujoco
    tool, pushed = (mapped.model.geom_friction[mapped.roles == ROLES.index(role), 0] for role in ("tool", "object"))
    np.testing.assert_allclose(np.maximum(tool, pushed[0]), 0.9, rtol=1e-6)


def test_a_larger_object_lies_on_the_table_and_is_larger_in_every_model(scene):
    edited = replace(scene, object=scene.object.scaled(1.5))
    world = World(edited)
    plant = SimulatedPlant(world)
    assert force_on_table(plant, world) == pytest.approx(0.5 * G, rel=1e-3)
    assert plant.observe().object_transform[2] == pytest.approx(0.0375, abs=1e-3)
    sizes = [World(each).mujoco.model.geom_size for each in (scene, edited)]
    which = world.mujoco.roles == ROLES.index("object")
    np.testing.assert_allclose(sizes[1][which], 1.5 * sizes[0][which], rtol=1e-6)
    inertia = [World(each).mujoco.model.body_inertia[world.mujoco.object_body] for each in (scene, edited)]
    np.testing.assert_allclose(inertia[1], 1.5**2 * inertia[0], rtol=1e-5)


def test_an_object_made_by_hand_has_the_inertia_of_its_shape(scene):
    """A box of 0.10 x 0.06 x 0.05 m: m / 12 (b^2 + c^2) about its first axis, and so on."""
    block = small_tasks.block()
    mapped = World(replace(scene, object=block)).mujoco
    a, b, c = 0.10, 0.06, 0.05
    wanted = block.mass / 12.0 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    np.testing.assert_allclose(sorted(mapped.model.body_inertia[mapped.object_body]), sorted(wanted), rtol=1e-5)


# Obstacles


def test_an_obstacle_that_was_added_bears_the_object(scene):
    plate = small_tasks.box(0.3, -0.45, (0.3, 0.3, 0.02))
    world = World(scene.with_obstacle(Obstacle("/plate", (plate,))))
    plant = SimulatedPlant(world)
    plant.place(scene.robot.start, planar_transform(scene.start, scene.object.rest_height + 0.02))
    for _ in range(10):
        plant.apply(np.zeros(6))
    assert plant.observe().object_transform[2] == pytest.approx(scene.object.rest_height + 0.02, abs=1e-3)
    assert plant.contacts.object_obstacle == pytest.approx(scene.object.mass * G, rel=1e-2)


def test_a_removed_obstacle_is_in_no_model_and_a_later_load_has_it_again(scene):
    world = World(scene.without_obstacle(CUBE))
    assert "obstacle" not in roles_of(world)
    assert ROLES.index("obstacle") not in world.newton.roles
    assert roles_of(World(load_scene("task02"))).count("obstacle") == 1
    with pytest.raises(SceneError, match="no obstacle </World/Nothing>"):
        scene.without_obstacle("/World/Nothing")


def test_a_moved_obstacle_stops_the_object_where_it_stands_now(scene):
    """The bar of the T reaches 0.1 m along x: a cube whose near face is 20 mm further stops it after 20 mm."""
    x, y, _ = scene.start
    cube = scene.obstacle(CUBE).center
    moved = scene.with_obstacle_moved(CUBE, (x + 0.1 + 0.02 + 0.05 - cube[0], y - cube[1], 0.0))
    assert slid(scene, 0.8) > 0.055
    assert slid(moved, 0.8) == pytest.approx(0.02, abs=0.003)
    gone = scene.with_obstacle_moved(CUBE, (0.0, 0.3, 0.0))
    assert slid(gone, 0.8) == slid(scene, 0.8)


def test_an_obstacle_turns_about_the_vertical_through_its_centre(scene):
    turned = scene.with_obstacle_moved(CUBE, (0.0, 0.0, 0.3)).obstacle(CUBE)
    np.testing.assert_allclose(turned.center, scene.obstacle(CUBE).center, atol=1e-12)
    np.testing.assert_allclose(turned.colliders[0].transform[3:], [0.0, 0.0, np.sin(0.15), np.cos(0.15)], atol=1e-12)
    pair = Obstacle("/pair", (small_tasks.box(0.4, 0.0, (0.1, 0.1, 0.1)), small_tasks.box(0.6, 0.0, (0.1, 0.1, 0.1))))
    first, second = (shape.transform[:2] for shape in pair.moved((0.1, 0.0, np.pi / 2)).colliders)
    np.testing.assert_allclose([first, second], [[0.6, -0.1], [0.6, 0.1]], atol=1e-12)


def test_the_goal_and_the_start_are_no_part_of_what_is_compiled(scene, compiled):
    for each in (scene, scene.with_goal((0.3, 0.3, 0.0)), scene.with_start((0.2, -0.4, 0.1))):
        World(each).mujoco  # noqa: B018
    assert compiled() == 1


# Plants and engines


def test_the_laboratory_has_the_edited_scene_too(scene):
    edited = replace(heavier(scene, 2.0), obstacles=())
    world = World(edited)
    lab = LabPlant(world, LabConfig(), start=edited.start, control_period=0.05, seed=0)
    for _ in range(10):
        lab.apply(np.zeros(6))
    assert "obstacle" not in roles_of(world)
    assert np.linalg.norm(lab.truth().object_pose[:2] - edited.start[:2]) < 1e-3
    body_mass = world.mujoco.model.body_mass[world.mujoco.object_body]
    assert body_mass == pytest.approx(2.0)


@pytest.mark.parametrize("engine", [NewtonThreads, NewtonWorlds])
def test_a_newton_engine_presses_with_the_edited_mass_on_the_edited_obstacle(scene, engine: type[NewtonDynamics]):
    plate = small_tasks.box(scene.start[0], scene.start[1], (0.3, 0.3, 0.02))
    edited = replace(heavier(scene, 1.5), obstacles=(Obstacle("/plate", (plate,)),))
    seen = small_tasks.observe(edited)
    seen.object_transform[2] += 0.02
    dynamics = make(engine, edited, 1, steps=6)
    roll(dynamics, seen, np.zeros((1, 6, 6)))
    on_obstacle, _ = dynamics.forces.numpy()[0, -1]
    assert on_obstacle == pytest.approx(1.5 * G, rel=0.02)


def test_batched_worlds_are_built_of_the_edited_scene(scene):
    built = build_model(replace(heavier(scene, 3.0), obstacles=()), worlds=2)
    masses = built.model.body_mass.numpy().reshape(2, -1)
    assert masses[:, built.object_body] == pytest.approx([3.0, 3.0])
    assert built.model.shape_count == 2 * len(built.roles)
    assert ROLES.index("obstacle") not in built.roles


# Caches


def edits(scene: Scene) -> dict[str, Scene]:
    robot = scene.robot
    links = (*robot.links[:-1], replace(robot.links[-1], mass=robot.links[-1].mass + 0.1))
    limits = tuple(replace(joint, upper=joint.upper - 1e-9) for joint in robot.joints)
    return {
        "mass": heavier(scene, 0.5000001),
        "friction": replace(scene, object=replace(scene.object, friction=0.41)),
        "tool friction": replace(scene, object=replace(scene.object, tool_friction=0.31)),
        "centre of mass": replace(scene, object=replace(scene.object, center_of_mass=np.array([0.0, -0.02, 0.0]))),
        "inertia": replace(scene, object=replace(scene.object, unit_inertia=None)),
        "size": replace(scene, object=scene.object.scaled(1.001)),
        "obstacle moved": scene.with_obstacle_moved(CUBE, (1e-9, 0.0, 0.0)),
        "obstacle removed": scene.without_obstacle(CUBE),
        "table": replace(scene, table=replace(scene.table, thickness=0.05)),
        "gravity": replace(scene, gravity=(0.0, 0.0, -1.62)),
        "link": replace(scene, robot=replace(robot, links=links)),
        "limits": replace(scene, robot=replace(robot, joints=limits)),
    }


def test_every_edit_has_a_compiled_model_of_its_own(scene, compiled):
    known = {"": scene, **edits(scene)}
    for count, (what, each) in enumerate(known.items(), start=1):
        World(each).mujoco  # noqa: B018
        assert compiled() == count, what


def test_the_file_that_a_scene_was_read_from_is_no_part_of_what_is_compiled(scene, compiled, tmp_path):
    copy = load_scene(save_scene(scene, tmp_path / "elsewhere.usda"))
    alike = replace(scene, file=copy.file, name="elsewhere", title="")
    for each in (scene, alike):
        World(each).mujoco  # noqa: B018
    assert compiled() == 1


def test_data_has_one_content_and_other_data_another(scene):
    assert content_of_data(scene.object) == content_of_data(replace(scene.object))
    values = (1, 1.0, True, "1", None, b"1", (1,), ((1,),), (1, 1), np.array(1), np.array([1]), np.array([1.0]))
    assert len({content_of_data(value) for value in values}) == len(values)
    assert content_of_data("a", "b") != content_of_data("ab")
    with pytest.raises(TypeError, match="a PosixPath cannot be hashed"):
        content_of_data(scene)


def test_nobody_can_change_a_scene_behind_the_caches_back(scene):
    held = np.zeros(6)
    robot = replace(scene.robot, start=held)
    held[0] = 1.0
    assert robot.start[0] == 0.0
    for array in (robot.start, scene.object.center_of_mass, scene.starts, scene.robot.joints[0].parent_transform):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# The viewer


def drawn(scene: Scene, path: str) -> dict[str, np.ndarray]:
    """Transforms, shape [7], of the drawn shapes below a path, in the frame of their body, by their own path.

    Newton's viewers are given a stage of the edited scene; the page is given the shapes of the file, edited. They have
    to agree.
    """
    places = {shape.path: shape.transform for shape in visible_shapes(scene) if shape.path.startswith(path)}
    shown = PosedScene(scene).model
    others = {
        label: shown.shape_transform.numpy()[i]
        for i, label in enumerate(shown.shape_label)
        if label.startswith(path) and shown.shape_flags.numpy()[i] & newton.ShapeFlags.VISIBLE
    }
    assert len(places) == len(others)
    for place, other in zip(places.values(), others.values(), strict=True):
        sign = np.sign(place[3:] @ other[3:])
        np.testing.assert_allclose(place * [1, 1, 1, sign, sign, sign, sign], other, atol=1e-6)
    return places


def test_a_moved_obstacle_is_drawn_where_it_is_and_a_removed_one_not_at_all(scene):
    ((label, place),) = drawn(scene, CUBE).items()
    ((same, moved),) = drawn(scene.with_obstacle_moved(CUBE, (0.05, -0.1, 0.3)), CUBE).items()
    assert same == label
    np.testing.assert_allclose(moved[:3] - place[:3], (0.05, -0.1, 0.0), atol=1e-6)
    np.testing.assert_allclose(np.abs(moved[3:]), [0.0, 0.0, np.sin(0.15), np.cos(0.15)], atol=1e-6)
    assert not drawn(scene.without_obstacle(CUBE), CUBE)


def test_an_obstacle_that_was_added_is_drawn_as_its_colliders(scene):
    shapes = (small_tasks.box(0.2, 0.3, (0.1, 0.2, 0.05), yaw=0.4), small_tasks.post(0.3, 0.4, 0.02, 0.1))
    edited = scene.with_obstacle(Obstacle("/World/Obstacles/New", shapes))
    added = [shape for shape in visible_shapes(edited) if shape.path in [it.path for it in shapes]]
    assert [shape.kind for shape in added] == ["box", "cylinder"]
    for shape, known in zip(added, shapes, strict=True):
        np.testing.assert_allclose(shape.transform, known.transform, atol=1e-6)
        assert shape.size == pytest.approx(known.size)
    assert len(visible_shapes(scene)) == len(visible_shapes(edited)) - 2
    shown = PosedScene(edited).model  # what Newton's viewers are given
    new = [i for i, label in enumerate(shown.shape_label) if label.startswith("/World/Obstacles/New")]
    for i, known in zip(new, shapes, strict=True):
        np.testing.assert_allclose(shown.shape_transform.numpy()[i][:3], known.transform[:3], atol=1e-6)


def test_an_object_of_another_size_is_drawn_in_that_size_and_its_own_colour(scene):
    def drawn_object(each: Scene) -> list[Shape]:
        return [shape for shape in visible_shapes(each) if shape.body == scene.object.path]

    shown, larger = drawn_object(scene), drawn_object(replace(scene, object=scene.object.scaled(1.5)))
    assert max(shape.vertices.max() for shape in shown) == pytest.approx(0.1)
    assert max(shape.vertices.max() for shape in larger) == pytest.approx(0.15)
    assert {shape.color for shape in larger} == {shown[0].color}
    newtons = PosedScene(replace(scene, object=scene.object.scaled(1.5))).model
    found = [i for i, label in enumerate(newtons.shape_label) if label.startswith("/World/Object")]
    assert max(float(newtons.shape_scale.numpy()[i].max()) for i in found) == pytest.approx(0.15)


def test_the_canvas_loads_a_scene_anew_when_other_things_stand_in_it_but_not_for_another_goal(scene):
    display = Drawn()
    canvas = Canvas(display)
    at = planar_transform(scene.start, scene.object.rest_height)
    scenes = [
        (scene, 1),
        (scene.with_goal((0.3, 0.3, 0.0)), 1),
        (scene.with_obstacle_moved(CUBE, (0.0, 0.1, 0.0)), 2),
        (scene.without_obstacle(CUBE), 3),
    ]
    for each, count in scenes:
        canvas.draw(Picture(each, 0.0, each.robot.start, at))
        assert len(display.scenes) == count


class Asked:
    """In the place of a session: what was asked for last."""

    def __init__(self, scene: Scene) -> None:
        self.wanted = SimpleNamespace(scene=scene)
        self.problem = ""

    def change(self, *, scene: Scene) -> None:
        self.wanted = SimpleNamespace(scene=scene)


def test_an_obstacle_is_dragged_without_any_file(scene):
    view = object.__new__(LiveView)
    view._session = Asked(replace(scene, file=Path("/nowhere/at/all.usda")))
    before = scene.obstacle(CUBE).center
    view._dropped(CUBE, np.array([0.6, 0.2, 0.3]), np.array([*before[:2], 0.0]))
    moved = view._session.wanted.scene.obstacle(CUBE)
    np.testing.assert_allclose(moved.center, [0.6, 0.2, before[2]], atol=1e-12)
    view._dropped("/World/Gone", np.zeros(3), np.zeros(3))
    assert "no obstacle </World/Gone>" in view._session.problem


# Saving


def test_an_edited_scene_is_saved_as_it_is(scene, tmp_path):
    wall = Obstacle("/World/Obstacles/Wall", (small_tasks.box(0.1, 0.4, (0.3, 0.04, 0.1), yaw=0.2),))
    edited = heavier(scene, 0.8).with_goal((0.4, 0.2, 1.0)).with_start((0.3, -0.4, 0.5))
    edited = edited.with_obstacle_moved(CUBE, (0.05, -0.1, 0.3)).with_obstacle(wall)
    again = load_scene(save_scene(edited, tmp_path / "mine.usda"))
    assert again.object.mass == pytest.approx(0.8)
    assert [obstacle.path for obstacle in again.obstacles] == [CUBE, wall.path]
    for saved, wanted in zip(again.obstacles, edited.obstacles, strict=True):
        np.testing.assert_allclose(saved.colliders[0].transform, wanted.colliders[0].transform, atol=1e-9)
        np.testing.assert_allclose(saved.colliders[0].size, wanted.colliders[0].size, atol=1e-9)
    np.testing.assert_allclose(again.object.unit_inertia, scene.object.unit_inertia, rtol=1e-5, atol=1e-9)
    assert [file.name for file in tmp_path.glob("mine*")] == ["mine.usda"]


@pytest.mark.parametrize("kind", ["larger", "letter", "cylinder", "gone"])
def test_objects_and_obstacles_of_every_kind_come_back_from_a_saved_scene(tmp_path, kind):
    scene = small_tasks.shipped("task05" if kind == "letter" else "lab01" if kind == "cylinder" else "task02")
    edited = replace(scene, object=scene.object.scaled(1.1))
    if kind == "letter":
        x, y, z = scene.obstacles[-1].center
        beside = np.array([x + 0.2, y, z, 0.0, 0.0, 0.0, 0.0])
        shapes = tuple(replace(shape, transform=shape.transform + beside) for shape in scene.object.colliders)
        edited = edited.with_obstacle(Obstacle("/World/Far", shapes))
    if kind == "gone":
        edited = edited.without_obstacle(CUBE)
    again = load_scene(save_scene(edited, tmp_path / "mine.usdc"))
    assert len(again.obstacles) == len(edited.obstacles)
    for saved, wanted in zip(again.object.colliders, edited.object.colliders, strict=True):
        assert saved.kind == wanted.kind
        np.testing.assert_allclose(saved.size, wanted.size, rtol=1e-6)
    models = [World(each).mujoco for each in (again, edited)]
    np.testing.assert_allclose(models[0].model.geom_rbound, models[1].model.geom_rbound, atol=1e-5)
    np.testing.assert_allclose(*(model.model.body_inertia[model.object_body] for model in models), rtol=1e-3)


def test_what_cannot_be_saved_is_said_and_nothing_is_left_behind(scene, tmp_path):
    wider = replace(scene, table=replace(scene.table, upper=(1.2, 0.8)))
    with pytest.raises(SceneError, match="a change to the scene's table cannot be saved"):
        save_scene(wider, tmp_path / "mine.usda")
    with pytest.raises(SceneError, match="a change to the scene's robot"):
        save_scene(replace(scene, robot=replace(scene.robot, start=np.full(6, -0.1))), tmp_path / "mine.usda")
    assert not list(tmp_path.glob("mine*"))
    with pytest.raises(SceneError, match="is not a valid prim path"):
        box = small_tasks.box(0.1, 0.4, (0.1, 0.1, 0.1))
        save_scene(scene.with_obstacle(Obstacle("a box", (box,))), tmp_path / "a.usda")


def test_a_link_lighter_than_its_tool_is_refused(scene):
    links = (*scene.robot.links[:-1], replace(scene.robot.links[-1], mass=0.01))
    with pytest.raises(SceneError, match=r"the link has a mass of 0\.01 kg"):
        build_model(replace(scene, robot=replace(scene.robot, links=links)))


def test_gravity_pulls_as_the_scene_says(scene):
    moon = replace(scene, gravity=(0.0, 0.0, -1.62))
    world = World(moon)
    assert force_on_table(SimulatedPlant(world), world) == pytest.approx(0.5 * 1.62, rel=1e-3)
    assert isinstance(world.mujoco.model, mujoco.MjModel)
