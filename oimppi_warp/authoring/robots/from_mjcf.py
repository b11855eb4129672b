"""Reads a robot from an MJCF file: its tree of bodies as MuJoCo compiles it, in Newton's builder.

MuJoCo's own compiler resolves defaults, includes, attached models, frames, units and mesh files, and finds mistakes;
what is left is a table of bodies, joints and geoms, which :class:`_Reader` puts into a builder.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np

from oimppi_warp.authoring.mjcf import compiled
from oimppi_warp.authoring.robots.articulation import Articulation
from oimppi_warp.authoring.robots.chain import Chain, Kind, Limits, TreeJoint, serial_chain
from oimppi_warp.authoring.robots.mjcf_checks import check_angles, left_out
from oimppi_warp.errors import SceneError

if TYPE_CHECKING:
    import mujoco
    import newton

WORLD = "world"
"""Name of the body that everything is fixed to."""
_HIDDEN = 3
"""Group from which on MuJoCo's viewer hides geoms; by convention they are the ones that collide."""
_GREY = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's colour of a geom that has none; its material's colour then counts."""
_TIP_SITE = "attachment_site"
"""Usual name of the site on the flange where a tool goes."""


def read_mjcf(file: Path, *, flange: str = "") -> tuple[Chain, Articulation]:
    """Reads the chain in an MJCF file, with the properties of its bodies and joints.

    Sites count as links that are fixed to their bodies. Objects that float and mocap bodies are left out, and so are
    planes and height fields.

    Args:
        file: The MJCF file.
        flange: The body or site that carries the stick; other moving bodies are then ignored. Empty: the end of the
            only chain, or the site ``attachment_site`` on it.

    Raises:
        SceneError: MuJoCo cannot read the file, or it has no serial arm of hinge or slide joints on a fixed base.
    """
    reader = _Reader(compiled(file), file)
    tree = reader.tree()
    chain = serial_chain(tree, file=file, flange=flange or reader.usual_flange(tree))
    check_angles(chain, file)
    chain = replace(
        chain, notes=(*chain.notes, *left_out(chain, reader.model, bodies=reader.bodies, joints=reader.joints))
    )
    builder, bodies, joints = reader.builder(chain)
    return chain, Articulation(builder, bodies=bodies, joints=joints, file=file)


class _Reader:
    """The bodies, sites and joints of a compiled model, by their names.

    Args:
        model: The model.
        file: Path of the source file, for error messages.
    """

    def __init__(self, model: mujoco.MjModel, file: Path) -> None:
        self.model, self.file = model, file
        self.bodies = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
        self.bodies[0] = WORLD
        taken = set(self.bodies)
        sites = [model.site(i).name for i in range(model.nsite)]
        self.sites = {name: i for i, name in enumerate(sites) if name and name not in taken}
        self.joints = [model.joint(i).name or f"joint {i} of {self._body_of(i)}" for i in range(model.njnt)]

    def _body_of(self, joint: int) -> str:
        return self.bodies[self.model.jnt_bodyid[joint]]

    def _joints_of(self, body: int) -> range:
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def tree(self) -> nx.DiGraph:
        """Builds a graph of the bodies and sites, and the joints between them, without what floats."""
        model, tree = self.model, nx.DiGraph()
        tree.add_node(WORLD)
        floating = []
        for body in range(1, model.nbody):
            parent, name = self.bodies[model.body_parentid[body]], self.bodies[body]
            kinds = [int(model.jnt_type[joint]) for joint in self._joints_of(body)]
            if parent not in tree or model.body_mocapid[body] >= 0:
                continue
            if 0 in kinds:  # mjJNT_FREE
                floating.append(name)
                continue
            tree.add_edge(parent, name, joint=self._tree_joint(body))
        for name, site in self.sites.items():
            parent = self.bodies[model.site_bodyid[site]]
            if parent in tree:
                tree.add_edge(parent, name, joint=TreeJoint(f"site {name}", "fixed"))
        moving = any(edge["joint"].kind != "fixed" for _, _, edge in tree.edges(data=True))
        if floating and not moving:
            what = f"body {floating[0]} floats: it has a free joint"
            fix = (
                "remove the base's free joint; if it is an object to push, and no robot: "
                f"oimppi scene import {self.file.name}"
            )
            raise SceneError(what, file=self.file, allowed="a fixed base", fix=fix)
        return tree

    def usual_flange(self, tree: nx.DiGraph) -> str:
        """Returns the usual name of a flange's site if it is at the end of the only chain; else nothing."""
        if _TIP_SITE not in tree:
            return ""
        owner = next(iter(tree.predecessors(_TIP_SITE)))
        path = nx.shortest_path(tree, WORLD, owner)
        moved = {child for _, child, edge in tree.edges(data=True) if edge["joint"].kind != "fixed"}
        return _TIP_SITE if moved <= set(path) else ""

    def _tree_joint(self, body: int) -> TreeJoint:
        import mujoco

        joints = self._joints_of(body)
        if not len(joints):
            return TreeJoint(f"the place of {self.bodies[body]}", "fixed")
        name, mistake = self.joints[joints[0]], None
        if len(joints) > 1:
            names = ", ".join(self.joints[joint] for joint in joints)
            what = f"body {self.bodies[body]} has {len(joints)} joints: {names}"
            fix = "put each joint on a body of its own, with a mass and an inertia"
            mistake = SceneError(what, file=self.file, allowed="one joint for each body", fix=fix)
        kinds: dict[int, Kind] = {int(mujoco.mjtJoint.mjJNT_HINGE): "turns", int(mujoco.mjtJoint.mjJNT_SLIDE): "slides"}
        kind = int(self.model.jnt_type[joints[0]])
        if kind not in kinds:
            what = f"joint {name} is a ball joint"
            mistake = SceneError(what, file=self.file, allowed="hinge, slide", fix="replace it by three hinges")
        lower, upper = (float(value) for value in self.model.jnt_range[joints[0]])
        if not self.model.jnt_limited[joints[0]] and (lower or upper) and not lower < upper:
            what = f"joint {name}: the range from {lower:.4g} to {upper:.4g} has no positions"
            allowed, fix = "a lower limit below the upper one", "correct its range"
            mistake = SceneError(what, file=self.file, allowed=allowed, fix=fix)
        if self._is_held(joints[0]):
            what, fix = f"joint {name} is held at a position by an equality", "remove the equality, or the joint"
            mistake = SceneError(what, file=self.file, allowed="joints that are driven independently", fix=fix)
        limits, dof = self._limits(joints[0]), int(self.model.jnt_dofadr[joints[0]])
        losses = bool(self.model.dof_damping[dof] or self.model.dof_frictionloss[dof])
        return TreeJoint(name, kinds.get(kind, "turns"), limits, self._follows(joints[0]), losses, mistake)

    def _limits(self, joint: int) -> Limits | None:
        """Returns a joint's limits; ``None`` for a slide that has none. MJCF has no limits of velocity."""
        import mujoco

        model = self.model
        lower, upper = (float(value) for value in model.jnt_range[joint])
        if not model.jnt_limited[joint]:
            if int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE):
                return None
            lower, upper = -math.inf, math.inf
        return Limits(lower, upper, self._effort(joint), math.inf)

    def _effort(self, joint: int) -> float:
        """Returns the largest force of a joint's actuators together, where it is limited [N m; N]."""
        import mujoco

        model = self.model
        forces = []
        for actuator in range(model.nu):
            kind = int(model.actuator_trntype[actuator])
            of_joint = kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
            if of_joint and model.actuator_trnid[actuator, 0] == joint:
                gear, force = abs(float(model.actuator_gear[actuator, 0])), math.inf
                if model.actuator_forcelimited[actuator]:
                    force = float(np.abs(model.actuator_forcerange[actuator]).max())
                fixed = int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
                unbiased = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
                if fixed and unbiased and model.actuator_ctrllimited[actuator]:  # a motor
                    most = float(np.abs(model.actuator_ctrlrange[actuator]).max())
                    force = min(force, abs(float(model.actuator_gainprm[actuator, 0])) * most)
                forces.append(gear * force)
        whole = sum(forces) if forces else math.inf
        if model.jnt_actfrclimited[joint]:
            whole = min(whole, float(np.abs(model.jnt_actfrcrange[joint]).max()))
        return whole

    def _follows(self, joint: int) -> bool:
        """Returns whether an equality makes a joint follow another."""
        import mujoco

        return bool((self._equals(mujoco.mjtEq.mjEQ_JOINT, joint) & (self.model.eq_obj2id >= 0)).any())

    def _is_held(self, joint: int) -> bool:
        """Returns whether an equality holds a joint at a position."""
        import mujoco

        return bool((self._equals(mujoco.mjtEq.mjEQ_JOINT, joint) & (self.model.eq_obj2id < 0)).any())

    def _equals(self, kind: mujoco.mjtEq, first: int) -> np.ndarray:
        """Returns which equalities are active, of a kind and about an object, shape [n]."""
        model = self.model
        return (model.eq_type == int(kind)) & (model.eq_obj1id == first) & (model.eq_active0 != 0)

    def builder(self, chain: Chain) -> tuple[newton.ModelBuilder, dict[str, int], dict[str, int]]:
        """Puts a chain's bodies and joints into a builder; returns it, and the indices of links and joints by name."""
        import newton

        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        links: dict[str, int] = {}
        joints: dict[str, int] = {}
        index = {name: body for body, name in enumerate(self.bodies)}
        for group in chain.groups:
            for name, _ in group:
                if name in index:
                    links[name] = self._add_body(builder, index[name])
                else:
                    links[name] = builder.add_link(label=name)
        for name, link in links.items():
            if index.get(name):
                parent = links[self.bodies[self.model.body_parentid[index[name]]]]
                made = self._tree_joint(index[name])
                joints[made.name] = self._add_joint(builder, index[name], made.kind, parent, link)
            elif name not in index:
                site = self.sites[name]
                frame = [*self.model.site_pos[site], *_xyzw(self.model.site_quat[site])]
                parent = links[self.bodies[self.model.site_bodyid[site]]]
                joints[f"site {name}"] = builder.add_joint_fixed(parent, link, parent_xform=_transform(frame))
        return builder, links, joints

    def _add_body(self, builder: newton.ModelBuilder, body: int) -> int:
        import warp as wp

        model = self.model
        turn = _matrix(model.body_iquat[body])
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        link = builder.add_link(
            mass=float(model.body_mass[body]),
            com=wp.vec3(*map(float, model.body_ipos[body])),
            inertia=wp.mat33(*map(float, inertia.ravel())),
            label=self.bodies[body],
            lock_inertia=True,
        )
        first = int(model.body_geomadr[body])
        geoms = range(first, first + int(model.body_geomnum[body]))
        collide = [self._collides(geom) for geom in geoms]
        if not any(collide):
            collide = [int(model.geom_group[geom]) >= _HIDDEN for geom in geoms]
        for geom, solid in zip(geoms, collide, strict=True):
            self._add_geom(builder, link, geom, solid=solid)
        return link

    def _collides(self, geom: int) -> bool:
        model = self.model
        paired = ((model.pair_geom1 == geom) | (model.pair_geom2 == geom)).any()
        return bool(model.geom_contype[geom] or model.geom_conaffinity[geom] or paired)

    def _add_geom(self, builder: newton.ModelBuilder, link: int, geom: int, *, solid: bool) -> None:
        import mujoco
        import newton

        model, kinds = self.model, mujoco.mjtGeom
        kind = int(model.geom_type[geom])
        if kind in (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)):
            return
        material = int(model.geom_matid[geom])
        plain = material >= 0 and np.allclose(model.geom_rgba[geom], _GREY)
        color = (model.mat_rgba[material] if plain else model.geom_rgba[geom])[:3]
        frame = [*model.geom_pos[geom], *_xyzw(model.geom_quat[geom])]
        a, b, c = (float(value) for value in model.geom_size[geom])
        given: dict[str, Any] = {
            "xform": _transform(frame),
            "cfg": newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=solid),
            "color": tuple(map(float, color)),
        }
        if kind == int(kinds.mjGEOM_BOX):
            builder.add_shape_box(link, hx=a, hy=b, hz=c, **given)
        elif kind == int(kinds.mjGEOM_SPHERE):
            builder.add_shape_sphere(link, radius=a, **given)
        elif kind == int(kinds.mjGEOM_CAPSULE):
            builder.add_shape_capsule(link, radius=a, half_height=b, **given)
        elif kind == int(kinds.mjGEOM_CYLINDER):
            builder.add_shape_cylinder(link, radius=a, half_height=b, **given)
        else:
            points, faces = self._ellipsoid(geom) if kind == int(kinds.mjGEOM_ELLIPSOID) else self._mesh(geom)
            made = newton.Mesh(points, faces.ravel(), compute_inertia=False)
            builder.add_shape_mesh(link, mesh=made, **given)

    def _ellipsoid(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=2)
        return np.asarray(ball.vertices) * self.model.geom_size[geom], np.asarray(ball.faces)

    def _mesh(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the vertices [n, 3] [m] and faces [m, 3] of a geom's mesh, in the geom's frame."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
        return np.asarray(vertices), np.asarray(model.mesh_face[face : face + int(model.mesh_facenum[mesh])])

    def _add_joint(self, builder: newton.ModelBuilder, body: int, kind: Kind, parent: int, child: int) -> int:
        """Adds the joint between a body and its parent, with the positions that the model's own joint has."""
        import warp as wp

        model = self.model
        place = _frame(model.body_pos[body], _matrix(model.body_quat[body]))
        if kind == "fixed":
            return builder.add_joint_fixed(parent, child, parent_xform=_of_matrix(place))
        (joint,) = self._joints_of(body)
        anchor, axis = model.jnt_pos[joint], model.jnt_axis[joint]
        zero = float(model.qpos0[model.jnt_qposadr[joint]])  # the joint's position where the bodies are as in the file
        back = np.eye(4)
        if kind == "turns":
            back[:3, :3] = _matrix(np.array([math.cos(zero / 2), *(-math.sin(zero / 2) * axis)]))
        else:
            back[:3, 3] = -zero * axis
        before = place @ _frame(anchor, np.eye(3)) @ back
        add = builder.add_joint_revolute if kind == "turns" else builder.add_joint_prismatic
        return add(
            parent,
            child,
            parent_xform=_of_matrix(before),
            child_xform=_transform([*anchor, 0.0, 0.0, 0.0, 1.0]),
            axis=wp.vec3(*map(float, axis)),
        )


def _xyzw(quaternion: np.ndarray) -> np.ndarray:
    """Converts MuJoCo's quaternion wxyz to xyzw."""
    return np.asarray(quaternion)[[1, 2, 3, 0]]


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Returns the rotation matrix of MuJoCo's quaternion wxyz, shape [3, 3]."""
    from oimppi_warp.geometry.footprint import rotation_matrix

    return rotation_matrix(_xyzw(quaternion))


def _frame(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Returns a transform, shape [4, 4]."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, position
    return made


def _transform(values: list[float]) -> Any:
    """Returns Warp's transform of a position [m] and a quaternion xyzw."""
    import warp as wp

    return wp.transform(*map(float, values))


def _of_matrix(frame: np.ndarray) -> Any:
    from oimppi_warp.authoring.prims import matrix_quat

    return _transform([*frame[:3, 3], *matrix_quat(frame[:3, :3])])
