"""Errors of the xArm's controller in words, each with what to do.

The codes and their meanings are those of the vendor's manual. The controller is never asked to clear one by itself.
"""

from __future__ import annotations

COLLISION, SELF_COLLISION, JOINT_LIMIT, TOO_FAST = 31, 22, 23, 24
"""Codes of errors that the emulation raises by itself."""

_ERRORS: dict[int, tuple[str, str]] = {
    1: ("the emergency stop is pressed", "release it"),
    2: ("the emergency stop input of the control box is triggered", "release it"),
    3: ("the emergency stop of the three-state switch is pressed", "release it"),
    11: ("motor 1 has an error", "look up its code in UFACTORY Studio"),
    12: ("motor 2 has an error", "look up its code in UFACTORY Studio"),
    13: ("motor 3 has an error", "look up its code in UFACTORY Studio"),
    14: ("motor 4 has an error", "look up its code in UFACTORY Studio"),
    15: ("motor 5 has an error", "look up its code in UFACTORY Studio"),
    16: ("motor 6 has an error", "look up its code in UFACTORY Studio"),
    17: ("motor 7 has an error", "look up its code in UFACTORY Studio"),
    19: ("the tool's communication fails", "check the plug at the wrist"),
    21: ("the kinematics of a command have no solution", "move the arm away from where it is stretched"),
    22: ("the arm would collide with itself", "move it apart by hand (manual mode)"),
    23: ("a joint is at its limit", "move it back by hand (manual mode)"),
    24: ("a joint was commanded to move too fast", "use a lower --speed, and report it: plans keep the arm's limits"),
    25: ("planning failed in the controller", "restart the control box"),
    26: ("the controller's clock failed", "restart the control box"),
    27: ("a command could not be carried out", "update the firmware"),
    31: (
        "a collision was detected: a motor's torque differs from what the controller expects",
        "look what the arm touches and move it free by hand; if it touches nothing, set the payload (docs/hardware.md)",
    ),
    32: ("the payload that is set is too heavy", "set the payload of the stick (docs/hardware.md)"),
    33: ("the payload that is set differs too much from the real one", "set the payload of the stick"),
    35: ("the arm left the safety boundary that is set in the controller", "move it back by hand, or widen it"),
    36: ("commands arrive faster than the controller takes them", "close other programs that command the arm"),
    37: ("manual mode is on at the end of the arm", "switch it off"),
    38: ("a joint's angle is not what was commanded", "move the arm away from its limits by hand"),
    39: ("the controller lost its link to the arm's power", "check the cable between control box and arm"),
    50: ("the force sensor has an error", "switch it off in UFACTORY Studio, it is not used"),
    60: ("the tool was commanded to move too fast", "use a lower --speed"),
    110: ("the robot's base board does not answer", "restart the control box"),
}


def describe(code: int) -> str:
    """Returns an error of the controller in words, with what to do.

    Args:
        code: The code, as the controller reports it.
    """
    meaning, remedy = _ERRORS.get(code, ("an error that is not known here", "look it up in the controller's manual"))
    return f"the controller reports C{code}: {meaning}\n  to do:   {remedy}; then clear the error in UFACTORY Studio"
