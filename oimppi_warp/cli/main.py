"""The command ``oimppi``. Each subcommand is a dataclass: its fields are the options, and ``execute`` runs it.

Exit status of all commands: 2 for bad input (one message on stderr, nothing written), 130 for Ctrl-C; their help gives
the others. Heavy imports happen inside ``execute``, after the options have been checked, so that help and error
messages appear at once.
"""

from __future__ import annotations

import atexit
import gc
import os
import select
import sys
from collections.abc import Sequence
from typing import Annotated, Any, get_args

import tyro
from tyro.conf import subcommand

from oimppi_warp.cli.bag import ImportBag
from oimppi_warp.cli.bench import Bench, Compare, Report
from oimppi_warp.cli.check import Check
from oimppi_warp.cli.demos import Demos
from oimppi_warp.cli.hardware import LabEmulator
from oimppi_warp.cli.perceive import PerceiveCommand
from oimppi_warp.cli.robot import AddRobot
from oimppi_warp.cli.ros2 import Ros2Check, Ros2Plant
from oimppi_warp.cli.run import Demo, Run
from oimppi_warp.cli.scene import Import, New, Scenes
from oimppi_warp.cli.system import Doctor, Warmup
from oimppi_warp.cli.values import VALUES
from oimppi_warp.cli.view import Export, View
from oimppi_warp.errors import ConfigError, OimppiError
from oimppi_warp.signals import ending_like_ctrl_c, silence
from oimppi_warp.suggestions import did_you_mean

_PIPE_CLOSED = 141
"""Exit status where nobody reads the output to its end, as that of a program which SIGPIPE ended."""

SceneCommand = (
    Annotated[New, subcommand("new", prefix_name=False)]
    | Annotated[Import, subcommand("import", prefix_name=False)]
    | Annotated[AddRobot, subcommand("robot", prefix_name=False)]
    | Annotated[Check, subcommand("check", prefix_name=False)]
)
"""The subcommands of ``oimppi scene``."""

Ros2Command = (
    Annotated[Ros2Plant, subcommand("plant", prefix_name=False)]
    | Annotated[Ros2Check, subcommand("check", prefix_name=False)]
)
"""The subcommands of ``oimppi ros2``."""

Command = (
    Annotated[Demo, subcommand("demo", prefix_name=False)]
    | Annotated[Run, subcommand("run", prefix_name=False)]
    | Annotated[Bench, subcommand("bench", prefix_name=False)]
    | Annotated[Report, subcommand("report", prefix_name=False)]
    | Annotated[Compare, subcommand("compare", prefix_name=False)]
    | Annotated[Demos, subcommand("demos", prefix_name=False)]
    | Annotated[View, subcommand("view", prefix_name=False)]
    | Annotated[Export, subcommand("export", prefix_name=False)]
    | Annotated[ImportBag, subcommand("import-bag", prefix_name=False)]
    | Annotated[
        SceneCommand,
        subcommand(
            "scene", prefix_name=False, description="Create scenes, objects and robots of your own, and check scenes."
        ),
    ]
    | Annotated[Scenes, subcommand("scenes", prefix_name=False)]
    | Annotated[Warmup, subcommand("warmup", prefix_name=False)]
    | Annotated[Doctor, subcommand("doctor", prefix_name=False)]
    | Annotated[LabEmulator, subcommand("lab-emulator", prefix_name=False)]
    | Annotated[
        Ros2Command,
        subcommand("ros2", prefix_name=False, description="Simulate a lab on ROS 2 topics, and check a real one."),
    ]
    | Annotated[
        PerceiveCommand,
        subcommand("perceive", prefix_name=False, description="Find the object with a camera, by tags on it."),
    ]
)
"""All commands; to add one, add its dataclass to this union."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parses the command line, runs the command and returns the exit status.

    Args:
        arguments: The command line without the program's name; default: that of this process.

    Raises:
        SystemExit: Help was requested (status 0), or the command line cannot be parsed (status 2).
    """
    gc.set_threshold(100_000, 50, 1000)  # Newton and MuJoCo Warp create half a million long-lived objects; scanning
    atexit.register(gc.freeze)  # them repeatedly, and once more at exit, would double the start-up time
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # NumPy's BLAS threads slow down the planner's kernels
    with ending_like_ctrl_c():
        try:
            command = _parse(sys.argv[1:] if arguments is None else arguments)
        except OimppiError as error:
            print(f"oimppi: {error}", file=sys.stderr)
            return 2
        except BrokenPipeError:  # the help was not read to its end
            if not _nobody_reads():
                raise
            return _PIPE_CLOSED
        return _execute(command)


def _execute(command: Command) -> int:
    """Runs a command and returns the exit status; says what went wrong, if something did."""
    try:
        status = command.execute()
        sys.stdout.flush()
        return status
    except (OimppiError, SystemError) as error:
        if _is_from_ctrl_c(error):
            return _interrupted()
        if isinstance(error, SystemError):
            raise
        print(f"oimppi: {error}", file=sys.stderr)
        return 2
    except SystemExit:  # what Rich makes of a BrokenPipeError
        return _PIPE_CLOSED
    except OSError as error:
        if _nobody_reads():
            return _PIPE_CLOSED
        print(f"oimppi: input or output failed: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return _interrupted()


def _is_from_ctrl_c(error: BaseException | None) -> bool:
    """Returns whether C code, as in USD, turned Ctrl-C into this exception or into one that led to it."""
    while error is not None:
        if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _interrupted() -> int:
    """Says that Ctrl-C ended the command, and returns the exit status."""
    print("oimppi: interrupted", file=sys.stderr)
    return 130


def _nobody_reads() -> bool:
    """Returns whether the reader of the output is gone; what is left to write then goes nowhere."""
    try:
        output = sys.stdout.fileno()
    except OSError:  # it is no file
        return False
    poll = select.poll()
    poll.register(output, 0)
    gone = any(event & select.POLLERR for _, event in poll.poll(0))
    if gone:
        silence(output)
    return gone


def _parse(arguments: Sequence[str]) -> Any:
    """Parses the command line; the command's name selects its parser, so that messages are about its options only.

    Raises:
        ConfigError: There is no such command.
    """
    kind: Any = Command
    name, about = "oimppi", "Object-informed MPPI: an arm pushes an object to its goal."
    while arguments:
        commands = {each.__metadata__[0].name: each for each in get_args(kind)}
        chosen = commands.get(arguments[0])
        if chosen is None:
            if commands and not arguments[0].startswith("-"):
                near = did_you_mean(arguments[0], commands) or f"see {name} --help"
                raise ConfigError(
                    f"{name} has no command {arguments[0]!r}\n  allowed: {', '.join(commands)}\n  to do:   {near}"
                )
            break
        kind, (details,) = chosen.__origin__, chosen.__metadata__  # a command, or a union of them
        name, about, arguments = f"{name} {details.name}", details.description, arguments[1:]
    return tyro.cli(kind, prog=name, description=about, args=arguments, registry=VALUES)
