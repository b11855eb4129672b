"""The setup of an episode: scene, settings and options of the run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.scene import Scene

if TYPE_CHECKING:
    from oimppi_warp.runtime.episode import Episode


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that an :class:`oimppi_warp.runtime.episode.Episode` is made from.

    Attributes:
        scene: The task, with the start and the goal to use.
        config: All settings.
        spec: The options of the run.
    """

    scene: Scene
    config: Config
    spec: RunSpec = field(default_factory=RunSpec)

    def changed(self, **fields: Any) -> Setup:
        """Returns a copy with some fields, or some options of the run, changed."""
        own = {name: value for name, value in fields.items() if name in vars(self)}
        options = {name: value for name, value in fields.items() if name not in own}
        made = replace(self, **own)
        return replace(made, spec=made.spec.changed(**options))

    def loading_kernels(self) -> AbstractContextManager[None]:
        """Loads the kernels of an episode that is made within this block, in the background until the block ends."""
        from oimppi_warp.planning.early_kernels import loading_early

        return loading_early(self.scene, self.config, self.spec)

    def episode(self, *, report: Callable[[str], None] = lambda _: None) -> Episode:
        """Makes a new episode, ready to run; ``report`` is called with what is being done if that may take long."""
        from oimppi_warp.runtime.episode import Episode

        return Episode(self.scene, self.config, self.spec, report=report)
