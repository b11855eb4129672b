"""The record of one episode: a header that describes the run, and columns with one row per control step.

Metrics, plots and replays in the viewer are computed from this record alone. On disk it is a folder with
``episode.npz`` (columns and plans) and ``episode.json`` (the header); the JSON is written last, so a folder that
contains it is complete.

The header is a JSON-serializable dictionary. Metrics and plots read these keys:

================== ==================================================================================================
scene, file        Short name of the scene, and the USD file it was loaded from
method             Name of the method, one of :data:`oimppi_warp.registries.METHODS`
engine             Rollout engine used; ``engine_reason`` explains the choice if it was made automatically
device             Device used for planning, e.g. ``cpu`` or ``cuda:0``
threads            Number of CPU threads used for planning
preset, seed       Name of the preset, and the seed
plant, mode        Name of the plant (its options: ``plant_options``); ``lockstep`` or ``realtime``
config             All settings as used, as nested dictionaries
requested          Settings that were adjusted for the task: ``{name: [requested value, reason for the change]}``
start, goal        Planar poses of the object (x, y [m], yaw [rad])
tolerance          ``{"position": m, "yaw": rad}``; a yaw of ``None`` means that any yaw is within tolerance
tight_tolerance    The tight tolerance, in the same form
exact_tolerance    The exact tolerance, in the same form; not in records of earlier versions
hold_seconds       Time for which the object must stay within tolerance [s]
control_period     [s]
cost_terms         Names of the entries of the column ``cost_terms``
scores             Names of the entries of the column ``scores``, for a plant that judges the task itself, else empty
preplan_time_s     Wall time of planning before the first step (SOI's object plan) [s]
problems           ``[step, reason]`` for each step at which no plan could be made from the observation, or no command
                   kept the bounds of the safety filter
filtered           Number of steps in which the safety filter changed the command, by what it was changed for
ended              Reason for the end: ``success``, ``time limit``, ``object fell``, ``interrupted``, ``diverged``
versions           Versions of Python and packages, see :func:`versions`
began_ns           Time at which ``time`` was zero, since the epoch [ns]; only in records of bags
================== ==================================================================================================

Records written by earlier versions may lack ``scores``, ``threads``, ``requested``, ``engine_reason``, ``plant`` and
``mode`` (they used the ideal plant in lock step); :attr:`EpisodeLog.run` substitutes these values.
"""

from __future__ import annotations

import io
import json
import math
import os
import platform
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.errors import OimppiError


class LogError(OimppiError):
    """A record that cannot be read or written."""


@dataclass(frozen=True)
class Column:
    """Description of a column.

    Attributes:
        shape: Shape of one row; names denote sizes that depend on the robot or the cost.
        unit: SI unit.
        meaning: One-line description.
    """

    shape: tuple[int | str, ...]
    unit: str
    meaning: str


COLUMNS: dict[str, Column] = {
    "time": Column((), "s", "time since the start of the episode, at the end of the step"),
    "joint_position": Column(("dof",), "rad", "joint positions at the end of the step"),
    "joint_velocity": Column(("dof",), "rad/s", "joint velocities at the end of the step"),
    "command": Column(("dof",), "rad/s", "joint velocities commanded during the step, within the limits"),
    "planned_command": Column(("dof",), "rad/s", "the same as planned, before the safety filter and the limits"),
    "joint_acceleration": Column((), "rad/s^2", "largest commanded acceleration of a joint during the step"),
    "joint_jerk": Column((), "rad/s^3", "largest commanded jerk of a joint during the step"),
    "filtered": Column((), "1", "1 if the safety filter changed the command; the header's `filtered` counts for what"),
    "limited": Column((), "1", "1 if the change of the command was reduced to the limits of acceleration and jerk"),
    "tool_position": Column((3,), "m", "position of the tool's tip at the end of the step"),
    "object_pose": Column((3,), "m, m, rad", "planar pose of the object at the end of the step"),
    "estimated_pose": Column((3,), "m, m, rad", "estimate of the object's pose that the planner uses at that time"),
    "reference_pose": Column((3,), "m, m, rad", "next pose of the object plan that the robot level follows"),
    "detection": Column((), "1", "result of processing a detection in this step, as an index of EVENTS"),
    "position_error": Column((), "m", "distance of the object from its goal"),
    "yaw_error": Column((), "rad", "absolute angle between the object and its goal, from 0 to pi"),
    "clearance": Column((), "m", "phi_2, the object's distance to the obstacles; negative if they overlap"),
    "contact_tool_object": Column((), "N", "largest force between tool and object during the step"),
    "contact_object_obstacle": Column((), "N", "largest force between object and obstacles during the step"),
    "contact_robot_obstacle": Column((), "N", "largest force between robot and obstacles or table during the step"),
    "done": Column((), "1", "1 if the plant says that the task is done; NaN if the plant does not judge"),
    "scores": Column(("n_scores",), "1", "figures of merit that the plant gives"),
    "plan_ms": Column((), "ms", "wall time of the planner's call, until the command is known"),
    "object_plan_ms": Column((), "ms", "part of plan_ms spent in the object level"),
    "effective_samples": Column((), "1", "effective sample size of the robot level"),
    "object_effective_samples": Column((), "1", "effective sample size of the object level"),
    "min_cost": Column((), "1", "smallest cost of the robot level's samples"),
    "cost_terms": Column(("n_terms",), "1", "weighted cost terms of the nominal, summed over the horizon"),
    "lost_samples": Column((), "1", "number of samples whose cost was not finite"),
    "missed_deadline": Column((), "1", "1 if a plan was due but not ready"),
    "stopped": Column(
        (),
        "1",
        "1 if the arm was stopped: the plan had expired, none could be made, or no command kept all bounds",
    ),
    "lag_ms": Column((), "ms", "delay of the control loop behind the wall clock"),
    "sent": Column((), "s", "time on the wall clock at which the command was sent, since the first; in real time"),
}
"""All columns. A row holds one control step: the command applied during it, the plan that contained the command, and
the state observed at its end. Values that a method does not have (the object level for MPPI) are NaN."""

