"""The tasks as Gymnasium environments; importing this package registers them (`docs/environments.md`).

Each shipped scene is ``oimppi/NAME-v0``, and ``oimppi/scene-v0`` takes any file. USD, Warp and MuJoCo are imported when
an environment is made.
"""

from __future__ import annotations

from pathlib import Path

from oimppi_warp.errors import missing_package

try:
    import gymnasium
except ModuleNotFoundError as error:
    needed = str(missing_package("the environments", str(error.name), "gym"))
    raise ModuleNotFoundError(needed, name=error.name) from None

_SCENES = Path(__file__).parents[1] / "scenes"
_ENTRY = "oimppi_warp.environments.push:PushEnvironment"

SECONDS = 40.0
"""Time limit of an episode [simulated s]."""
CONTROL_PERIOD = 0.05
"""Control period of a registered environment [s]."""


def _register(name: str, **options: str) -> None:
    gymnasium.register(f"oimppi/{name}-v0", _ENTRY, max_episode_steps=round(SECONDS / CONTROL_PERIOD), kwargs=options)


for _file in sorted(_SCENES.glob("*.usda")):
    _register(_file.stem, scene=_file.stem)
_register("scene")