EVENTS = ("none", "first", "accepted", "rejected", "recovered")
"""Results of processing a detection, in order: there was none; it awaits confirmation by a second one; it corrects the
prediction; it is rejected; it replaces the prediction, confirmed by the previous detection."""

_NPZ, _JSON = "episode.npz", "episode.json"


class EpisodeLog:
    """The record of one episode.

    Rows are appended to arrays that double in size when full; reading a column returns a view of the rows so far.

    Attributes:
        header: Description of the run, see the module's table.
        references: Object plans as ``(step, path)``: the step before which each was made (0 for SOI's) and its planar
            poses, shape [length, 3] [m, m, rad].
    """

    def __init__(self, header: Mapping[str, Any]) -> None:
        self.header: dict[str, Any] = dict(header)
        self.references: list[tuple[int, np.ndarray]] = []
        self._rows = 0
        self._data: dict[str, np.ndarray] = {}

    @property
    def run(self) -> RunSpec:
        """Returns the run's options with engine, device and threads resolved (never ``auto``).

        ``threads`` is ``None`` if not recorded.

        Raises:
            KeyError: The header lacks the method, engine, device or seed.
        """
        needed = {name: self.header[name] for name in ("method", "engine", "device", "seed")}
        return RunSpec(
            **needed,
            threads=self.header.get("threads"),
            plant=self.header.get("plant", "ideal"),
            plant_options=tuple(self.header.get("plant_options") or ()),
            mode=self.header.get("mode", "lockstep"),
            friction=self.header.get("friction"),
            knock=None if (knock := self.header.get("knock")) is None else (knock[0], knock[1], knock[2]),
        )

    def __len__(self) -> int:
        """Returns the number of control steps so far."""
        return self._rows

    def __getitem__(self, name: str) -> np.ndarray:
        """Returns the column ``name``, shape [steps, ...]; all NaN if no row had it.

        Raises:
            KeyError: There is no such column (see :data:`COLUMNS`).
        """
        column = COLUMNS[name]
        if name in self._data:
            return self._data[name][: self._rows]
        return np.full((self._rows, *(size if isinstance(size, int) else 0 for size in column.shape)), np.nan)

    @property
    def columns(self) -> tuple[str, ...]:
        """Returns the names of the columns that at least one row had."""
        return tuple(name for name in COLUMNS if name in self._data)

    def append(self, **row: Any) -> None:
        """Adds one control step; omitted columns are NaN.

        Raises:
            KeyError: There is no such column.
            ValueError: The shape of a value differs from that in the previous rows.
        """
        if unknown := row.keys() - COLUMNS.keys():
            raise KeyError(f"no such column: {', '.join(sorted(unknown))}; the columns are {', '.join(COLUMNS)}")
        for name, value in row.items():
            if name not in self._data:
                self._data[name] = np.full((max(256, 2 * self._rows), *np.shape(value)), np.nan)
        for name, array in self._data.items():
            if self._rows == len(array):
                array = self._data[name] = np.concatenate([array, np.full_like(array, np.nan)])
            value = row.get(name, np.nan)
            if name in row and np.shape(value) != array.shape[1:]:
                raise ValueError(f"{name}: shape {np.shape(value)}, but the previous rows have {array.shape[1:]}")
            array[self._rows] = value
        self._rows += 1

    def add_reference(self, path: np.ndarray, step: int | None = None) -> None:
        """Stores a copy of an object plan.

        Args:
            path: Planar poses of the object, shape [length, 3] [m, m, rad].
            step: Number of the step before which the plan was made; ``None``: the next step.
        """
        self.references.append((self._rows if step is None else step, np.array(path, dtype=float).reshape(-1, 3)))

    def save(self, folder: str | Path) -> Path:
        """Writes the record to ``folder``, created if needed; the JSON file exists only if both files are complete.

        Raises:
            LogError: The folder cannot be written to.
        """
        folder = Path(folder)
        steps = np.array([step for step, _ in self.references], dtype=int)
        lengths = np.array([len(path) for _, path in self.references], dtype=int)
        points = np.concatenate([np.empty((0, 3)), *(path for _, path in self.references)])
        arrays = {name: self[name] for name in self.columns}
        arrays |= {"reference_steps": steps, "reference_lengths": lengths, "reference_points": points}
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        text = json.dumps(to_json(self.header), indent=2, allow_nan=False) + "\n"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / _JSON).unlink(missing_ok=True)
            write_atomically(folder / _NPZ, packed.getvalue())
            write_atomically(folder / _JSON, text.encode())
        except OSError as error:
            raise LogError(f"{folder}: the record cannot be written ({error.strerror or error})") from error
        return folder

    @classmethod
    def load(cls, folder: str | Path) -> EpisodeLog:
        """Reads a record that :meth:`save` wrote.

        Raises:
            LogError: ``folder`` contains no complete record.
        """
        folder = Path(folder)
        if not folder.exists():
            raise LogError(f"{folder}: there is no such folder\n  allowed: a folder with {_NPZ} and {_JSON}")
        try:
            header = json.loads((folder / _JSON).read_text(encoding="utf-8"))
            with np.load(folder / _NPZ, allow_pickle=False) as arrays:
                columns = {name: arrays[name] for name in arrays.files if name in COLUMNS}
                ends = np.cumsum(arrays["reference_lengths"])
                paths = np.split(arrays["reference_points"], ends)[: len(ends)]
                references = list(zip(arrays["reference_steps"].tolist(), paths, strict=True))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            reason = str(error)
            if isinstance(error, OSError) and error.filename:
                reason = f"{Path(error.filename).name}: {error.strerror}"
            below = sorted(found.parent for depth in ("*", "*/*") for found in folder.glob(f"{depth}/{_JSON}"))
            hint = f"\n  to do:   give one of the records in it, such as {below[0]}" if below else ""
            raise LogError(
                f"{folder}: contains no complete record ({reason})\n  allowed: a folder with {_NPZ} and {_JSON}{hint}"
            ) from error
        return cls.of_columns(header, columns, references)

    @classmethod
    def of_columns(
        cls,
        header: Mapping[str, Any],
        columns: Mapping[str, np.ndarray],
        references: Sequence[tuple[int, np.ndarray]] = (),
    ) -> EpisodeLog:
        """Returns a log with whole columns.

        Args:
            header: Description of the run, see the module's table.
            columns: Columns by name, shape [steps, ...].
            references: Object plans, see the class.

        Raises:
            KeyError: There is no such column.
        """
        if unknown := columns.keys() - COLUMNS.keys():
            raise KeyError(f"no such column: {', '.join(sorted(unknown))}; the columns are {', '.join(COLUMNS)}")
        log = cls(header)
        log._data = dict(columns)
        log._rows = max((len(array) for array in log._data.values()), default=0)
        log.references = list(references)
        return log


def write_atomically(path: str | Path, content: bytes) -> None:
    """Writes a file completely or not at all, by renaming a temporary file."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def flatten(value: Any) -> dict[str, Any]:
    """Returns the fields of a dataclass by name, with those of nested dataclasses inlined, as in all JSON files."""
    found: dict[str, Any] = {}
    for item in fields(value):
        inner = getattr(value, item.name)
        found |= flatten(inner) if is_dataclass(inner) else {item.name: inner}
    return found


def to_json(value: Any) -> Any:
    """Converts a value to JSON types: arrays become lists, dataclasses objects, infinity and NaN ``None``."""
    if is_dataclass(value) and not isinstance(value, type):
        return to_json(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): to_json(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_json(value.tolist())
    if isinstance(value, list | tuple):
        return [to_json(inner) for inner in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def versions() -> dict[str, str]:
    """Returns the versions of Python and of the packages that affect results, without importing them."""
    found = {"python": platform.python_version()}
    for name in ("oimppi-warp", "warp-lang", "newton", "mujoco", "mujoco-warp", "numpy", "usd-core"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def holds_record(folder: Path) -> bool:
    """Returns whether a folder holds a record, or a part of one."""
    return (folder / _NPZ).exists() or (folder / _JSON).exists()


def unused_folder(folder: Path) -> Path:
    """Returns a folder that holds no record: the given one, or the next free one of NAME-2, NAME-3, ... beside it."""
    taken, number = folder, 1
    while holds_record(taken):
        number += 1
        taken = folder.with_name(f"{folder.name}-{number}")
    return taken
